"""A place where methods fail."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rosplat_lab.lab.atlas.stage import Stage

Curves = dict[str, list[float]]
Measure = Callable[[Stage], tuple[Sequence[float], Curves]]
"""Returns growing difficulties, and for each way of drawing its errors on a stage."""


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

    def enter(self, title: str, axis: str, unit: str = "dB") -> Callable[[Measure], Measure]:
        """Enters the function that it decorates, by its name."""

        def enter(measure: Measure) -> Measure:
            self[measure.__name__] = Case(title, axis, measure, unit)
            return measure

        return enter
