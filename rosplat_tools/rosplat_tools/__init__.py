"""Scenes of 3D Gaussians: formats, publishers, an emulated SLAM node and robot."""
