"""The one in-memory form of a map of 3D Gaussians. Knows no ROS and no file format."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core import harmonics
from rosplat_core.channels import joined
from rosplat_core.log_text import shown
from rosplat_core.models import Model
from rosplat_core.quaternions import from_matrices, product
from rosplat_core.rigid import rigid

_log = logging.getLogger(__name__)
_said: set[str] = set()  # what was warned of, once in a process

LOW_PASS = 0.3  # added to the variance of every splat [px^2]; part of the trained model
MAX_SH_DEGREE = 3

# float32 holds half a millimetre at this distance from zero; farther out, an origin is needed.
FAR_FROM_ZERO = 1e4

MOST_LOOKED_AT = 10_000  # splats that are looked at to tell what their numbers mean

LONGEST_ERROR = 10_000  # of an error's text, which may hold a path or a URL [characters]


class InputError(ValueError):
    """A scene, camera or option that can't be used. The text is one line, meant for the user."""

    def __init__(self, text: str) -> None:
        """Escapes control characters. Callers that quote a file's content cut the quotation."""
        super().__init__(shown(text, LONGEST_ERROR))


@dataclass(frozen=True, eq=False)
class Splats:
    """A set of n 3D Gaussians with view-dependent colour (Kerbl et al. 2023).

    Lengths are in metres, in a right-handed frame of the caller's. A Gaussian's own axes are turned
    into that frame by its orientation. Scales and opacities are those that are drawn: a trainer's
    parameters, logarithms and logits, go through from_trained. Colour is 0.5 plus the harmonics
    towards the splat, in the order and sign of the 3DGS code, not linear light.

    Arrays of another dtype are converted; a wrong shape, or an origin that is not finite, raises
    ValueError.
    """

    positions: NDArray[np.float32]
    """(n, 3) means, relative to origin. [m]"""
    orientations: NDArray[np.float32]
    """(n, 4) quaternions x, y, z, w of unit length."""
    scales: NDArray[np.float32]
    """(n, 3) standard deviations along the Gaussian's own axes, linear. [m]"""
    opacities: NDArray[np.float32]
    """(n,) peak opacities, 0 to 1."""
    sh: NDArray[np.float32]
    """(n, k, 3) spherical harmonics, k = (degree + 1)^2, RGB last."""
    origin: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    """(3,) added to each position in float64. [m]"""
    model: Model = Model.EWA
    """How they become pixels, which is how they were trained; a name such as "ray" will do."""
    up: tuple[float, float, float] | None = None
    """The vertical, a unit vector in these coordinates; None where nobody told it."""
    channels: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    """(n,) values by name that the splats carry, e.g. "label"; not finite where there is none."""

    @classmethod
    def from_trained(
        cls,
        means: ArrayLike,
        quaternions_wxyz: ArrayLike,
        log_scales: ArrayLike,
        logits: ArrayLike,
        sh0: ArrayLike,
        shN: ArrayLike | None = None,
        *,
        model: Model | str = Model.EWA,
        channels: Mapping[str, ArrayLike] | None = None,
    ) -> Splats:
        """Makes splats of a trainer's parameters, NumPy arrays or torch tensors on any device.

        means (n, 3) [m]; quaternions_wxyz (n, 4) of any length; log_scales (n, 3), or (n, 1) for
        spheres; logits of the opacities (n,) or (n, 1); sh0 (n, 1, 3) and shN (n, k, 3), as gsplat
        and 3DGS keep them (features_dc, features_rest); channels (n,) each. Raises ValueError for
        another shape.
        """
        n = len(_host(means))
        positions = _shaped("means", means, (n, 3))
        quaternions = _shaped("quaternions_wxyz", quaternions_wxyz, (n, 4))
        scales = _shaped("log_scales", log_scales, (n, 3), (n, 1))
        opacities = _shaped("logits", logits, (n,), (n, 1)).reshape(n)
        bands = [_shaped("sh0", sh0, (n, 1, 3))]
        if shN is not None:
            rests = [(n, sh_coefficients(degree) - 1, 3) for degree in range(MAX_SH_DEGREE + 1)]
            bands.append(_shaped("shN", shN, *rests))
        lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
        with np.errstate(over="ignore"):  # a logit of -100 is an opacity of 0
            scales = np.exp(scales)
            opacities = 1 / (1 + np.exp(-opacities))
        return cls(
            positions=positions,
            orientations=np.roll(quaternions / np.where(lengths > 0, lengths, 1), -1, axis=1),
            scales=np.broadcast_to(scales, (n, 3)),
            opacities=opacities,
            sh=bands[0] if len(bands) == 1 else np.concatenate(bands, axis=1),
            model=Model.of(model),
            channels={name: _host(values) for name, values in (channels or {}).items()},
        )

    def __post_init__(self) -> None:
        """Converts each array to its dtype and checks its shape.

        Positions of another dtype than float32 are rebased: an origin takes over what float32 would
        lose of them.
        """
        object.__setattr__(self, "model", Model.of(self.model))
        positions = _given("positions", self.positions)
        n = len(positions) if positions.ndim else 0
        if positions.dtype != np.float32 and positions.shape == (n, 3):
            near, shift = rebase(positions)
            object.__setattr__(self, "positions", near)
            if shift.any():
                object.__setattr__(self, "origin", shift + np.asarray(self.origin, np.float64))
        shapes: dict[str, tuple[int, ...]] = {
            "positions": (n, 3),
            "orientations": (n, 4),
            "scales": (n, 3),
            "opacities": (n,),
            "sh": (n, sh_coefficients(self.sh_degree), 3),
            "origin": (3,),
        }
        for name, shape in shapes.items():
            dtype = np.float64 if name == "origin" else np.float32
            with np.errstate(over="ignore"):  # to infinity: publishers drop such splats and warn
                array = np.ascontiguousarray(_given(name, getattr(self, name)), dtype)
            if array.shape != shape:
                raise ValueError(f"Splats.{name}: expected shape {shape}, got {array.shape}")
            object.__setattr__(self, name, array)
        if not np.isfinite(self.origin).all():
            raise ValueError(f"Splats.origin: not finite: {self.origin.tolist()}")
        if self.up is not None:
            object.__setattr__(self, "up", unit(self.up))
        if not isinstance(self.channels, Mapping):
            raise TypeError(
                f"Splats.channels: expected {{name: values}}, got {self.channels!r:.40}"
            )
        joined((), tuple(self.channels))
        channels = {
            name: np.ascontiguousarray(_given(f"channels['{name}']", values), np.float32)
            for name, values in self.channels.items()
        }
        for name, values in channels.items():
            if values.shape != (n,):
                raise ValueError(
                    f"Splats.channels['{name}']: expected shape {(n,)}, got {values.shape}"
                )
        object.__setattr__(self, "channels", channels)
        told = "scales are negative: logarithms?", "opacities are not from 0 to 1: logits?"
        for text, is_so in zip(told, as_trained(self.scales, self.opacities), strict=True):
            if is_so and text not in _said:
                _said.add(text)
                _log.warning("Splats: %s; Splats.from_trained takes a trainer's parameters", text)

    def __repr__(self) -> str:
        """One line: how many, their degree, vertical and bounds."""
        told = [f"{len(self):,} splats", f"SH degree {self.sh_degree}"]
        if self.up is not None:
            told.append(f"up {_numbers(self.up)}")
        if len(self):
            with np.errstate(over="ignore", invalid="ignore"):
                low, high = (f.reduce(self.positions) + self.origin for f in (np.fmin, np.fmax))
            told.append(f"from {_numbers(low)} to {_numbers(high)} m")
        told += [f"model {self.model}"] * (self.model is not Model.EWA)
        told += [f"channels {', '.join(self.channels)}"] * bool(self.channels)
        return f"Splats({', '.join(told)})"

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, index: slice | NDArray[np.integer] | NDArray[np.bool_]) -> Splats:
        """The splats that a slice, an index array or a mask picks."""
        if isinstance(index, Integral):
            raise TypeError(f"Splats: a slice picks splats, such as [{index}:{int(index) + 1}]")
        return replace(
            self,
            positions=self.positions[index],
            orientations=self.orientations[index],
            scales=self.scales[index],
            opacities=self.opacities[index],
            sh=self.sh[index],
            channels={name: values[index] for name, values in self.channels.items()},
        )

    @property
    def sh_degree(self) -> int:
        """Highest band of spherical harmonics, 0 to 3."""
        k = np.shape(self.sh)[1] if np.ndim(self.sh) == 3 else 0
        for degree in range(MAX_SH_DEGREE + 1):
            if k == sh_coefficients(degree):
                return degree
        raise ValueError(f"Splats.sh: expected shape (n, 1|4|9|16, 3), got {np.shape(self.sh)}")

    def channel(self, name: str) -> NDArray[np.float32]:
        """(n,) values of a channel, NaN where there are none."""
        values = self.channels.get(name)
        return np.full(len(self), np.nan, np.float32) if values is None else values

    @property
    def arrays(self) -> tuple[NDArray[np.float32], ...]:
        """Every array with a row for each splat."""
        drawn = (self.positions, self.orientations, self.scales, self.opacities, self.sh)
        return (*drawn, *self.channels.values())

    @property
    def nbytes(self) -> int:
        """Memory that the arrays take. [bytes]"""
        return sum(array.nbytes for array in self.arrays)

    def with_sh_degree(self, degree: int) -> Splats:
        """The same splats with bands cut off, or zero bands added, to a degree of 0 to 3."""
        if degree not in range(MAX_SH_DEGREE + 1):
            raise ValueError(f"degree is {degree!r}, expected 0 to {MAX_SH_DEGREE}")
        k = sh_coefficients(degree)
        missing = max(0, k - self.sh.shape[1])
        return replace(self, sh=np.pad(self.sh[:, :k], ((0, 0), (0, missing), (0, 0))))

    def without_empty_bands(self) -> Splats:
        """The same splats without the top bands that are zero in all of them."""
        degree = self.sh_degree
        while degree > 0 and not self.sh[:, sh_coefficients(degree - 1) :].any():
            degree -= 1
        return self if degree == self.sh_degree else self.with_sh_degree(degree)

    def moved(self, pose: ArrayLike) -> Splats:
        """The same splats in another frame.

        pose: their present frame in the other one, a rigid transform (4, 4) [m], or ValueError.
        Orientations and harmonics turn with it; the origin becomes the old origin's place in the
        other frame.
        """
        pose = rigid(pose, "pose")
        rotation = pose[:3, :3]
        return replace(
            self,
            positions=(self.positions @ rotation.T).astype(np.float32),
            orientations=product(from_matrices(rotation), self.orientations).astype(np.float32),
            sh=harmonics.turned(self.sh, rotation),
            origin=rotation @ self.origin + pose[:3, 3],
            up=None if self.up is None else tuple(rotation @ self.up),
        )


@dataclass(frozen=True, eq=False)
class PackedSplats:
    """Splats in less than half of the memory, in the precision of a display's own map.

    Positions and channels are exact; packed_slot.hpp has the format of the rest.
    """

    rows: NDArray[np.uint32]
    """(n, 8 + (degree + 1)^2) words: each splat's packed slot, then its bands above 0."""
    sh_degree: int
    """Highest band of spherical harmonics, 0 to 3."""
    origin: NDArray[np.float64]
    model: Model
    channels: Mapping[str, NDArray[np.float32]]
    up: tuple[float, float, float] | None = None

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def arrays(self) -> tuple[NDArray[np.generic], ...]:
        """Every array with a row for each splat."""
        return (self.rows, *self.channels.values())


def check_kind(value: object, kind: type, name: str) -> None:
    """Raises TypeError, which begins with name, for a value of another kind."""
    if not isinstance(value, kind):
        hint = "; rosplat_core.load reads a file" if kind is Splats else ""
        raise TypeError(f"{name}: expected {kind.__name__}, got {type(value).__name__}{hint}")


def check_splats(splats: object, name: str = "splats") -> None:
    """As check_kind."""
    check_kind(splats, Splats, name)


def as_trained(
    scales: NDArray[np.floating[Any]], opacities: NDArray[np.floating[Any]]
) -> tuple[bool, bool]:
    """Whether scales (n, 3) and opacities (n, ...), which should be linear, are logarithms and
    logits.

    They are where most can be nothing else.
    """

    def are_most(which: NDArray[np.bool_]) -> bool:
        return bool(2 * np.count_nonzero(which) > which.size)

    step = len(scales) // MOST_LOOKED_AT + 1
    some = opacities[::step]
    return are_most(scales[::step] < 0), are_most((some < 0) | (some > 1))


def _numbers(values: ArrayLike) -> str:
    return " ".join(f"{value:.4g}" for value in np.asarray(values))


def _shaped(name: str, array: ArrayLike, *shapes: tuple[int, ...]) -> NDArray[np.floating[Any]]:
    """As _host. Raises ValueError, naming the array, for a shape that is none of `shapes`."""
    values = _host(array)
    if values.shape not in shapes:
        known = " or ".join(map(str, shapes))
        raise ValueError(f"{name}: expected shape {known}, got {values.shape}")
    return values


def unit(up: ArrayLike) -> tuple[float, float, float]:
    """A vertical of any length as a unit vector. Raises ValueError for none."""
    try:
        vector = np.asarray(up, np.float64)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    length = np.linalg.norm(vector)
    if vector.shape != (3,) or not 0 < length < np.inf:
        raise ValueError(f"up: expected three numbers, not all 0, got {up!r}")
    x, y, z = (vector / length).tolist()
    return (x, y, z)


def _given(name: str, array: ArrayLike) -> NDArray[np.floating[Any]]:
    """As _host. Raises ValueError, naming the field, for what is no array of numbers."""
    try:
        return _host(array)
    except (TypeError, ValueError) as error:
        raise ValueError(f"Splats.{name}: {error}") from error


def _host(array: ArrayLike) -> NDArray[np.floating[Any]]:
    """An array or tensor as a floating NumPy array, without a copy where that is possible."""
    detach = getattr(array, "detach", None)  # torch's, without importing torch
    values = np.asarray(detach().cpu() if detach else array)
    return values if np.issubdtype(values.dtype, np.floating) else values.astype(np.float32)


def sh_coefficients(degree: int) -> int:
    """Number of spherical harmonics up to a degree."""
    return (degree + 1) ** 2


def splat_bytes(sh_degree: int) -> int:
    """Size of a splat in arrays. [bytes]"""
    floats = 3 + 4 + 3 + 1 + 3 * sh_coefficients(sh_degree)
    return 4 * floats


def rebase(positions: NDArray[np.floating[Any]]) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Splits (n, 3) positions into float32 offsets and a float64 origin (3,). [m]

    The origin is zero unless a position lies so far out that float32 would lose it. Then the origin
    is the median of the finite positions, which a stray splat does not move, rounded to 100 m, so
    that a growing map mostly keeps its origin.
    """
    origin = np.zeros(3)
    if np.fmax.reduce(np.abs(positions), axis=None, initial=0.0) > FAR_FROM_ZERO:
        # Positions beyond float32 are lost with any origin, so they have no say in it.
        finite = positions[(np.abs(positions) <= np.finfo(np.float32).max).all(axis=1)]
        if len(finite):
            origin = 100 * np.round(np.median(finite, axis=0) / 100)
            positions = positions - origin
    with np.errstate(over="ignore"):  # to infinity: publishers drop such splats and warn
        return positions.astype(np.float32), origin


def concatenate(parts: Sequence[Splats]) -> Splats:
    """Joins sets of splats, in order; the result has the highest degree.

    Parts of one origin keep it and all of their bits; else most of the splats have a say in a new
    one. The vertical is that of all parts, or unknown. Where a part lacks a channel, its splats
    have NaN. Raises ValueError without any part, when parts are of different models, or for more
    channels than a map can have.
    """
    if not parts:
        raise ValueError("nothing to concatenate")
    for part in parts:
        check_splats(part, "parts")
    if len(models := {part.model for part in parts}) > 1:
        told = " and ".join(map(str, sorted(models)))
        raise ValueError(f"can't join splats of the models {told}: they are drawn differently")
    first = parts[0]
    degree = max(part.sh_degree for part in parts)
    names = dict.fromkeys(name for part in parts for name in part.channels)
    apart = any((part.origin != first.origin).any() for part in parts)
    return replace(
        first,
        positions=np.concatenate([p.positions + p.origin if apart else p.positions for p in parts]),
        origin=np.zeros(3) if apart else first.origin,
        orientations=np.concatenate([p.orientations for p in parts]),
        scales=np.concatenate([p.scales for p in parts]),
        opacities=np.concatenate([p.opacities for p in parts]),
        sh=np.concatenate([p.with_sh_degree(degree).sh for p in parts]),
        up=first.up if all(part.up == first.up for part in parts) else None,
        channels={name: np.concatenate([p.channel(name) for p in parts]) for name in names},
    )
