"""Bars that show progress in a terminal; elsewhere nothing is shown."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm


def bar(what: str, total: float = 1.0) -> tqdm[None]:
    """A bar with the time to go, that disappears when its block ends."""
    form = "{desc}: {percentage:3.0f}%|{bar}| {remaining}"
    return tqdm(desc=what, total=total, bar_format=form, disable=None, leave=False)


@contextmanager
def watched(what: str) -> Iterator[Callable[[float], None]]:
    """Shows a bar; yields the function to call with the progress, 0 to 1."""
    with watched_tasks() as tell:
        yield lambda part: tell(what, part)


@contextmanager
def watched_tasks() -> Iterator[Callable[[str, float], None]]:
    """As watched; the function is called with what is being done, too, each of which is timed."""
    with bar("") as shown:
        doing = ""

        def tell(what: str, part: float) -> None:
            nonlocal doing
            if what != doing:
                doing = what
                shown.set_description_str(what, refresh=False)
                shown.reset()  # begins anew, and draws
            shown.update(part - shown.n)

        yield tell
