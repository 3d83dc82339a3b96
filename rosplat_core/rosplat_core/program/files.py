"""Files that are there whole or not at all, whatever interrupts the writing."""

from __future__ import annotations

import contextlib
import errno
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yields a new file beside the path, for the block to write, which then replaces the path.

    Nobody can guess the new file's name and put a link there. A reader sees the old file or the new
    one. If the block raises, the old one stays; an OSError that names no other file is made to name
    the path. Raises OSError, too, for a path that is there but no regular file, such as a device.
    """
    prefix, partial = f".{path.name[:100]}.", None
    try:
        if path.exists() and not path.is_file():
            raise OSError(errno.EINVAL, "is no file that could be replaced")
        file, name = tempfile.mkstemp(prefix=prefix, suffix=".part", dir=path.parent)
        partial = Path(name)
        os.fchmod(file, 0o666 & ~_umask())
        os.close(file)
        yield partial
        partial.replace(path)
    except OSError as error:
        if error.filename is None or Path(error.filename).name.startswith(prefix):
            raise OSError(error.errno, error.strerror or str(error), str(path)) from error
        raise
    finally:
        if partial:
            with contextlib.suppress(OSError):  # it was replaced
                partial.unlink()


def _umask() -> int:
    status = Path("/proc/self/status").read_text()  # os.umask would change it, for all threads
    return int(status.partition("\nUmask:")[2].split()[0], 8)


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
