"""Numbers as users type them; each error names the argument."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import TypeVar

Number = TypeVar("Number", int, float)

UNITS = {"k": 10**3, "m": 10**6, "g": 10**9}


def whole_number(text: str) -> int:
    """A whole number, as 20k, 1.5M or 20G too. Raises ValueError."""
    unit = UNITS.get(text[-1:].lower(), 1)
    try:
        return round(float(text if unit == 1 else text[:-1]) * unit)
    except (ValueError, OverflowError):  # OverflowError: inf
        raise ValueError(f"'{text}' is no whole number, such as 20k or 5M") from None


def whole(least: int) -> Callable[[str], int]:
    """A type for argparse: whole numbers from least on."""
    return _checked(int, lambda value: value >= least, f"whole number, {least} or more")


def number(what: str, least: float = 0.0, most: float = math.inf) -> Callable[[str], float]:
    """A type for argparse: finite numbers from least to most. what: their name in errors."""
    upwards = f"{least:g} or more" if most == math.inf else f"{least:g} to {most:g}"
    return _checked(
        float, lambda value: least <= value <= most and value < math.inf, f"{what}, {upwards}"
    )


def sized(what: str) -> Callable[[str], int]:
    """A type for argparse: whole numbers above 0, as 500k, 5M or 20G too. what: their name."""
    return _checked(whole_number, lambda value: value >= 1, f"{what}, such as 500k or 5M")


def _checked(
    parse: Callable[[str], Number], fits: Callable[[Number], bool], expected: str
) -> Callable[[str], Number]:
    def parsed(text: str) -> Number:
        try:
            value = parse(text)
            if fits(value):
                return value
        except ValueError:
            pass
        raise argparse.ArgumentTypeError(f"'{text}' is no {expected}")

    return parsed
