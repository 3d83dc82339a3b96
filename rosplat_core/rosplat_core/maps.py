"""The C++ maps of publishers and receivers, their batches, and pulls of what a receiver lacks."""

from __future__ import annotations

from rosplat_core import _core

Arrival = _core.Arrival
BatchError = _core.BatchError
GaussianMap = _core.GaussianMap
MapPull = _core.MapPull
PublishedBatch = _core.PublishedBatch
PublishedMap = _core.PublishedMap

REPLACE, UPSERT, DELETE, MOVE = range(4)  # operations of a batch, as in GaussianArray
