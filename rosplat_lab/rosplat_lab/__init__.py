"""Measures ROSplat: errors against a float64 reference, times against other methods."""
