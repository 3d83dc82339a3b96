"""Maps as receivers hold them, in C++: what a batch does to one, and what is pulled of it."""

from __future__ import annotations

from rosplat_core import _core

Arrival = _core.Arrival
BatchError = _core.BatchError
GaussianMap = _core.GaussianMap
MapPull = _core.MapPull

REPLACE, UPSERT, DELETE, MOVE = range(4)  # what a batch does, as in GaussianArray
