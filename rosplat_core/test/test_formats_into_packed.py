"""Files read into packed splats, as publishers read them."""

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest

from rosplat_core.formats import IntoPacked, load_into, save
from rosplat_core.splats import Splats


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_a_file_is_packed_a_block_at_a_time(
    random_splats: Callable[..., Splats], tmp_path: Path, suffix: str
) -> None:
    splats = random_splats(200_000, 3)
    path = tmp_path / f"a{suffix}"
    save(path, splats)
    tracemalloc.start()
    packed = load_into(IntoPacked(), path, lambda fraction: None, pytest.fail)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(packed) == len(splats)
    assert most < 0.9 * splats.nbytes  # which a reader of the whole file would hold beside it
