"""Maps in the messages of other packages, as splats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField

from rosplat_core.formats import ply
from rosplat_core.formats.decoded import Columns, IntoSplats, Warn
from rosplat_core.quaternions import from_matrices
from rosplat_core.splats import MAX_SH_DEGREE, SceneError, Splats, sh_coefficients

_TYPES = {
    PointField.INT8: "i1",
    PointField.UINT8: "u1",
    PointField.INT16: "i2",
    PointField.UINT16: "u2",
    PointField.INT32: "i4",
    PointField.UINT32: "u4",
    PointField.FLOAT32: "f4",
    PointField.FLOAT64: "f8",
}


def from_point_cloud(message: PointCloud2, name: str, warn: Warn) -> Splats:
    """Splats from a cloud whose fields are called, and mean, what a PLY's properties do.

    The fields are x y z, f_dc_*, opacity as logit, scale_* as logarithm, rot_* with w first, and
    f_rest_* where there are any. name: of the cloud, for errors. Raises SceneError for a cloud
    without the fields, or one that contradicts itself.
    """
    return ply.from_rows(Path(name), _rows(message, name), lambda _: None, warn, IntoSplats())


def _rows(message: PointCloud2, name: str) -> NDArray[np.void]:
    """A cloud's points as a structured array, a copy only if the rows are padded."""
    step, width, height = message.point_step, message.width, message.height
    fields = {f.name: f for f in message.fields if f.count == 1 and f.datatype in _TYPES}
    order = ">" if message.is_bigendian else "<"
    formats = [np.dtype(order + _TYPES[f.datatype]) for f in fields.values()]
    offsets = [f.offset for f in fields.values()]
    for field, start, kind in zip(fields, offsets, formats, strict=True):
        end = start + kind.itemsize
        if end > step:
            raise SceneError(f"{name}: point_step: {step} bytes, field {field} ends after {end}")
    try:
        layout = np.dtype(
            {"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": step}
        )
    except ValueError as error:
        raise SceneError(f"{name}: point_step: {step} bytes: {error}") from error
    if width * step > message.row_step and height > 1:
        raise SceneError(
            f"{name}: row_step: {message.row_step}, for {width} points of {step} bytes"
        )
    row = message.row_step if height > 1 else width * step
    if height * row > len(message.data):
        raise SceneError(f"{name}: data: {len(message.data)} bytes, expected {height * row}")
    if step == 0 or width * height == 0:
        return np.zeros(0, layout)
    data = np.frombuffer(message.data, np.uint8)[: height * row].reshape(height, row)
    return np.ascontiguousarray(data[:, : width * step]).reshape(-1).view(layout)


def from_splat_array(message: Any, name: str, warn: Warn) -> Splats:
    """Splats from a gsplat_msgs/SplatArray, whose shapes are covariances. Raises SceneError."""
    n = len(message.splats)
    degree = message.splats[0].harmonics_deg if n else 0
    if degree > MAX_SH_DEGREE:
        raise SceneError(f"{name}: harmonics_deg: {degree}, at most {MAX_SH_DEGREE}")
    k = sh_coefficients(degree)
    positions = np.empty((n, 3))
    covariances = np.empty((n, 3, 3))
    opacities = np.empty(n, np.float32)
    sh = np.empty((n, k, 3), np.float32)
    for i, splat in enumerate(message.splats):
        pose = splat.pose.pose
        if (have := len(splat.spherical_harmonics)) != 3 * k:
            raise SceneError(
                f"{name}: splats[{i}].spherical_harmonics: {have} numbers, expected {3 * k}"
            )
        positions[i] = pose.pose.position.x, pose.pose.position.y, pose.pose.position.z
        covariances[i] = np.reshape(pose.covariance, (6, 6))[:3, :3]
        opacities[i] = splat.opacity / 255
        sh[i] = np.reshape(splat.spherical_harmonics, (k, 3))
    finite = np.all(np.isfinite(covariances), axis=(1, 2))
    variances, vectors = np.linalg.eigh(np.where(finite[:, None, None], covariances, 0))
    vectors[np.linalg.det(vectors) < 0, :, 0] *= -1  # a rotation, not a reflection
    scales = np.sqrt(np.maximum(variances, 0)).astype(np.float32)
    scales[~finite] = np.nan
    columns = Columns(positions, from_matrices(vectors), scales, opacities, sh)
    return IntoSplats().make(Path(name), warn, columns)
