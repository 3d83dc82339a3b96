"""PointCloud2s of splats, and what is in others."""

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


def points_of(message: PointCloud2) -> np.ndarray:
    """The points (n,) of a cloud, by the names of its fields."""
    kinds = {PointField.FLOAT32: "<f4", PointField.UINT16: "<u2"}
    kind = np.dtype(
        {
            "names": [field.name for field in message.fields],
            "formats": [kinds[field.datatype] for field in message.fields],
            "offsets": [field.offset for field in message.fields],
            "itemsize": message.point_step,
        }
    )
    return np.frombuffer(message.data, kind)
