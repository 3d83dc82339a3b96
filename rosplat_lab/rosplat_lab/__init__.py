"""Measures ROSplat: errors against a float64 reference, times against other methods.

The modules are private; the programs are public.
"""
