"""What commands print."""

from __future__ import annotations

import os
import sys
from typing import NoReturn


def say(text: object) -> None:
    """Prints a line, at once. Ends the program as `unheard` does where nobody reads any more."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        unheard()


def unheard() -> NoReturn:
    """Ends the program quietly, block by block, for its output's reader has gone, `head` say."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python's last flush fails
    sys.exit(1)
