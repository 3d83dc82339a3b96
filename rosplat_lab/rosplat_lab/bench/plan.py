"""What a run of the benchmarks was asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from rosplat_lab.bench.records import Budget

FULL_BUDGET = Budget(least=7, most=200, seconds=2.0)
QUICK_BUDGET = Budget(least=3, most=30, seconds=0.3)


@dataclass(frozen=True)
class Plan:
    """Empty sizes, backends and variants: each subject's own choice.

    sizes: of procedural scenes. scenes: by name, besides. backends: of the sorter. variants: what
    `frame` draws, see there. displays: files that list others, for rviz. cameras: a path for
    simplify. out: a folder for logs.
    """

    out: Path = Path("out/bench")
    quick: bool = False
    sizes: tuple[int, ...] = ()
    scenes: tuple[str, ...] = ()
    backends: tuple[str, ...] = ()
    variants: tuple[str, ...] = ()
    displays: tuple[Path, ...] = ()
    cameras: Path | None = None
    budget: Budget = field(default=FULL_BUDGET)
