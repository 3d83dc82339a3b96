"""A place where methods fail."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from rosplat_lab.lab.atlas.stage import Stage

Errors = Iterator[tuple[str, float]]
"""Of each way of drawing, by its name."""
Measure = Callable[[Stage, float], Errors]
"""Returns the errors at a difficulty, on a stage."""


@dataclass(frozen=True)
class Case:
    """A place where methods fail."""

    title: str
    axis: str
    """What the difficulty is."""
    difficulties: Sequence[float]
    """They grow."""
    measure: Measure
    unit: str
    """What the error is in."""


class Cases(dict[str, Case]):
    """Cases by name."""

    def enter(
        self, title: str, axis: str, difficulties: Sequence[float], unit: str = "dB"
    ) -> Callable[[Measure], Measure]:
        """Enters the function that it decorates, by its name."""

        def enter(measure: Measure) -> Measure:
            self[measure.__name__] = Case(title, axis, difficulties, measure, unit)
            return measure

        return enter
