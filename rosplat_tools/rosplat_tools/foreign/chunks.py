"""Joins what gsplat_msgs sends in chunks."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

from rosplat_core.log_text import shown
from rosplat_core.splats import InputError

MOST = 4  # payloads that may be incomplete at once: of an author that stopped, say


class Chunks:
    """Payloads on their way, each known by a key. Memory is what has come, no more."""

    def __init__(self, name: str) -> None:
        """name: of the topic, for errors."""
        self._name = name
        self._coming: dict[Hashable, dict[int, bytes]] = {}

    def add(self, key: Hashable, message: Any, most: int = MOST) -> bytes | None:
        """The payload of `key` once all of its chunks are there. Raises InputError."""
        index, count = message.chunk_index, message.chunk_count
        if index >= count:
            raise InputError(f"{self._name}: chunk_index: {index} of a chunk_count of {count}")
        if message.compression not in ("", "none"):
            raise InputError(
                f"{self._name}: compression: {shown(repr(message.compression))} is not known"
            )
        parts = self._coming.setdefault(key, {})
        parts[index] = bytes(message.data)
        if len(parts) < count:
            while len(self._coming) > most:
                del self._coming[next(iter(self._coming))]
            return None
        del self._coming[key]
        payload = b"".join(parts[i] for i in sorted(parts))
        if message.uncompressed_size not in (0, len(payload)):
            raise InputError(
                f"{self._name}: uncompressed_size: {message.uncompressed_size}, and "
                f"{len(payload)} bytes came"
            )
        return payload

    def drop(self, belongs: Any) -> bool:
        """Forgets payloads that lack a chunk, whose key belongs(key) names; returns whether there
        were any."""
        lacking = [key for key in self._coming if belongs(key)]
        for key in lacking:
            del self._coming[key]
        return bool(lacking)
