"""A viewer without rviz2: `node` draws, `orbit` frames, `command` shows."""
