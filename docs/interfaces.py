"""Messages and services as Markdown, from the comments in their files."""

from __future__ import annotations

import re
from pathlib import Path


def rendered(path: Path) -> str:
    """A section about a .msg or .srv file."""
    request, *response = re.split(r"^---$", path.read_text(), flags=re.MULTILINE)
    lines = [f"## {path.stem}", ""]
    lines += _blocks(request)
    for part in response:
        lines += ["### Response", "", *_blocks(part)]
    return "\n".join(lines) + "\n"


def _blocks(text: str) -> list[str]:
    """Paragraphs of comments, and the fields that follow each."""
    lines: list[str] = []
    for block in re.split(r"\n\s*\n|\n#\n", text.strip()):
        rows = block.splitlines()
        comments = [row[1:].removeprefix(" ") for row in rows if row.startswith("#")]
        fields = [row for row in rows if row and not row.startswith("#")]
        if comments and comments[0].startswith(" "):  # a table
            lines += _code(comments)
        elif comments:
            lines += [re.sub(r"([\\`*_<>\[\]])", r"\\\1", comment) for comment in comments] + [""]
        if fields:
            lines += _code(fields)
    return lines


def _code(rows: list[str]) -> list[str]:
    return ["```text", *rows, "```", ""]
