"""What is left of a map's pictures with fewer splats: by `simplify`, and by other ways to it."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rosplat_core.cameras import Camera, load_cameras
from rosplat_core.formats import load, save
from rosplat_core.splats import Splats
from rosplat_lab.bench import scenes
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Doing, Event, Measurement, Skipped

SIZES, QUICK_SIZES = (200_000,), (5_000,)
SHARES = (0.9, 0.8, 0.7, 0.5, 0.3, 0.1)  # of the splats that are kept
PATH_SHARES = (0.5, 0.25, 0.1)  # where views along a path judge
ALONG = "simplify, along the path"
REFITTED = "simplify, refitted"
REFIT_SHARES, REFIT_S = (0.5, 0.3, 0.1), 60.0
OTHER = "splat-transform"  # PlayCanvas's, by npm install -g @playcanvas/splat-transform
ITS_MODES = ("decimate", "decimate-adaptive")

Fewer = Callable[[float], Splats]
"""A map of a share of a map's splats; called with ever smaller ones."""


class _FailedError(RuntimeError):
    """A way that could not make a map; the text says why."""


def measure(plan: Plan) -> Iterator[Event]:
    """PSNR in views that no way has seen, and processor time, by the share of splats kept.

    Where a path is given, views along it judge all ways.
    """
    if not shutil.which(OTHER):
        yield Skipped(f"{OTHER} is not in PATH: npm install -g @playcanvas/splat-transform")
    sizes = plan.sizes or (() if plan.scenes else QUICK_SIZES if plan.quick else SIZES)
    names = scenes.names(sizes, plan.scenes)
    path = load_cameras(plan.cameras) if plan.cameras else None
    for number, name in enumerate(names):
        yield Doing(name, number / len(names))
        yield from isolated(_scene, name, path)


def _scene(name: str, path: list[Camera] | None) -> Iterator[Event]:
    from rosplat_core.simplification.search import Simplification

    splats = scenes.load(name)
    random = np.random.default_rng(0).permutation(len(splats))
    spent = {}  # of the processor, by ways that go on from the map before
    works = {}
    for method in ("simplify", *([ALONG] if path else [])):
        began = _processor_time()
        works[method] = Simplification(splats, path=path if method == ALONG else None)
        spent[method] = _processor_time() - began  # looking at the map, before any splat goes
    judge = works[ALONG if path else "simplify"].judge

    def simplified(method: str, share: float) -> Splats:
        works[method].reduce(round(share * len(splats)))
        return works[method].splats

    def refitted(share: float) -> Splats:
        work = Simplification(splats)
        work.reduce(round(share * len(splats)))
        work.refine(REFIT_S)
        return work.splats

    def first(order: np.ndarray, share: float) -> Splats:
        return splats[np.sort(order[: round(share * len(splats))])]

    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        ways: dict[str, Fewer] = {method: partial(simplified, method) for method in works}
        if not path:
            ways[REFITTED] = refitted
        ways |= {
            "the most opaque": partial(first, np.argsort(-splats.opacities, kind="stable")),
            "random": partial(first, random),
        }
        if shutil.which(OTHER):
            save(Path(folder) / "in.ply", splats)
            for mode in ITS_MODES:
                ways[f"{OTHER} --{mode}"] = partial(_decimated, Path(folder), mode)
        shares = PATH_SHARES if path else SHARES
        for number, (method, fewer) in enumerate(ways.items()):
            for share in REFIT_SHARES if method == REFITTED else shares:
                yield Doing(f"{name}, {method}, {share:.0%}", number / len(ways))
                began = _processor_time()
                try:
                    kept = fewer(share)
                except _FailedError as error:
                    yield Skipped(f"{name}, {method}, {share:.0%}: {error}")
                    continue
                took = _processor_time() - began
                if method in spent:
                    took = spent[method] = spent[method] + took
                quality = judge(kept)
                labels: dict[str, Any] = {
                    "scene": name, "splats": len(kept), "method": method, "share": share,
                }  # fmt: skip
                yield Measurement.of("PSNR", "dB", quality.psnr, **labels)
                yield Measurement.of("PSNR of the worst view", "dB", quality.worst, **labels)
                yield Measurement.of("processor time", "s", took, **labels)
        for method, work in works.items():
            labels = {"scene": name, "splats": len(splats), "method": method}
            yield Measurement.of("views learnt from", "1", work.learnt.views, **labels)


def _decimated(folder: Path, mode: str, share: float) -> Splats:
    """By splat-transform, without a GPU, as we. Raises _FailedError where it does."""
    out = folder / "out.ply"
    run = subprocess.run(
        [OTHER, "-q", "-w", "-g", "cpu", folder / "in.ply", f"--{mode}", f"{share:.0%}", out],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if run.returncode:
        raise _FailedError((run.stderr or run.stdout).strip()[-300:])
    return load(out)


def _processor_time() -> float:
    """Of this process and of those that it has waited for, in all their threads. [s]"""
    return sum(os.times()[:4])
