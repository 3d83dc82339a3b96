"""Poses refined by pictures: how many starts end at the camera, by how far off they are."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rosplat_core.alignment import Alignment, align, motion
from rosplat_core.cameras import Camera, place
from rosplat_core.quaternions import from_matrices
from rosplat_core.rendering import CpuRenderer
from rosplat_core.scenes import ROOMS
from rosplat_lab.bench import scenes
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Doing, Event, Measurement

DEFAULT = ("rooms:100000",)
SIZE = 320, 180  # of pictures [px]
# By how much starts are off: degrees, and per cent of the scene's radius.
OFF, QUICK_OFF = ((1, 1.7), (2, 3.3), (3, 5), (5, 8.3), (8, 13.3), (12, 20)), ((3, 5),)
STARTS, QUICK_STARTS = 100, 10
NEAR_ENOUGH = 0.05, 0.1  # errors of a start that ended well [degrees, per cent of the radius]
NOISE = 0.01  # standard deviation, of colours of 0 to 1
COVERED = 0.1  # share of the picture that something hides
PICTURES = ("plain", "covered")


class _Ended(NamedTuple):
    degrees: float  # off
    percent: float  # off, of the radius
    square: float  # of the error by its covariance; chi-squared of 6 has a median of 5.3
    converged: bool
    seconds: float
    processor: float  # of all threads [s]

    @property
    def well(self) -> bool:
        return self.degrees < NEAR_ENOUGH[0] and self.percent < NEAR_ENOUGH[1]


def measure(plan: Plan) -> Iterator[Event]:
    """Shares of starts by how far off they are, and seconds."""
    names = plan.scenes or DEFAULT
    offs = QUICK_OFF if plan.quick else OFF
    kinds = [(name, picture, off) for name in names for picture in PICTURES for off in offs]
    loaded, scene = "", None
    for number, (name, picture, off) in enumerate(kinds):
        yield Doing(f"{name}, {picture}, {off[0]} degrees", number / len(kinds))
        if scene is None or loaded != name:
            loaded, scene = name, _Scene(name, QUICK_STARTS if plan.quick else STARTS)
        yield from scene.measure(picture, *off)


class _Scene:
    def __init__(self, name: str, starts: int) -> None:
        self._name, splats = name, scenes.load(name)
        self._renderer, self._splats = CpuRenderer(splats), len(splats)
        self._radius = place(splats).radius
        self._view = "room" if name.startswith(ROOMS) else "overview"
        if self._view == "room":
            self._cameras = scenes.room(splats, *SIZE, starts)
        else:
            self._cameras = scenes.overview(splats, *SIZE, starts, step=2 * math.pi / starts)

    def measure(self, picture: str, degrees: float, percent: float) -> Iterator[Measurement]:
        rng = np.random.default_rng(1)
        ended = [self._run(camera, picture, degrees, percent, rng) for camera in self._cameras]
        of = partial(
            Measurement, scene=self._name, splats=self._splats, view=self._view,
            picture=picture, degrees=degrees, percent=percent,
        )  # fmt: skip
        yield of("success", "share", np.mean([each.well for each in ended]))
        wrong = [each.converged and not each.well for each in ended]
        yield of("converged, though off", "share", np.mean(wrong))
        yield of("alignment", "s", [each.seconds for each in ended])
        yield of("processor time", "s", [each.processor for each in ended])
        squares = [each.square for each in ended if each.well and each.converged]
        if squares:
            yield of("square of the error by its covariance", "", squares)
        for name, unit, errors in (
            ("rotation left", "degrees", [each.degrees for each in ended if each.well]),
            ("translation left", "% of the radius", [each.percent for each in ended if each.well]),
        ):
            if errors:
                yield of(name, unit, errors)

    def _run(
        self, camera: Camera, picture: str, degrees: float, percent: float, rng: np.random.Generator
    ) -> _Ended:
        taken = _taken(self._renderer.render(camera)[..., :3], picture == "covered", rng)
        along, about = (_direction(rng) for _ in range(2))
        step = [*(percent / 100 * self._radius * along), *(math.radians(degrees) * about)]
        start = np.asarray(np.linalg.inv(camera.camera_to_world @ motion(step)), np.float64)
        began, spent = time.perf_counter(), time.process_time()
        found = align(self._renderer, taken, replace(camera, world_to_camera=start))
        seconds, processor = time.perf_counter() - began, time.process_time() - spent
        degrees, metres, square = _off(found, camera)
        percent = 100 * metres / self._radius
        return _Ended(degrees, percent, square, found.converged, seconds, processor)


def _taken(
    colours: NDArray[np.float32], covered: bool, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """A camera's picture: with an exposure, noise, 8 bits, and maybe something in front."""
    exposed = rng.uniform(0.8, 1.2) * colours + rng.uniform(-0.03, 0.03)
    if covered:
        height, width = (round(side * math.sqrt(COVERED)) for side in exposed.shape[:2])
        top, left = (
            rng.integers(whole - part)
            for whole, part in zip(exposed.shape[:2], (height, width), strict=True)
        )
        exposed[top : top + height, left : left + width] = rng.uniform(size=3)
    noisy = exposed + rng.normal(scale=NOISE, size=exposed.shape)
    return (255 * np.clip(noisy, 0, 1) + 0.5).astype(np.uint8)


def _direction(rng: np.random.Generator) -> NDArray[np.float64]:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def _off(found: Alignment, camera: Camera) -> tuple[float, float, float]:
    """Errors of rotation [degrees] and translation [m]; their square by the covariance."""
    pose = np.linalg.inv(found.world_to_camera)
    along = pose[:3, 3] - camera.position
    *axis, cosine = from_matrices(pose[:3, :3] @ camera.camera_to_world[:3, :3].T)
    turn = 2 * np.sign(cosine) * np.array(axis)  # as a rotation vector: it is small
    error = np.concatenate([along, turn])
    square = math.inf
    if found.converged:
        square = float(error @ np.linalg.solve(found.covariance, error))
    sine = min(float(np.linalg.norm(axis)), 1.0)
    return math.degrees(2 * math.asin(sine)), float(np.linalg.norm(along)), square
