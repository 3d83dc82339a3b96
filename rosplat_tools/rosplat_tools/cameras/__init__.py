"""Cameras in the map: pictures of it as a robot's camera takes them, and held against those."""
