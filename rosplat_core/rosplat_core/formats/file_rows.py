"""Rows of a file as they are wanted, block by block."""

from __future__ import annotations

import weakref
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from rosplat_core.splats import InputError


class FileRows:
    """A table in a file; a slice of it is read when it is asked for.

    Not mapped: a file that another program cuts short would end the process.
    """

    def __init__(self, path: Path, dtype: DTypeLike, begin: int, count: int) -> None:
        """count rows of a dtype, from a place on [bytes]. Raises OSError."""
        self._path, self._begin, self._count = path, begin, count
        self.dtype: np.dtype[Any] = np.dtype(dtype)
        self._held: tuple[range, NDArray[Any]] = range(0), np.empty(0, self.dtype)
        self._stream = path.open("rb", buffering=0)
        weakref.finalize(self, self._stream.close)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, part: slice) -> NDArray[Any]:
        """Rows one after the other; the last ones that were read are kept. Only to be read.

        Raises InputError where the file has become too short for them.
        """
        wanted = range(self._count)[part]
        if self._held[0] != wanted:
            self._stream.seek(self._begin + wanted.start * self.dtype.itemsize)
            rows = np.fromfile(self._stream, self.dtype, len(wanted))
            if len(rows) < len(wanted):
                raise InputError(f"{self._path}: became shorter while it was read")
            rows.setflags(write=False)
            self._held = wanted, rows
        return self._held[1]
