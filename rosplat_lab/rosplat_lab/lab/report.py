"""The report: one HTML file that needs nothing else, to be searched and asked for settings."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path

from rosplat_core.program.files import write_text
from rosplat_lab.bench.records import Record
from rosplat_lab.lab.measure import ERROR_GAIN, strip
from rosplat_lab.lab.picture import COLOURS, where
from rosplat_lab.lab.points import by_scene, frontier, points

MOST_STRIPS = 4_000_000  # the report stays below 5 MB [bytes]


def write(folder: Path, kept: Mapping[str, Sequence[Record]]) -> Path:
    """Writes folder/lab.html from the records of each kind of machine, and from the small pictures
    in folder/strips."""
    charts, size = [], 0
    for records in kept.values():
        for here in by_scene(points(records)):
            best = frontier(here)
            rows = []
            for point in here:
                row = asdict(point) | {"front": point in best}
                path = strip(folder / "strips", point.scene, point.setting)
                # The strips are of this machine, and are embedded as long as they fit.
                if (
                    path.exists()
                    and size < MOST_STRIPS
                    and not point.aside.startswith("the camera")
                ):
                    encoded = base64.b64encode(path.read_bytes()).decode()
                    size += len(encoded)
                    row["strip"] = f"data:image/webp;base64,{encoded}"
                rows.append({k: round(v, 5) if isinstance(v, float) else v for k, v in row.items()})
            title = f"{here[0].scene}, {here[0].splats:,} splats: {where(records)}"
            charts.append({"title": title, "points": rows})
    runs = dict.fromkeys(f"{r.command}: {r.machine}, commit {r.commit}" for all_of in kept.values()
                         for r in all_of)  # fmt: skip
    text = (
        files(__package__).joinpath("report.html").read_text(encoding="utf-8")
        .replace("@RUNS@", html.escape("; ".join(runs)))
        .replace("@GAIN@", str(ERROR_GAIN))
        .replace("@COLOURS@", json.dumps(COLOURS))
        .replace("@CHARTS@", json.dumps(charts, separators=(",", ":")).replace("</", "<\\/"))
    )  # fmt: skip
    path = folder / "lab.html"
    write_text(path, text)
    return path
