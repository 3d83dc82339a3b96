"""Scenes of 3D Gaussians: formats, publishers, a reference renderer, and the tools around them."""
