"""Prints a C++ header for Doxygen: its plain comments as Doxygen's, and nothing that is private."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

PRIVATE = re.compile(r"^( *) private:$")
BEHIND = re.compile(r"(?<=[;,{)]) +// (.*)")


def public(lines: Iterable[str]) -> Iterator[str]:
    """The lines but for those of private sections."""
    end = ""
    for line in lines:
        if line == end:
            end = ""
        if not end and (found := PRIVATE.match(line)):
            end = found[1] + "};"
        if not end:
            yield line


def marked(lines: Iterable[str]) -> Iterator[str]:
    """The same lines. A comment is about what follows it, or what stands in front of it."""
    comment: list[str] = []
    for line in lines:
        if line.lstrip().startswith("//"):
            comment.append(_escaped(line.replace("//", "///", 1)))
            continue
        if comment and not line:  # about the whole header, or about nothing that is shown
            comment = [r"/// \file", *comment] if comment[0].startswith("/") else []
        yield from comment
        comment = []
        yield BEHIND.sub(lambda found: " ///< " + _escaped(found[1]), line)


def _escaped(text: str) -> str:
    return re.sub(r"[<@\\]", r"\\\g<0>", text)


if __name__ == "__main__":
    print("\n".join(marked(public(Path(sys.argv[1]).read_text().splitlines()))))
