"""A place where methods fail."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rosplat_lab.lab.bench import Bench

Curves = dict[str, list[float]]
Measure = Callable[[Bench, bool], tuple[Sequence[float], Curves]]
"""Of a bench and whether to be quick: growing difficulties, and for each method their errors."""


@dataclass(frozen=True)
class Case:
    """A place where methods fail."""

    title: str
    axis: str
    """What the difficulty is."""
    measure: Measure
    unit: str
    """What the error is in."""


class Cases(dict[str, Case]):
    """Cases by name."""

    def enter(self, title: str, axis: str, unit: str = "PSNR [dB]") -> Callable[[Measure], Measure]:
        """Enters the function that it decorates, by its name."""

        def enter(measure: Measure) -> Measure:
            self[measure.__name__] = Case(title, axis, measure, unit)
            return measure

        return enter
