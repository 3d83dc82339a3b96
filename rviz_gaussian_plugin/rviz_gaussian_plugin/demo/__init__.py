"""Publishes and shows a scene: in rviz2 if it is installed, else in a viewer of its own."""
