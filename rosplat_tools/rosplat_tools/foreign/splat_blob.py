"""gsplat_msgs/SplatBlobChunk, of bjoernellens1's RVizSplat: a whole map as a file, cut into chunks.

The file is a PLY, or compact_rows. A checksum isn't checked: the middleware has checked the bytes.
"""

from __future__ import annotations

import io
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from std_msgs.msg import Header

from rosplat_core.formats import ply
from rosplat_core.formats.decoded import IntoSplats, Warn
from rosplat_core.log_text import shown
from rosplat_core.splats import InputError, Splats
from rosplat_core.view import frame_at
from rosplat_ros.messages import as_array, plain_frame
from rosplat_tools.foreign import MapReader
from rosplat_tools.foreign import compact_rows as rows
from rosplat_tools.foreign.chunks import Chunks

TYPE = "gsplat_msgs/msg/SplatBlobChunk"
TOPIC = "gaussian_splat_blob_chunks"
DEPTH = 1000  # of chunks, which make one map
FIELDS = ("format", "data")

CHUNK = 1 << 20  # of a message [bytes]


class Reader(MapReader):
    """The map of the last whole file."""

    def __init__(self, name: str, warn: Warn) -> None:
        super().__init__(name, warn)
        self._chunks = Chunks(name)

    def add(self, message: Any) -> bool:
        """Raises InputError for a chunk that contradicts itself, and for a file that is no map."""
        payload = self._chunks.add((message.session_id, message.version), message)
        if payload is None:
            return False
        turn, shift = message.map_from_source.rotation, message.map_from_source.translation
        orientation = turn.x, turn.y, turn.z, turn.w
        if not np.isfinite([*orientation, shift.x, shift.y, shift.z]).all():
            raise InputError(f"{self._name}: map_from_source: not finite")
        pose = frame_at(
            (shift.x, shift.y, shift.z), orientation if any(orientation) else (0.0, 0.0, 0.0, 1.0)
        )
        splats = self._read(payload, message.format)
        self._splats = splats if np.array_equal(pose, np.eye(4)) else splats.moved(pose)
        self.frame_id = plain_frame(message.header.frame_id)
        return True

    def _read(self, payload: bytes, form: str) -> Splats:
        if form == rows.NAME:
            return rows.decode(payload, self._name, self._warn)
        if form not in ("ply", "ply_binary", "ply_ascii"):
            known = f"known are {rows.NAME}, ply"
            raise InputError(f"{self._name}: format: {shown(repr(form))}, {known}")
        with tempfile.NamedTemporaryFile(suffix=".ply") as file:
            file.write(payload)
            file.flush()
            try:
                return ply.read(Path(file.name), lambda _: None, self._warn, IntoSplats())
            except InputError as error:
                raise InputError(str(error).replace(file.name, self._name)) from error


def messages(kind: Any, splats: Splats, header: Header) -> Iterator[Any]:
    """The chunks of a PLY, which loses nothing."""
    stream = io.BytesIO()
    ply.write(stream, Path("map.ply"), splats)
    payload = np.frombuffer(stream.getvalue(), np.uint8)
    parts = [payload[first : first + CHUNK] for first in range(0, len(payload), CHUNK)]
    for index, part in enumerate(parts):
        message = kind(
            header=header, session_id="rosplat", format="ply_binary", compression="none",
            version=header.stamp.sec * 10**9 + header.stamp.nanosec,
            chunk_index=index, chunk_count=len(parts), chunk_size=len(part),
            total_size=len(payload), uncompressed_size=len(payload), replace_current=True,
        )  # fmt: skip
        message.map_from_source.rotation.w = 1.0
        message.data = as_array("B", part)
        yield message
