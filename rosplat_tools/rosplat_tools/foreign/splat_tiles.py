"""gsplat_msgs/SplatTileChunk, of bjoernellens1's RVizSplat: a map in tiles that come and go.

Tiles of a session's version are upserted and deleted, and all become the map at its COMMIT. Rows
are compact_rows'. A checksum isn't checked: the middleware has checked the bytes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from std_msgs.msg import Header

from rosplat_core.formats.decoded import Warn
from rosplat_core.log_text import shown
from rosplat_core.splats import InputError, Splats, concatenate
from rosplat_ros.messages import as_array, plain_frame
from rosplat_tools.foreign import MapReader
from rosplat_tools.foreign import compact_rows as rows
from rosplat_tools.foreign.chunks import Chunks

TYPE = "gsplat_msgs/msg/SplatTileChunk"
TOPIC = "gaussian_splat_tile_chunks"
DEPTH = 100
FIELDS = ("operation", "tile_x", "data")

TILE = 1.0  # edge of a tile that is sent [m]
CHUNK = 1 << 20  # of a message [bytes]
VERSIONS = 4  # that may wait for their COMMIT
MOST_TILES = 1024  # that may be on their way at once

_Key = tuple[int, int, int, int]


class Reader(MapReader):
    """The tiles of the last COMMIT."""

    def __init__(self, name: str, warn: Warn) -> None:
        super().__init__(name, warn)
        self._tiles: dict[_Key, Splats] = {}
        self._waiting: dict[tuple[str, int], list[tuple[_Key | None, Splats | None]]] = {}
        self._chunks = Chunks(name)

    def add(self, message: Any) -> bool:
        """Raises InputError for a chunk that contradicts itself, and for a COMMIT of which parts
        are missing; the map stays.
        """
        version = message.session_id, message.version
        tile: _Key = message.tile_x, message.tile_y, message.tile_z, message.lod
        operation = message.operation
        if operation == message.COMMIT:
            return self._commit(version, message)
        if operation == message.HEARTBEAT:
            return False
        if operation == message.CLEAR_ALL:
            self._wait(version, None, None)
        elif operation == message.DELETE_TILE:
            self._wait(version, tile, None)
        elif operation == message.UPSERT_TILE:
            if message.encoding != rows.NAME:
                raise InputError(
                    f"{self._name}: encoding: {shown(repr(message.encoding))}, known is {rows.NAME}"
                )
            payload = self._chunks.add((version, tile), message, MOST_TILES)
            if payload is not None:
                self._wait(version, tile, rows.decode(payload, self._name, self._warn))
        else:
            raise InputError(f"{self._name}: operation: {operation} is not known")
        return False

    def _wait(self, version: tuple[str, int], tile: _Key | None, splats: Splats | None) -> None:
        self._waiting.setdefault(version, []).append((tile, splats))
        while len(self._waiting) > VERSIONS:
            del self._waiting[next(iter(self._waiting))]

    def _commit(self, version: tuple[str, int], message: Any) -> bool:
        edits = self._waiting.pop(version, [])
        if self._chunks.drop(lambda key: key[0] == version):
            raise InputError(
                f"{self._name}: version {version[1]} is committed, and tiles lack chunks"
            )
        for tile, splats in edits:
            if tile is None:
                self._tiles.clear()
            elif splats is None:
                self._tiles.pop(tile, None)
            else:
                self._tiles[tile] = splats
        self.frame_id = plain_frame(message.header.frame_id)
        return bool(edits)

    def splats(self) -> Splats:
        """The splats of all tiles."""
        return concatenate([*self._tiles.values()] or [rows.decode(b"", self._name, self._warn)])


def messages(kind: Any, splats: Splats, header: Header) -> Iterator[Any]:
    """A version in place of all before: tiles of TILE, then its COMMIT."""
    version = header.stamp.sec * 10**9 + header.stamp.nanosec
    common = {
        "header": header, "session_id": "rosplat", "version": version, "encoding": rows.NAME,
        "compression": "none", "stride": rows.ROW.itemsize, "chunk_count": 1,
    }  # fmt: skip
    yield kind(operation=kind.CLEAR_ALL, **common)
    places = np.floor((splats.positions + splats.origin) / TILE).astype(np.int32)
    tiles, owners = np.unique(places, axis=0, return_inverse=True)
    order = np.argsort(owners.ravel(), kind="stable")
    counts = np.bincount(owners.ravel(), minlength=len(tiles))
    for tile, count, end in zip(tiles.tolist(), counts, np.cumsum(counts), strict=True):
        members = order[end - count : end]
        payload = np.frombuffer(rows.encode(splats[members]), np.uint8)
        parts = [payload[first : first + CHUNK] for first in range(0, len(payload), CHUNK)]
        for index, part in enumerate(parts):
            message = kind(operation=kind.UPSERT_TILE, **common)
            message.tile_x, message.tile_y, message.tile_z = tile
            message.chunk_index, message.chunk_count = index, len(parts)
            message.splat_count, message.uncompressed_size = len(members), len(payload)
            message.data = as_array("B", part)
            yield message
    yield kind(operation=kind.COMMIT, **common)
