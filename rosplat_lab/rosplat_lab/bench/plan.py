"""What a run of the benchmarks was asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rosplat_lab.bench.records import Budget

GPU = "gpu"  # as a backend: the viewer's GPU sorts, no sorter runs
PROCESSOR = "processor"  # likewise: its rasteriser sorts, without a graphics card and a sorter
FULL_BUDGET = Budget(least=7, most=200, seconds=2.0)
QUICK_BUDGET = Budget(least=3, most=30, seconds=0.3)


@dataclass(frozen=True)
class Plan:
    """Empty sizes, backends and variants: each subject's own choice.

    sizes: of procedural scenes. scenes: by name, besides. backends: of the sorter. variants: of
    what frame and levels draw. displays: files that list others, for rviz. cameras: a path for
    simplify and bound. seconds: of each measurement. out: a folder for logs.
    """

    out: Path = Path("out/bench")
    quick: bool = False
    sizes: Sequence[int] = ()
    scenes: Sequence[str] = ()
    backends: Sequence[str] = ()
    variants: Sequence[str] = ()
    displays: Sequence[Path] = ()
    cameras: Path | None = None
    seconds: float | None = None

    @property
    def budget(self) -> Budget:
        """Of each measurement."""
        usual = QUICK_BUDGET if self.quick else FULL_BUDGET
        return usual if self.seconds is None else replace(usual, seconds=self.seconds)
