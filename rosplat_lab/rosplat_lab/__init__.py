"""Measures ROSplat: errors against a float64 reference, times against other methods.

Its modules are private; its programs are what is public.
"""
