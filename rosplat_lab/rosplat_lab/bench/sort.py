"""How long a depth order takes, by every backend of the sorter."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from rosplat_core import depth, rendering
from rosplat_core.ordering import view_of
from rosplat_core.splats import InputError, Splats
from rosplat_core.view import SortView
from rosplat_lab.bench import scenes
from rosplat_lab.bench.plan import GPU, PROCESSOR, Plan
from rosplat_lab.bench.records import Doing, Event, Measurement, Skipped, milliseconds
from rosplat_sorter.backends import (
    BACKENDS,
    Allocate,
    Unavailable,
    new_array,
    open_backend,
)
from rosplat_sorter.map import SplatMap

SIZES = (100_000, 250_000, 500_000, 1_000_000, 2_000_000, 5_000_000, 10_000_000)
QUICK_SIZES = (50_000, 250_000)
VIEWS = ("all", "inside")
PICTURE = (1280, 720)
STEPS = 16  # cameras that take turns, so that no order is that of the sort before

HOST = "order in host memory"
PINNED = "order in pinned memory"


def measure(plan: Plan) -> Iterator[Event]:
    """Times of HOST and PINNED by scene, view and method."""
    names = scenes.names(plan.sizes or (QUICK_SIZES if plan.quick else SIZES), plan.scenes)
    methods = _methods(plan.backends)
    unavailable: set[str] = set()
    for number, name in enumerate(names):
        yield Doing(f"{name}: loading", number / len(names))
        splats = scenes.load(name)
        sorted_map = map_of(splats)
        views = {
            kind: [view_of(c, splats) for c in scenes.VIEWS[kind](splats, *PICTURE, STEPS)]
            for kind in VIEWS
        }
        for index, (method, (backend, threads)) in enumerate(methods.items()):
            if method in unavailable:
                continue
            yield Doing(f"{name}: {method}", (number + index / len(methods)) / len(names))
            try:
                label, ways = _opened(sorted_map, backend, threads)
            except (Unavailable, ImportError, RuntimeError, MemoryError) as error:
                unavailable.add(method)
                yield Skipped(f"{method}: {str(error).splitlines()[0]}")
                continue
            for quantity, sort in ways.items():
                for kind, seen in views.items():
                    visible, times = _timed(plan, name, sorted_map, quantity, label, sort, seen)
                    yield Measurement(
                        quantity, "ms", times, name, len(splats),
                        method=label, view=kind, visible=visible,
                    )  # fmt: skip


Sort = Callable[[SortView], NDArray[np.uint32]]


def _methods(backends: Sequence[str]) -> dict[str, tuple[str, int]]:
    """Backends and their threads, 0 for as many as there are, by what they are called.

    backends: of the sorter; empty: all. Raises InputError for an unknown one.
    """
    found: dict[str, tuple[str, int]] = {}
    for name in backends or tuple(BACKENDS):
        if name in (GPU, PROCESSOR):
            continue  # the viewer's, which `frame` measures
        if name not in BACKENDS:
            raise InputError(f"unknown backend '{name}', known are {', '.join(BACKENDS)}")
        if name == "native" and len(os.sched_getaffinity(0)) > 1:
            found["native, 1 thread"] = name, 1
        found[name] = name, 0
    return found


def _opened(sorted_map: SplatMap, name: str, threads: int) -> tuple[str, dict[str, Sort]]:
    """A backend's label, and its ways to sort, by the quantity that is measured."""
    backend = open_backend(name, threads)
    backend.update(sorted_map, slice(0, sorted_map.rows))
    ways: dict[str, Sort] = {HOST: partial(backend.order, allocate=InTurn(new_array))}
    if BACKENDS[name].gpu and backend.device != "CPU":
        ways[PINNED] = partial(backend.order, allocate=InTurn(_pinned(name)))
    return f"{name}, {backend.device}", ways


class InTurn:
    """Two arrays in turn for all orders, as the sorter has them in shared memory."""

    def __init__(self, make: Allocate) -> None:
        self._make = make
        self._arrays = [make(0), make(0)]

    def __call__(self, count: int) -> NDArray[np.uint32]:
        self._arrays.reverse()
        if len(self._arrays[0]) < count:
            self._arrays[0] = self._make(count + count // 4)
        return self._arrays[0][:count]


def _pinned(name: str) -> Allocate:
    """Makes arrays that the GPU writes to without a detour."""

    def make(count: int) -> NDArray[np.uint32]:
        if name == "cupy":
            import cupyx

            pinned: NDArray[np.uint32] = cupyx.empty_pinned(count, np.uint32)
            return pinned
        import torch

        on_host = torch.empty(count, dtype=torch.int32, pin_memory=True)
        return on_host.numpy().view(np.uint32)

    return make


def _timed(
    plan: Plan, scene: str, sorted_map: SplatMap, quantity: str, label: str, sort: Sort,
    views: list[SortView],
) -> tuple[int, list[float]]:  # fmt: skip
    """How many splats the first view sees, and times [ms].

    Raises AssertionError where a backend's order is not the reference's.
    """
    expected = depth.order(views[0], sorted_map.positions, sorted_map.extents)
    if quantity == HOST and not np.array_equal(sort(views[0]), expected):
        raise AssertionError(f"{scene}: {label} is not the exact order")
    times = plan.budget.spend(lambda index: milliseconds(lambda: sort(views[index % len(views)])))
    return len(expected), times


def map_of(splats: Splats) -> SplatMap:
    """What the sorter would hold after a REPLACE with all of them."""
    sorted_map = SplatMap()
    rendering.insert(sorted_map, splats, slice(0, len(splats)), 1)
    return sorted_map
