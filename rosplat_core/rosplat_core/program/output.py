"""What commands print."""

from __future__ import annotations

import os
import sys
from typing import NoReturn


def say(text: object) -> None:
    """Prints a line and flushes. Where that fails, ends the program by `unheard`."""
    try:
        print(text, flush=True)
    except OSError as error:
        unheard(error)


def finish() -> None:
    """Flushes what is still to be printed, such as --help. Where that fails, as `say`."""
    try:
        sys.stdout.flush()
    except OSError as error:
        unheard(error)


def told(error: BaseException) -> str:
    """An error's text for the user; the file's name comes first where an OSError has one."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error) or ("not enough memory" if isinstance(error, MemoryError) else repr(error))


def unheard(error: OSError) -> NoReturn:
    """Ends the program with code 1, because its output can't be written.

    Says nothing if the reader has gone, such as `head`; else, as on a full disk, tells stderr why.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python's last flush fails
    if not isinstance(error, BrokenPipeError):
        print(f"can't print: {error.strerror}", file=sys.stderr)
    sys.exit(1)
