"""The report: one HTML file that needs nothing else, with charts and pictures to be touched."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from rosplat_core.program.files import write_text
from rosplat_lab.lab.pareto import METRICS, TIMES, Summary, front, summarise
from rosplat_lab.lab.points import Point

STRIP_WIDTH = 320  # of the pictures in the report [px]
ERROR_GAIN = 16  # difference maps are full at a 16th of the way from black to white
MOST_STRIPS = 3_000_000  # the report stays below 5 MB [bytes]
ALL_SCENES = "all scenes"


def strip(folder: Path, key: str) -> Path:
    """Where the small pictures of a point are kept."""
    return folder / "strips" / f"{key}.webp"


def save_strip(path: Path, picture: NDArray[np.float64], truth: NDArray[np.float64]) -> None:
    """Keeps small pictures for the report: truth, picture and their difference, side by side."""
    picture, truth = np.clip(picture, 0, 1), np.clip(truth, 0, 1)
    error = np.abs(picture - truth).max(axis=2)
    levels = np.rint(255 * np.clip(ERROR_GAIN * error, 0, 1)).astype(np.uint8)
    tiles = [
        np.rint(255 * truth[..., ::-1]).astype(np.uint8),
        np.rint(255 * picture[..., ::-1]).astype(np.uint8),
        cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO),
    ]
    height = round(STRIP_WIDTH * truth.shape[0] / truth.shape[1])
    small = [cv2.resize(t, (STRIP_WIDTH, height), interpolation=cv2.INTER_AREA) for t in tiles]
    path.parent.mkdir(exist_ok=True)
    if not cv2.imwrite(str(path), np.hstack(small), [cv2.IMWRITE_WEBP_QUALITY, 70]):
        raise OSError(f"{path}: can't be written")


def write(folder: Path, points: Sequence[Point]) -> Path:
    """Writes folder/lab.html from points and the strips that were saved for them."""
    scenes = list(dict.fromkeys(point.scene for point in points))
    charts = {scene: _chart([p for p in points if p.scene == scene]) for scene in scenes}
    if len(scenes) > 1:
        charts = {ALL_SCENES: _chart(points)} | charts
    template = files(__package__).joinpath("report.html").read_text(encoding="utf-8")
    facts = "; ".join(dict.fromkeys(f"{p.machine}; {p.gpu}; commit {p.commit}" for p in points))
    commands = ", ".join(dict.fromkeys(p.command for p in points))
    text = (
        template.replace("@FACTS@", html.escape(facts))
        .replace("@COMMAND@", html.escape(commands))
        .replace("@POINTS@", f"{len(points):,}")
        .replace("@GAIN@", str(ERROR_GAIN))
        .replace("@CHARTS@", _script_json(charts))
        .replace("@STRIPS@", _script_json(_strips(folder, points)))
    )
    path = folder / "lab.html"
    write_text(path, text)
    return path


def _chart(points: Sequence[Point]) -> dict[str, object]:
    summaries = summarise(points)
    return {
        "methods": [_rounded(summary) for summary in summaries],
        "fronts": {
            time: {name: [s.method for s in front(summaries, name, time)] for name in METRICS}
            for time in TIMES
        },
    }


def _rounded(summary: Summary) -> dict[str, object]:
    """A summary without digits that nobody reads."""

    def four(values: Sequence[float] | None) -> list[float] | None:
        return None if values is None else [float(f"{value:.4g}") for value in values]

    return asdict(summary) | {
        "ms": four(summary.ms),
        "pose_ms": four(summary.pose_ms),
        "values": {
            name: [float(f"{value:.5g}") for value in spread]
            for name, spread in summary.values.items()
        },
    }


def _strips(folder: Path, points: Sequence[Point]) -> list[dict[str, str]]:
    """The pictures that there are, as long as they fit."""
    strips, size = [], 0
    for point in points:
        path = strip(folder, point.key)
        if not path.exists():
            continue
        encoded = base64.b64encode(path.read_bytes()).decode()
        size += len(encoded)
        if size > MOST_STRIPS:
            break
        figures = f"{point.psnr:.1f} dB, worst pixel {255 * point.worst:.0f}/255"
        strips.append(
            {
                "scene": point.scene,
                "method": point.method,
                "figures": figures,
                "image": f"data:image/webp;base64,{encoded}",
            }
        )
    return strips


def _script_json(value: object) -> str:
    """JSON that can't end the script element it is put into."""
    return json.dumps(value, separators=(",", ":")).replace("</", "<\\/")
