"""Obstacles for robots, from maps."""
