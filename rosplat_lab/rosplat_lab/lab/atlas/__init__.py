"""The atlas of failures: where methods are known to break, and by how much, as difficulty grows.

`projection`, `coordinates`, `ordering` and `blending` are its chapters, on the `stage` they share.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from rosplat_core.program.files import write_text
from rosplat_lab.lab.atlas import blending, coordinates, ordering, projection
from rosplat_lab.lab.atlas.case import Case, Curves
from rosplat_lab.lab.bench import Bench
from rosplat_lab.lab.progress import progress

CASES: dict[str, Case] = projection.CASES | coordinates.CASES | ordering.CASES | blending.CASES


@dataclass(frozen=True)
class Finding:
    """Error as a difficulty grows, for each method."""

    name: str
    title: str
    axis: str
    """What the difficulty is."""
    unit: str
    """What the error is in."""
    xs: list[float]
    curves: Curves


def explore(bench: Bench, quick: bool, names: Sequence[str] = ()) -> list[Finding]:
    """What all cases find, or those of some names."""
    findings = []
    with progress("atlas", len(names or CASES), "case") as done:
        for name in names or CASES:
            entry = CASES[name]
            if done.disable:  # no terminal
                print(f"atlas: {entry.title}", file=sys.stderr, flush=True)
            xs, curves = entry.measure(bench, quick)
            findings.append(
                Finding(name, entry.title, entry.axis, entry.unit, [float(x) for x in xs], curves)
            )
            done.update()
    return findings


def save(path: Path, findings: Sequence[Finding]) -> None:
    """Writes findings as JSON."""
    write_text(path, json.dumps([asdict(f) for f in findings], indent=0) + "\n")
