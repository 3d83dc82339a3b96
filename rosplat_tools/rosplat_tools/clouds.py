"""sensor_msgs/PointCloud2 of structured arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from rosplat_ros.messages import as_array

TYPES = {
    PointField.INT8: "i1",
    PointField.UINT8: "u1",
    PointField.INT16: "i2",
    PointField.UINT16: "u2",
    PointField.INT32: "i4",
    PointField.UINT32: "u4",
    PointField.FLOAT32: "f4",
    PointField.FLOAT64: "f8",
}
"""NumPy's names of PointField's types."""


def cloud(header: Header, points: NDArray[np.void]) -> PointCloud2:
    """A cloud of points (n,) with the array's fields."""
    numbers = {np.dtype(code): number for number, code in TYPES.items()}
    return PointCloud2(
        header=header,
        height=1,
        width=len(points),
        fields=[
            PointField(name=name, offset=offset, datatype=numbers[kind], count=1)
            for name, (kind, offset, *_) in (points.dtype.fields or {}).items()
        ],
        point_step=points.dtype.itemsize,
        row_step=points.nbytes,
        data=as_array("B", points),
        is_dense=True,
    )
