"""Checks of commands' arguments; each error names the argument."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from rosplat_core.program.whole_numbers import whole_number

Number = TypeVar("Number", int, float)


def whole(least: int) -> Callable[[str], int]:
    """A type for argparse: whole numbers from least on."""
    return _checked(int, lambda value: value >= least, f"whole number, {least} or more")


def number(what: str) -> Callable[[str], float]:
    """A type for argparse: finite numbers that are not negative. what: their name in errors."""
    return _checked(float, lambda value: 0 <= value < math.inf, f"{what}, 0 or more")


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


def make_folder(folder: Path) -> None:
    """Makes a folder for results where there is none. Raises OSError that says which, and why."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"{folder}: no folder for results: {error.strerror}") from error
