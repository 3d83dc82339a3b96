"""Files that other programs change while they are read."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ksplat_file import ksplat

from rosplat_core.formats import InputError, load, save
from rosplat_core.formats.decoded import BLOCK
from rosplat_core.formats.file_rows import FileRows
from rosplat_core.splats import Splats


@pytest.mark.parametrize("suffix", [".ply", ".compressed.ply", ".glb", ".splat", ".ksplat"])
def test_a_file_that_is_cut_short_is_named(
    random_splats: Callable[..., Splats], tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / f"a{suffix}"
    if suffix == ".ksplat":
        path.write_bytes(ksplat([random_splats(20, 0)] * 2, 0))  # a block of each section
    else:
        save(path, random_splats(2 * BLOCK, 0))
    with pytest.raises(InputError, match=rf"a{suffix}: became shorter while it was read"):
        load(path, lambda _: os.truncate(path, 0))


def test_a_file_that_is_replaced_is_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"--aabbcc")
    rows = FileRows(path, "S2", 2, 3)
    (tmp_path / "b").write_bytes(b"")
    (tmp_path / "b").replace(path)
    assert len(rows) == 3
    for part in (slice(1, 2), slice(None), slice(2, 9)):
        np.testing.assert_array_equal(rows[part], np.array([b"aa", b"bb", b"cc"])[part])
