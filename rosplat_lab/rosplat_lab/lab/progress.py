"""How far the laboratory is, for who watches it or reads its log."""

from __future__ import annotations

import sys

from tqdm import tqdm


def progress(text: str, total: int, unit: str, done: int = 0) -> tqdm[None]:
    """A bar on a terminal; elsewhere a line that says what begins."""
    if total > done and not sys.stderr.isatty():
        print(f"{text}: {total - done} {unit}s", file=sys.stderr, flush=True)
    return tqdm(total=total, initial=done, desc=text, unit=unit, disable=None)
