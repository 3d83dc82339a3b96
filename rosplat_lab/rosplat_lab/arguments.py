"""Checks of commands' arguments; each error names the argument."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

from rosplat_core.program.whole_numbers import whole_number


def whole(least: int) -> Callable[[str], int]:
    """A type for argparse: whole numbers from least on."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"'{text}' is no whole number, {least} or more")
        return value

    return parse


def number(what: str) -> Callable[[str], float]:
    """A type for argparse: finite numbers that are not negative. what: their name in errors."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not 0 <= value < math.inf:
            raise argparse.ArgumentTypeError(f"'{text}' is no {what}, 0 or more")
        return value

    return parse


def sized(what: str) -> Callable[[str], int]:
    """A type for argparse: whole numbers above 0, as 500k, 5M or 20G too. what: their name."""

    def parse(text: str) -> int:
        try:
            value = whole_number(text)
        except ValueError:
            value = 0
        if value < 1:
            raise argparse.ArgumentTypeError(f"'{text}' is no {what}, such as 500k or 5M")
        return value

    return parse


def make_folder(folder: Path) -> None:
    """Makes a folder for results where there is none. Raises OSError that says which, and why."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"{folder}: no folder for results: {error.strerror}") from error
