"""sensor_msgs/PointCloud2 with a PLY's properties for fields. A message is a whole map.

Fields are called, and mean, what a PLY's properties do: x y z, f_dc_*, opacity as logit, scale_* as
logarithm, rot_* with w first, and f_rest_* where there are any; red green blue will do for f_dc_*,
and so will PCL's rgb or rgba, a number of four bytes with blue in its lowest.
A field of several numbers stands for as many fields: `rot` of 4 is rot_0 to rot_3, `position` of 3
is x y z. Teleoperation in Unity writes rot_w rot_x rot_y rot_z.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from rosplat_core.formats import ply
from rosplat_core.formats.decoded import IntoSplats
from rosplat_core.log_text import shown
from rosplat_core.splats import InputError, Splats
from rosplat_ros.messages import plain_frame
from rosplat_tools.clouds import TYPES, cloud
from rosplat_tools.foreign import MapReader

_PADDING = ("", "_")  # PCL's names of fields that are none
_PACKED = ("rgb", "rgba")
_MOST_NUMBERS = 4096  # of a point; a splat has 62, features some hundreds

TYPE = "sensor_msgs/msg/PointCloud2"
TOPIC = "cloud"
DEPTH = 1
FIELDS = ("fields", "data")


class Reader(MapReader):
    """The map of the last cloud."""

    def add(self, message: PointCloud2) -> bool:
        """Raises InputError for a cloud without the fields, or one that contradicts itself."""
        rows = _rows(message, self._name)
        path, into = Path(self._name), IntoSplats()
        self._splats = ply.from_rows(path, rows, lambda _: None, self._warn, into)
        self.frame_id = plain_frame(message.header.frame_id)
        return True


def messages(kind: type[PointCloud2], splats: Splats, header: Header) -> Iterator[PointCloud2]:
    """One cloud."""
    yield cloud(header, ply.to_rows(splats))


def _rows(message: PointCloud2, name: str) -> NDArray[np.void]:
    """A cloud's points as a structured array, a copy only if the rows are padded."""
    step, width, height = message.point_step, message.width, max(message.height, 1)
    order = ">" if message.is_bigendian else "<"
    names: list[str] = []
    formats: list[np.dtype[Any]] = []
    offsets: list[int] = []
    for field in message.fields:
        if field.datatype not in TYPES or field.name in _PADDING:
            continue
        kind = np.dtype(order + TYPES[field.datatype])
        count = max(field.count, 1)  # some drivers leave it at 0, and a cloud's height
        end = field.offset + count * kind.itemsize
        if end > step:
            several = f" of {count} numbers" if count > 1 else ""
            raise InputError(
                f"{name}: point_step: {step} bytes, field {shown(field.name, 40)}{several} ends "
                f"after {end}"
            )
        if len(names) + count > _MOST_NUMBERS:
            raise InputError(f"{name}: fields: more than {_MOST_NUMBERS:,} numbers a point")
        if field.name in _PACKED and count == 1 and kind.itemsize == 4:
            names += ["red", "green", "blue"]
            formats += [np.dtype("u1")] * 3
            offsets += [field.offset + i for i in ((1, 2, 3) if order == ">" else (2, 1, 0))]
            continue
        for i in range(count):
            names.append(f"{field.name}_{i}" if count > 1 else field.name)
            formats.append(kind)
            offsets.append(field.offset + i * kind.itemsize)
    if len(set(names)) < len(names):
        twice = max(names, key=names.count)
        raise InputError(f"{name}: fields: {shown(twice, 40)} is there twice")
    try:
        layout = np.dtype(
            {
                "names": ply.plain_names(names),
                "formats": formats,
                "offsets": offsets,
                "itemsize": step,
            }
        )
    except ValueError as error:
        raise InputError(f"{name}: point_step: {step} bytes: {error}") from error
    if width * step > message.row_step and height > 1:
        raise InputError(
            f"{name}: row_step: {message.row_step}, for {width} points of {step} bytes"
        )
    row = message.row_step if height > 1 else width * step
    if height * row > len(message.data):
        raise InputError(f"{name}: data: {len(message.data)} bytes, expected {height * row}")
    if step == 0 or width * height == 0:
        return np.zeros(0, layout)
    data = np.frombuffer(message.data, np.uint8)[: height * row].reshape(height, row)
    return np.ascontiguousarray(data[:, : width * step]).reshape(-1).view(layout)
