"""What commands print."""

from __future__ import annotations

import os
import sys
from typing import NoReturn


def say(text: object) -> None:
    """Prints a line, at once. Ends the program where it can't, as `unheard` does."""
    try:
        print(text, flush=True)
    except OSError as error:
        unheard(error)


def finish() -> None:
    """Writes what is still to be printed, --help say. Ends the program where it can't."""
    try:
        sys.stdout.flush()
    except OSError as error:
        unheard(error)


def told(error: BaseException) -> str:
    """What went wrong, for the user: the file comes first where an error of the system has one."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error) or ("not enough memory" if isinstance(error, MemoryError) else repr(error))


def unheard(error: OSError) -> NoReturn:
    """Ends the program where its output can't be written, with code 1.

    Quietly, where the reader has gone, `head` say; else, on a full disk say, by a line.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python's last flush fails
    if not isinstance(error, BrokenPipeError):
        print(f"can't print: {error.strerror}", file=sys.stderr)
    sys.exit(1)
