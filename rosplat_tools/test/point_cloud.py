"""Splats as a PointCloud2."""

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField

from rosplat_core.formats import ply
from rosplat_core.splats import Splats


def cloud(splats: Splats, big_endian: bool = False, height: int = 1, gap: int = 0) -> PointCloud2:
    """The rows of a PLY as a cloud."""
    rows = ply.to_rows(splats)
    if big_endian:
        rows = rows.astype(rows.dtype.newbyteorder(">"))
    assert rows.dtype.names
    fields = [
        PointField(name=name, offset=rows.dtype.fields[name][1], datatype=7, count=1)
        for name in rows.dtype.names
    ]
    width, step = len(rows) // height, rows.dtype.itemsize
    data = np.frombuffer(rows.tobytes(), np.uint8).reshape(height, width * step)
    return PointCloud2(
        fields=fields,
        width=width,
        height=height,
        point_step=step,
        row_step=width * step + gap,
        is_bigendian=big_endian,
        data=np.pad(data, ((0, 0), (0, gap))).tobytes(),
    )
