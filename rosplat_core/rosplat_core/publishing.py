"""A living map as its author has it, in C++: batches that tell of its edits, answers to pulls."""

from __future__ import annotations

from rosplat_core import _core

PublishedBatch = _core.PublishedBatch
PublishedMap = _core.PublishedMap
