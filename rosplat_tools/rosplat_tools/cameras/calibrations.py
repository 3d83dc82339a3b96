"""Calibrations of cameras: CameraInfo messages, files, and lenses.

Files are YAML as camera_calibration writes it, or JSON with the parameters of an f-theta camera as
NVIDIA's NCore, NuRec and gsplat have them.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo

from rosplat_core.cameras import Camera
from rosplat_core.lenses import F_THETA, PLUMB_BOB, Lens, LensError
from rosplat_core.log_text import shown
from rosplat_core.splats import InputError

# By field of CameraInfo: the key in the file, and how many numbers there are.
_MATRICES = {
    "k": ("camera_matrix", 9),
    "d": ("distortion_coefficients", None),
    "r": ("rectification_matrix", 9),
    "p": ("projection_matrix", 12),
}
_OPTIONAL = ("r", "p")
_MOST_FOCAL = 1e9  # beyond, powers of it are too large for a float [px]
_MOST_SKEW = 0.5  # of an f-theta camera's picture, over all of it [px]


def of_lens(lens: Lens) -> CameraInfo:
    """The message for a lens, of a camera that isn't one of a stereo pair."""
    k = [lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0]
    return CameraInfo(
        width=lens.width,
        height=lens.height,
        distortion_model=lens.model or "plumb_bob",
        d=list(lens.coefficients) or [0.0] * 5,
        k=k,
        r=np.eye(3).ravel(),
        p=[*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0],
    )


def of_pinhole(camera: Camera) -> CameraInfo:
    """The message for a camera without distortion, for which the first pixel's centre is (0, 0)."""
    centre = camera.cx - 0.5, camera.cy - 0.5
    return of_lens(Lens(camera.width, camera.height, camera.fx, camera.fy, *centre))


def lens_of(info: CameraInfo) -> Lens:
    """The lens of a camera's own, distorted pictures. Raises LensError, naming the field."""
    _check_window(info)
    k = info.k
    return Lens(
        info.width, info.height, k[0], k[4], k[2], k[5], info.distortion_model, tuple(info.d)
    )


def rectified(info: CameraInfo) -> tuple[Lens, NDArray[np.float64]]:
    """The lens of rectified pictures, and the rotation (3, 3) from the camera into it.

    Raises LensError, naming the field.
    """
    _check_window(info)
    # Drivers of one camera leave zeros.
    rotation, p = np.reshape(info.r, (3, 3)) if any(info.r) else np.eye(3), info.p
    if not np.allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-4):
        raise LensError("r: expected a rotation")
    try:
        return Lens(info.width, info.height, p[0], p[5], p[2], p[6]), rotation
    except LensError as error:
        raise LensError(str(error).replace("k:", "p:")) from error


def _check_window(info: CameraInfo) -> None:
    """Raises LensError if pictures are binned or of a part of the sensor."""
    if max(info.binning_x, info.binning_y) > 1:
        raise LensError(f"binning is {info.binning_x} x {info.binning_y}, expected none")
    roi = info.roi
    if (roi.width or roi.height) and (roi.width, roi.height) != (info.width, info.height):
        raise LensError(f"roi is {roi.width} x {roi.height}, expected the whole picture")


def load(path: str) -> CameraInfo:
    """Reads a calibration: YAML of camera_calibration, or JSON of an f-theta camera.

    Raises InputError, naming the file and the key.
    """
    kind, parse = ("JSON", json.loads) if path.endswith(".json") else ("YAML", yaml.safe_load)
    try:
        content = parse(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{shown(path)}: {error.strerror or error}") from error
    except (
        ValueError,
        RecursionError,
        yaml.YAMLError,
    ) as error:  # a date, many digits
        raise InputError(f"{shown(path)}: no {kind}: {shown(error, 200)}") from error
    try:
        info = _read(content)
        lens_of(info)
    except LensError as error:
        raise InputError(f"{shown(path)}: {error}") from error
    return info


def _read(content: Any) -> CameraInfo:
    if not isinstance(content, dict):
        raise LensError("expected keys and values")
    if "angle_to_pixeldist_poly" in content:
        return of_lens(_f_theta(content))
    info = CameraInfo()
    for field, key in (("width", "image_width"), ("height", "image_height")):
        setattr(info, field, *_pixels([content.get(key)], key))
    model = content.get("distortion_model", PLUMB_BOB)  # as ROS's own parser
    if not isinstance(model, str):
        raise LensError(f"distortion_model is {shown(model)!r}, expected a name")
    info.distortion_model = model
    for field, (key, count) in _MATRICES.items():
        if field in _OPTIONAL and key not in content:
            continue
        setattr(info, field, _numbers(content.get(key), key, count))
    if not info.r.any():
        info.r = np.eye(3).ravel()
    return info


def _f_theta(content: dict[str, Any]) -> Lens:
    """The lens of an f-theta camera, whose polynomials are of pixels."""

    def numbers(key: str, count: int) -> list[float]:
        return _numbers({"data": content.get(key)}, key, count)

    width, height = _pixels(numbers("resolution", 2), "resolution")
    cx, cy = numbers("principal_point", 2)
    forward, back = numbers("angle_to_pixeldist_poly", 6), numbers("pixeldist_to_angle_poly", 6)
    c, d, e = numbers("linear_cde", 3) if "linear_cde" in content else (1.0, 0.0, 0.0)
    if max(abs(d), abs(e)) * max(width, height) > _MOST_SKEW:
        raise LensError(f"linear_cde is {c}, {d}, {e}: a skewed picture")
    focal = forward[1]
    if not 0 < focal < _MOST_FOCAL:
        expected = f"more than 0, less than {_MOST_FOCAL:.0e}"
        raise LensError(f"angle_to_pixeldist_poly rises by {focal}, expected {expected}")
    (most,) = _numbers({"data": [content.get("max_angle", 0.0)]}, "max_angle", 1)
    coefficients = [*(k / focal for k in forward), most]
    reference = content.get("reference_poly")
    if reference == "PIXELDIST_TO_ANGLE":
        coefficients += [k * focal**power for power, k in enumerate(back)]
    elif reference != "ANGLE_TO_PIXELDIST":
        known = "ANGLE_TO_PIXELDIST or PIXELDIST_TO_ANGLE"
        raise LensError(f"reference_poly is {shown(reference)!r}, expected {known}")
    return Lens(width, height, c * focal, focal, cx, cy, F_THETA, tuple(coefficients))


def _pixels(values: list[Any], key: str) -> list[int]:
    """Whole numbers of pixels. Raises LensError for what is none."""
    for value in values:
        if not isinstance(value, int | float) or value % 1 != 0 or not 0 < value < 1 << 31:
            raise LensError(f"{key} is {shown(value)!r}, expected a whole number of pixels")
    return list(map(int, values))


def _numbers(matrix: Any, key: str, count: int | None) -> list[float]:
    data = matrix.get("data") if isinstance(matrix, dict) else None
    if not isinstance(data, list) or not all(isinstance(value, int | float) for value in data):
        raise LensError(f"{key}: no data, or not of numbers")
    if count is not None and len(data) != count:
        raise LensError(f"{key}: {len(data)} numbers, expected {count}")
    try:
        return [float(value) for value in data]
    except OverflowError as error:
        raise LensError(f"{key}: a number beyond 64 bits") from error
