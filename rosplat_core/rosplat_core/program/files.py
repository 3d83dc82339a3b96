"""Files that are there whole or not at all, whatever interrupts the writing."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import logging
import os
import stat
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

_log = logging.getLogger(__name__)

PART = ".part"
YOUNG = 5.0  # of a file whose program may not have locked it yet [s]


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yields a new file beside the path, for the block to write, which then replaces the path.

    Nobody can guess the new file's name and put a link there. A reader sees the old file or the new
    one. What killed programs left of the same path is removed, and the log says so. If the block
    raises, the old one stays; an OSError that names no other file is made to name the path. Raises
    OSError, too, for a path that is there but no regular file, such as a device.
    """
    prefix, partial, file = f".{path.name[:100]}.", None, -1
    try:
        if path.exists() and not path.is_file():
            raise OSError(errno.EINVAL, "is no file that could be replaced")
        _remove_left(path.parent, prefix)
        file, name = tempfile.mkstemp(prefix=prefix, suffix=PART, dir=path.parent)
        partial = Path(name)
        os.fchmod(file, 0o666 & ~_umask())
        _lock(file)
        yield partial
        partial.replace(path)
    except OSError as error:
        if error.filename is None or Path(error.filename).name.startswith(prefix):
            raise OSError(error.errno, error.strerror or str(error), str(path)) from error
        raise
    finally:
        if file >= 0:
            os.close(file)
        if partial:
            with contextlib.suppress(OSError):  # it was replaced
                partial.unlink()


def _remove_left(folder: Path, prefix: str) -> None:
    """Removes one's own partial files that no living program holds."""
    for name in os.listdir(folder) if folder.is_dir() else ():
        left = folder / name
        if not (name.startswith(prefix) and name.endswith(PART)):
            continue
        with contextlib.suppress(OSError):
            file = os.open(left, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                found = os.fstat(file)
                own = stat.S_ISREG(found.st_mode) and found.st_uid == os.getuid()
                if own and time.time() - found.st_mtime > YOUNG and _lock(file):
                    left.unlink()
                    _log.warning("%s: removed; a program was killed while it wrote it", left)
            finally:
                os.close(file)


def _lock(file: int) -> bool:
    """Locks a file until it is closed; false where another program holds it, or it has no locks."""
    with contextlib.suppress(OSError):
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    return False


def _umask() -> int:
    status = Path("/proc/self/status").read_text()  # os.umask would change it, for all threads
    return int(status.partition("\nUmask:")[2].split()[0], 8)


def make_folder(folder: Path) -> None:
    """Makes a folder for results where there is none. Raises OSError that says which, and why."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"{folder}: no folder for results: {error.strerror}") from error


def write_text(path: Path, text: str) -> None:
    """Writes a text in UTF-8; replaces a file that exists, whole. Raises OSError as replacing."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


def write_below(path: Path, above: str, mark: str, text: str) -> None:
    """Replaces all of a UTF-8 text file from the mark on by the mark and a text.

    The text above the mark, written by hand, stays; without a file or a mark, `above` is written.
    """
    if path.is_file():
        before, found, _ = path.read_text(encoding="utf-8").partition(mark)
        above = before if found else above
    write_text(path, above + mark + text)
