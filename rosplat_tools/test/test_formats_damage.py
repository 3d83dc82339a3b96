"""Damaged files of every format: splats or a SceneError that names the file, and little memory."""

import gzip
import io
import json
import random
import struct
import tracemalloc
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ksplat_file import ksplat

from rosplat_tools.formats import SceneError, axes, load, save
from rosplat_tools.splats import Splats

CASES = 300  # a format
MOST_MEMORY = 1 << 26  # beside what the file needs [bytes]

NUMBERS = [
    struct.pack(form, value)
    for form, values in (
        ("<B", (0, 1, 127, 128, 255)),
        ("<H", (0, 65535)),
        ("<I", (0, 1, 2**24, 2**31 - 1, 2**31, 2**32 - 1)),
        ("<Q", (0, 2**63, 2**64 - 1)),
        ("<f", (float("nan"), float("inf"), -1e38, 1e-45)),
    )
    for value in values
]
VALUES: list[Any] = [
    None, True, -1, 0, 1, 2**25, 2**31, 2**63, 10**30, 1.5, float("nan"), float("inf"), 1e308, "",
    "x", "meta.json", "../a", "\0", "a" * 5000, [], [0], [[]], [1e308] * 256, {}, {"files": []},
]  # fmt: skip

Damage = Callable[[bytes, random.Random], bytes]


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Bytes with one or a few changes, half of them near the beginning."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 3, 20))):
        place = rng.randrange(min(len(out), rng.choice((64, len(out)))) or 1)
        kind = rng.randrange(5)
        if kind == 0 and out:
            out[place % len(out)] ^= 1 << rng.randrange(8)
        elif kind == 1:
            number = rng.choice(NUMBERS)
            out[place : place + len(number)] = number
        elif kind == 2:
            del out[place : place + rng.choice((1, 4, 100, len(out)))]
        elif kind == 3:
            out[place:place] = rng.randbytes(rng.choice((1, 4, 100)))
        else:
            end = place + rng.choice((4, 100))
            out[place:end] = out[:4]
    return bytes(out)


def damaged_inside_gzip(data: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.3:
        return damaged(data, rng)
    return gzip.compress(damaged(gzip.decompress(data), rng), 1)


def damaged_header_of_text(data: bytes, rng: random.Random) -> bytes:
    """A PLY of which a word of the header is another one of it, or a number."""
    if rng.random() < 0.4:
        return damaged(data, rng)
    header, end, rows = data.partition(b"end_header\n")
    words = header.split(b" ")
    numbers = [b"0", b"-1", b"1e9", b"99999999999999999999", b"4294967295", b"x\ny", b"list uchar"]
    words[rng.randrange(len(words))] = rng.choice([*words, *numbers])
    return b" ".join(words) + end + rows


def damaged_inside_zip(data: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.3:
        return damaged(data, rng)
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as whole, zipfile.ZipFile(out, "w") as bundle:
        victim = rng.choice([*whole.namelist(), *["meta.json"] * 8])
        for name in whole.namelist():
            content = whole.read(name)
            if name == victim == "meta.json":
                content = json.dumps(damaged_json(json.loads(content), rng)).encode()
            elif name == victim:
                content = damaged(content, rng)
            bundle.writestr(name, content)
    return out.getvalue()


def damaged_json(value: Any, rng: random.Random) -> Any:
    """The value with one of its parts replaced or missing."""
    if not value or not isinstance(value, (dict, list)) or rng.random() < 0.1:
        return rng.choice(VALUES)
    key = rng.choice(list(value) if isinstance(value, dict) else range(len(value)))
    if rng.random() < 0.15:
        del value[key]
    else:
        value[key] = damaged_json(value[key], rng)
    return value


def as_text(path: Path) -> bytes:
    from plyfile import PlyData

    ply = PlyData.read(path)
    ply.text = True
    out = io.BytesIO()
    ply.write(out)
    return out.getvalue()


def whole_files(make: Callable[..., Splats], folder: Path) -> Iterator[tuple[str, bytes, Damage]]:
    splats = make(300, 1)
    for ending, damage in (
        (".ply", damaged_header_of_text),
        (".compressed.ply", damaged_header_of_text),
        (".spz", damaged),
        (".sog", damaged_inside_zip),
        (".splat", damaged),
    ):
        save(folder / f"whole{ending}", splats)
        yield ending, (folder / f"whole{ending}").read_bytes(), damage
    yield "text.ply", as_text(folder / "whole.ply"), damaged_header_of_text
    near = make(40, 2)
    near.positions[:] = np.clip(near.positions, -2.4, 2.4)
    for level in (0, 1, 2):
        yield f"{level}.ksplat", ksplat([near[:25], near[25:]], level), damaged
    for version in (1, 2, 3):
        width = {1: 6, 2: 9, 3: 9}[version] + 1 + 3 + 3 + (3 if version < 3 else 4) + 9
        header = struct.pack("<4sIIBBBB", b"NGSP", version, 300, 1, 12, 0, 0)
        body = random.Random(version).randbytes(300 * width)
        yield f"{version}.spz", gzip.compress(header + body), damaged_inside_gzip


NAMES = [
    ".ply", ".compressed.ply", ".spz", ".sog", ".splat", "text.ply",
    "0.ksplat", "1.ksplat", "2.ksplat", "1.spz", "2.spz", "3.spz",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_damage_is_named(random_splats: Callable[..., Splats], tmp_path: Path, name: str) -> None:
    files = {ending: rest for ending, *rest in whole_files(random_splats, tmp_path)}
    assert list(files) == NAMES
    whole, damage = files[name]
    path = tmp_path / f"damaged{name}"
    rng = random.Random(name)
    refused = 0
    path.write_bytes(whole)
    assert len(load(path)) > 0
    tracemalloc.start()
    try:
        for case in range(CASES):
            data = damage(whole, rng)
            path.write_bytes(data)
            tracemalloc.reset_peak()
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                try:
                    load(path, warn=lambda text: None)
                    axes(path)
                except SceneError as error:
                    refused += 1
                    assert str(error).startswith(f"{path}: "), error
                    assert "\n" not in str(error)
                    assert len(str(error)) < 1000
                except Exception as error:
                    (tmp_path / f"case{name}").write_bytes(data)
                    raise AssertionError(f"case {case}, kept beside {path}") from error
            assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY, case
    finally:
        tracemalloc.stop()
    assert refused > CASES / 10 or name == ".splat"  # some damage shows in the picture only
