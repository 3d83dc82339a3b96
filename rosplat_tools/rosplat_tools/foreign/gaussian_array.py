"""gaussian_interface/GaussianArray, of shadygm/ROSplat and Photo-SLAM-ROS: a message a splat.

Arrays add up: each adds its splats to the map, unless its `refresh` begins the map anew. Scales are
linear, quaternions have w first, opacities have 8 bits. No message names a frame. Until May 2025,
the numbers were fields x, y, z, w of geometry_msgs, in the same order, and opacities floats.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from std_msgs.msg import Header

from rosplat_core.formats.decoded import Columns, IntoSplats, Warn
from rosplat_core.splats import MAX_SH_DEGREE, InputError, Splats, concatenate, sh_coefficients
from rosplat_ros.messages import message_class
from rosplat_tools.foreign import MapReader

TYPE = "gaussian_interface/msg/GaussianArray"
TOPIC = "gaussian_model"
DEPTH = 1000  # a map is many messages
FIELDS = ("gaussians",)

AT_A_TIME = 4000  # splats in a message, as its authors send them

_DEGREES = {3 * sh_coefficients(degree): degree for degree in range(MAX_SH_DEGREE + 1)}


class Reader(MapReader):
    """All splats since the map began."""

    def __init__(self, name: str, warn: Warn) -> None:
        super().__init__(name, warn)
        self._parts: list[Splats] = []

    def add(self, message: Any) -> bool:
        """Raises InputError for an array that contradicts itself; nothing of it is added."""
        part = _splats(message, self._name, self._warn)
        if getattr(message, "refresh", False):
            self._parts.clear()
        self._parts.append(part)
        return True

    def splats(self) -> Splats:
        """The map as it is."""
        self._parts[:] = [concatenate(self._parts)]
        return self._parts[0]


def messages(kind: Any, splats: Splats, header: Header) -> Iterator[Any]:
    """Arrays of AT_A_TIME splats, the first of which begins the map anew."""
    splat_kind = message_class("gaussian_interface/msg/SingleGaussian")
    example = splat_kind()
    for first in range(0, max(len(splats), 1), AT_A_TIME):
        part = splats[first : first + AT_A_TIME]
        rows = zip(
            (part.positions + part.origin).astype(np.float32),
            np.roll(part.orientations, 1, axis=1),
            part.scales,
            _opacities(part.opacities, example.opacity),
            part.sh.reshape(len(part), 3 * part.sh.shape[1]),
            strict=True,
        )
        array = kind()
        if hasattr(array, "refresh"):  # older definitions lack it
            array.refresh = first == 0
        array.gaussians = [
            splat_kind(
                xyz=_like(example.xyz, xyz), rotation=_like(example.rotation, rotation),
                scale=_like(example.scale, scale), opacity=opacity, spherical_harmonics=sh.tolist(),
            )
            for xyz, rotation, scale, opacity, sh in rows
        ]  # fmt: skip
        yield array


def _splats(message: Any, name: str, warn: Warn) -> Splats:
    given = message.gaussians
    count = len(given[0].spherical_harmonics) if len(given) else 3
    if count not in _DEGREES:
        known = ", ".join(map(str, _DEGREES))
        raise InputError(
            f"{name}: gaussians[0].spherical_harmonics: {count} numbers, known are {known}"
        )
    for i, splat in enumerate(given):
        if (have := len(splat.spherical_harmonics)) != count:
            raise InputError(
                f"{name}: gaussians[{i}].spherical_harmonics: {have} numbers, expected {count}"
            )
    columns = Columns(
        np.array([_numbers(splat.xyz) for splat in given], np.float64).reshape(-1, 3),
        np.roll(np.array([_numbers(s.rotation) for s in given], np.float32).reshape(-1, 4), -1, 1),
        np.array([_numbers(splat.scale) for splat in given], np.float32).reshape(-1, 3),
        np.array(
            [s.opacity / 255 if isinstance(s.opacity, int) else s.opacity for s in given],
            np.float32,
        ),
        np.array([splat.spherical_harmonics for splat in given], np.float32).reshape(
            -1, count // 3, 3
        ),
    )
    return IntoSplats().make(Path(name), warn, columns)


def _numbers(field: Any) -> Any:
    """The numbers of a field, which may be a message of geometry_msgs."""
    return [getattr(field, name) for name in _names(field)] or field


def _like(field: Any, numbers: Any) -> Any:
    """Numbers for a field, which may be a message of geometry_msgs."""
    named = zip(_names(field), map(float, numbers), strict=False)
    return type(field)(**dict(named)) if _names(field) else numbers


def _names(field: Any) -> list[str]:
    return [*getattr(field, "get_fields_and_field_types", dict)()]


def _opacities(opacities: Any, field: Any) -> list[Any]:
    if isinstance(field, float):
        return list(map(float, opacities))
    return list(map(int, np.rint(255 * np.clip(opacities, 0, 1))))
