"""Robots that MuJoCo moves, in maps: what their cameras and lidars see, what they run into."""
