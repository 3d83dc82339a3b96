"""Lidars in a map."""
