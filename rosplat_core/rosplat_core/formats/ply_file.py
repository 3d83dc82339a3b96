"""The PLY container (Turk 1994): a header in text names elements, tables of rows of properties.

Binary rows are read as they are wanted, text is parsed at once. Properties that are lists have no
place in a map; an element with any is skipped, where it can be.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rosplat_core.formats.bounds import size_of
from rosplat_core.formats.decoded import Progress
from rosplat_core.formats.file_rows import FileRows
from rosplat_core.log_text import shown
from rosplat_core.splats import InputError

LARGEST_HEADER = 1 << 16  # that of a trained scene takes 2,000 [bytes]

ROWS = 1 << 12  # of text that are parsed at a time, while all other threads wait

ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
    "half": "f2", "float16": "f2", "int64": "i8", "uint64": "u8",  # of no standard
}  # fmt: skip

# What C libraries write of no number: -nan(ind), nan(snan), nanq, -1.#IND, 1.#QNAN, 1.#INF
_NAN = re.compile(r"[-+]?nan[\w()]*|[-+]?1\.#(?!inf)\S*", re.IGNORECASE)
_INFINITY = re.compile(r"1\.#INF\S*", re.IGNORECASE)


Rows = NDArray[np.void] | FileRows


class Element(NamedTuple):
    """A table: how many rows, and what is in each."""

    length: int
    dtype: np.dtype[Any]
    """Of a row, without its lists."""
    lists: list[str]


class PlyFile:
    """A PLY whose header is read. Raises InputError for one that is broken or cut short."""

    def __init__(self, path: Path) -> None:
        """Reads the header and checks what it promises against the file's size."""
        self.path = path
        self.comments: list[str] = []
        self.elements: dict[str, Element] = {}
        size = size_of(path)
        with path.open("rb") as stream:
            head = stream.read(LARGEST_HEADER)
        # All lines end as the first does.
        pattern = rb"ply[ \t]*(\r\n|\r|\n)(?:.*?\1)??end_header[ \t]*(?:\1|$)"
        match = re.match(pattern, head, re.DOTALL)
        if not match:
            raise InputError(f"{path}: a PLY with no end_header in its first {len(head):,} bytes")
        lines = match[0].decode("utf-8", "replace").split(match[1].decode())
        try:
            self._parse(lines)
        except (KeyError, ValueError, IndexError) as error:
            raise InputError(f"{path}: header of the PLY: {shown(error, 300)}") from error
        self._begin = match.end()
        self._lines = len(lines) - 1
        self._check_size(size)

    def rows(self, name: str, progress: Progress = lambda fraction: None) -> Rows:
        """The rows of an element without lists, as the header lays them out.

        progress is called with 0 to 1 while text is parsed; what it raises ends that.
        """
        element = self.elements[name]
        if element.lists:
            names = ", ".join(element.lists)
            raise InputError(f"{self.path}: property {names} is a list, expected a number")
        before = list(self.elements.values())[: list(self.elements).index(name)]
        if not element.length:
            return np.empty(0, element.dtype)
        if self.is_text:
            return self._parsed(name, element, sum(other.length for other in before), progress)
        if any(other.lists for other in before):
            raise InputError(f"{self.path}: an element with lists before element {name}")
        offset = self._begin + sum(other.length * other.dtype.itemsize for other in before)
        return FileRows(self.path, element.dtype, offset, element.length)

    def _parse(self, lines: list[str]) -> None:
        order = ""
        columns: list[tuple[str, str]] = []
        lists: list[str] = []
        for line in lines[1:]:
            keyword, *words = line.split() or [""]
            if keyword == "format":
                form, version = words
                if version != "1.0" or form not in ORDERS:
                    raise ValueError(
                        f"{shown(line)}, expected one of {', '.join(ORDERS)}, version 1.0"
                    )
                order = ORDERS[form]
                self.is_text = form == "ascii"
            elif keyword == "comment":
                self.comments.append(line.partition("comment")[2].strip())
            elif keyword in ("element", "end_header"):
                if self.elements:
                    name, element = self.elements.popitem()
                    self.elements[name] = Element(element.length, np.dtype(columns), lists)
                columns, lists = [], []
                if keyword == "element":
                    name, count = words
                    if not count.isdecimal() or len(count) > 18 or name in self.elements:
                        raise ValueError(shown(line))
                    self.elements[name] = Element(int(count), np.dtype([]), [])
            elif keyword == "property":
                if not self.elements or len(words) != (4 if words[0] == "list" else 2):
                    raise ValueError(shown(line))
                if words[0] == "list":
                    lists.append(words[3])
                elif words[0] in TYPES:
                    columns.append((words[1], order + TYPES[words[0]]))
                else:
                    raise ValueError(f"{shown(line)}: no such type, expected {', '.join(TYPES)}")
        if not order:
            raise ValueError("no format")

    def _check_size(self, size: int) -> None:
        room = size - self._begin
        for name, element in self.elements.items():
            columns = len(element.dtype.names or ()) + len(element.lists)
            binary = element.dtype.itemsize + len(element.lists)
            least = 2 * columns if self.is_text else binary  # a digit and what follows it
            # gsplat writes such an element; in binary, it takes no room.
            if element.length and not columns and (self.is_text or name == "vertex"):
                raise InputError(f"{self.path}: element {name} has rows, but no property")
            if element.length * least > room + self.is_text:
                raise self._truncated(name, element, room // least)
            room -= element.length * least

    def _parsed(
        self, name: str, element: Element, before: int, progress: Progress
    ) -> NDArray[np.void]:
        rows = np.empty(element.length, element.dtype)
        held, skip = 0, self._lines + before
        try:
            with self.path.open(encoding="latin-1") as text, warnings.catch_warnings():
                warnings.simplefilter("ignore")  # NumPy's warning of no rows at all
                numbers = map(_readable, text)
                while held < len(rows):
                    part = np.loadtxt(
                        numbers, element.dtype, comments=None, skiprows=skip,
                        max_rows=min(ROWS, len(rows) - held), ndmin=1,
                    )  # fmt: skip
                    if not len(part):
                        raise self._truncated(name, element, held)
                    rows[held : held + len(part)] = part
                    held, skip = held + len(part), 0
                    progress(held / len(rows))
        except InputError:
            raise
        except (ValueError, IndexError, OverflowError) as error:
            raise InputError(
                f"{self.path}: malformed row of element {name}: {shown(error)}"
            ) from error
        return rows

    def _truncated(self, name: str, element: Element, held: int) -> InputError:
        return InputError(
            f"{self.path}: truncated: the header promises {element.length:,} rows of element "
            f"{name}, the file's {size_of(self.path):,} bytes hold {held:,}"
        )


def _readable(line: str) -> str:
    """A line whose numbers NumPy can read."""
    if "#" in line or "n" in line or "N" in line:
        line = _INFINITY.sub("inf", _NAN.sub("nan", line))
    return line


def header(elements: dict[str, tuple[int, np.dtype[Any]]], comments: list[str]) -> bytes:
    """The header of a binary little-endian PLY: rows and layout of each element, in order."""
    names = {code: name for name, code in reversed(TYPES.items())}  # float, not float32
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    for element, (count, dtype) in elements.items():
        lines.append(f"element {element} {count}")
        lines += [f"property {names[dtype[name].str[1:]]} {name}" for name in dtype.names or ()]
    return "\n".join([*lines, "end_header", ""]).encode("ascii")
