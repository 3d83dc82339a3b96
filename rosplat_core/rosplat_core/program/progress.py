"""Bars that show progress in a terminal; elsewhere nothing is shown."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm


def bar(what: str, total: float = 1.0) -> tqdm[None]:
    """A bar that disappears when its block ends."""
    form = "{desc}: {percentage:3.0f}%|{bar}|"
    return tqdm(desc=what, total=total, bar_format=form, disable=None, leave=False)


@contextmanager
def watched(what: str) -> Iterator[Callable[[float], None]]:
    """Shows a bar; yields the function to call with the progress, 0 to 1."""
    with bar(what) as shown:

        def tell(part: float) -> None:
            shown.update(part - shown.n)

        yield tell
