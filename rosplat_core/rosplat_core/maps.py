"""Maps in C++, as their author and as receivers hold them: batches, and what is pulled."""

from __future__ import annotations

from rosplat_core import _core

Arrival = _core.Arrival
BatchError = _core.BatchError
GaussianMap = _core.GaussianMap
MapPull = _core.MapPull
PublishedBatch = _core.PublishedBatch
PublishedMap = _core.PublishedMap

REPLACE, UPSERT, DELETE, MOVE = range(4)  # what a batch does, as in GaussianArray
