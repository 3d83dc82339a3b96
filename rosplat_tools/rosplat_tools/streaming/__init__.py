"""Scenes larger than memory: what their viewers look at is published."""
