"""Draws the map as a robot's camera sees it, and compares it with the camera's pictures."""
