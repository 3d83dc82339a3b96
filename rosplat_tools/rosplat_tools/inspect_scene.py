"""Describes scene files: format, splats, extent, what is unusual."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from rosplat_core.cameras import UP, orbit, place
from rosplat_core.depth import LEAST_ALPHA
from rosplat_core.formats import InputError, axes, format_of, gltf, scene_file, streamed_sog
from rosplat_core.log_text import shown
from rosplat_core.program.output import say, told
from rosplat_core.program.progress import watched
from rosplat_core.rendering import CpuRenderer, posed, psnr_of
from rosplat_core.scenes import NAMES, is_generated, model_of, read_scene
from rosplat_core.splats import Splats

VIEWS = 8  # in which two orders of drawing are compared
LONGEST_ROW = 10_000  # of what a file's or a path's text makes of one [characters]
QUANTILES = (0.0, 0.01, 0.5, 0.99, 1.0)


def describe(path: str | Path) -> str:
    """A report of several lines on a scene. Raises InputError when it can't be read."""
    left_out: list[str] = []
    with watched("reading") as progress:
        splats = read_scene(str(path), progress, left_out.append)
    used = splats.without_empty_bands()
    degree = f"{splats.sh_degree}"
    if used.sh_degree < splats.sh_degree:
        degree += f", but the bands above {used.sh_degree} are all zero"
    rows = {
        "scene": str(path),
        "format": _format(str(path)),
        "splats": f"{len(splats):,}",
        "SH degree": degree,
        "axes": "z up" if is_generated(str(path)) else axes(path).text,
        "model": model_of(str(path), splats.model),
        "in memory": f"{_bytes(used.nbytes)}, {used.nbytes // max(1, len(used))} bytes per splat",
    }
    rows |= _drawn(str(path), splats)
    if splats.channels:
        rows["channels"] = ", ".join(
            f"{name} ({np.count_nonzero(np.isfinite(values)):,} values)"
            for name, values in splats.channels.items()
        )
    if len(splats):
        world = splats.positions + splats.origin
        rows["from"] = " ".join(f"{v:.4g}" for v in world.min(axis=0)) + " m"
        rows["to"] = " ".join(f"{v:.4g}" for v in world.max(axis=0)) + " m"
        if splats.origin.any():
            rows["origin"] = " ".join(f"{v:.0f}" for v in splats.origin) + " m, kept apart"
        head = " ".join(f"{f'{100 * q:g} %':>9}" for q in QUANTILES)
        rows["quantiles"] = head
        for name, values in (("scale [m]", splats.scales), ("opacity", splats.opacities)):
            rows[name] = " ".join(f"{v:9.3g}" for v in np.quantile(values, QUANTILES))
    if left_out:
        rows["note"] = "; ".join(left_out)
    return "\n".join(f"{name:<12} {shown(value, LONGEST_ROW)}" for name, value in rows.items())


def _format(name: str) -> str:
    if is_generated(name):
        return "made by generate"
    path = scene_file(name)
    return f"{format_of(path).NAME}, {_bytes(_file_size(path))}"


def _drawn(name: str, splats: Splats) -> dict[str, str]:
    """What the format's own rule of drawing changes, if it has one."""
    rule = "" if is_generated(name) else getattr(format_of(name), "DRAWN", "")
    if not rule or not len(splats):
        return {}
    # alpha at 3 sigma: opacity exp(-9 / 2)
    beyond = np.count_nonzero(splats.opacities * np.exp(-4.5) > LEAST_ALPHA) / len(splats)
    told = {
        "drawn": f"elsewhere {rule}; here by depth, cut at an alpha of 1/255",
        "cut": f"{100 * beyond:.3g} % of the splats reach beyond 3 sigma",
    }
    try:
        psnr = order_costs(splats, splats.up or UP)
    except ValueError:  # no camera is that far away
        return told | {"order": "too wide for a picture"}
    return told | {
        "order": f"pictures in either order agree to {np.mean(psnr):.1f} dB, {min(psnr):.1f} dB at "
        f"worst of {VIEWS} views from around",
    }


def order_costs(splats: Splats, up: tuple[float, float, float]) -> list[float]:
    """PSNR of pictures in the order of splats' distance against those in the order of depth. [dB]

    One for each of VIEWS views from around the scene, at 640x360.
    """
    renderer, here = CpuRenderer(splats), place(splats)
    corners = here.centre + np.array([[-1.0], [1.0]]) * here.radius / np.sqrt(3)
    psnr = []
    for camera in orbit(corners, VIEWS, width=640, height=360, up=up):
        away = splats.positions - (camera.position - splats.origin)
        order = np.argsort(-np.linalg.norm(away, axis=1), kind="stable").astype(np.uint32)
        drawn = renderer.draw(posed(camera), order=order)["colour"], renderer.render(camera)
        ours, theirs = (picture[..., :3].clip(0, 1).astype(np.float64) for picture in drawn)
        psnr.append(psnr_of(float(np.mean((ours - theirs) ** 2))))
    return psnr


def _file_size(path: Path) -> int:
    """Size of a scene's file, or of all of its files. [bytes]"""
    if format_of(path) is gltf:
        return gltf.size(path)
    if format_of(path) is streamed_sog:
        scene = streamed_sog.open_streamed(path)
        return scene.path.stat().st_size + sum(map(_file_size, scene.files))
    folder = path if path.is_dir() else path.parent if path.name == "meta.json" else None
    files = [path] if folder is None else [file for file in folder.iterdir() if file.is_file()]
    return sum(file.stat().st_size for file in files)


def _bytes(size: float) -> str:
    for unit in ("bytes", "kB", "MB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} GB"


def main(arguments: list[str] | None = None) -> int:
    """Prints a report on each scene; 1 when any could not be read."""
    parser = argparse.ArgumentParser(prog="inspect", description=__doc__)
    parser.add_argument("scene", nargs="+", help=f"scene: {NAMES}")
    failed = False
    for index, path in enumerate(parser.parse_args(arguments).scene):
        try:
            say(("\n" if index else "") + describe(path))
        except (InputError, MemoryError) as error:
            print(f"inspect: {told(error)}", file=sys.stderr)
            failed = True
    return int(failed)
