"""Pictures of maps with fewer splats: PSNR and cost of `simplify`, and of other ways."""

from __future__ import annotations

import math
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
SHARES = (0.5, 0.33, 0.25)  # of the splats that are kept
ALONG = "simplify, along the path"
REFIT_STEPS, QUICK_STEPS = 600, 32  # steps, because in a given time a busy machine refits less
OTHER = "splat-transform"  # PlayCanvas's, by npm install -g @playcanvas/splat-transform
ITS_MODES = ("decimate", "decimate-adaptive")

Fewer = Callable[[float], Splats]
"""Makes a map of a share of the splats. Called with ever smaller shares, in the order of ways."""


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
        yield from isolated(_scene, name, path, QUICK_STEPS if plan.quick else REFIT_STEPS)


def _scene(name: str, path: list[Camera] | None, steps: int) -> Iterator[Event]:
    from rosplat_core.simplification.search import Simplification

    splats = scenes.load(name)
    random = np.random.default_rng(0).permutation(len(splats))
    spent = {}  # processor time of ways that go on from their map before
    works = {}
    for method in ("simplify", *([ALONG] if path else [])):
        began = _processor_time()
        works[method] = Simplification(splats, path=path if method == ALONG else None)
        spent[method] = _processor_time() - began  # the analysis of the map, before any splat goes
    best = ALONG if path else "simplify"
    works[best].look_anew()
    judge = works[best].judge

    def simplified(method: str, share: float) -> Splats:
        works[method].reduce(round(share * len(splats)))
        return works[method].splats

    def refitted(_: float) -> Splats:
        work = works[best]
        merged = work.splats
        work.refine(math.inf, most_steps=steps)
        fitted, work.splats = work.splats, merged
        return fitted

    def first(order: np.ndarray, share: float) -> Splats:
        return splats[np.sort(order[: round(share * len(splats))])]

    ways: dict[str, Fewer] = {method: partial(simplified, method) for method in works}
    ways |= {
        f"{best}, refitted": refitted,
        "the most opaque": partial(first, np.argsort(-splats.opacities, kind="stable")),
        "random": partial(first, random),
    }
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        if shutil.which(OTHER):
            save(Path(folder) / "in.ply", splats)
            for mode in ITS_MODES:
                ways[f"{OTHER} --{mode}"] = partial(_decimated, Path(folder), mode)
        for number, share in enumerate(SHARES):
            for method, fewer in ways.items():
                yield Doing(f"{name}, {share:.0%}, {method}", number / len(SHARES))
                began = _processor_time()
                try:
                    kept = fewer(share)
                except _FailedError as error:
                    yield Skipped(f"{name}, {share:.0%}, {method}: {error}")
                    continue
                took = _processor_time() - began
                if method in spent:
                    took = spent[method] = spent[method] + took
                quality = judge(kept)
                labels: dict[str, Any] = {
                    "scene": name, "splats": len(kept), "method": method, "share": share,
                }  # fmt: skip
                yield Measurement("PSNR", "dB", quality.mean, **labels)
                yield Measurement("PSNR that most views reach", "dB", quality.psnr, **labels)
                yield Measurement("PSNR of the worst view", "dB", quality.worst, **labels)
                yield Measurement("processor time", "s", took, **labels)
                save(Path(folder) / "kept.spz", kept, overwrite=True)
                size = (Path(folder) / "kept.spz").stat().st_size
                yield Measurement("size as SPZ", "MB", size / 1e6, **labels)
        for method, work in works.items():
            labels = {"scene": name, "splats": len(splats), "method": method}
            yield Measurement("views learnt from", "1", work.learnt.drawn, **labels)


def _decimated(folder: Path, mode: str, share: float) -> Splats:
    """A map by splat-transform, without a GPU, like ours. Raises _FailedError."""
    out = folder / "out.ply"
    run = subprocess.run(
        [OTHER, "-q", "-w", "-g", "cpu", folder / "in.ply", f"--{mode}", f"{share:.0%}", out],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if run.returncode:
        raise _FailedError((run.stderr or run.stdout).strip()[-300:])
    return load(out)


def _processor_time() -> float:
    """Of all threads of this process and of ended processes that it has waited for. [s]"""
    return sum(os.times()[:4])
