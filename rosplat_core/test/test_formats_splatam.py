"""params.npz of SplaTAM."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rosplat_core import formats
from rosplat_core.splats import InputError

Params = dict[str, NDArray[Any]]


@pytest.fixture
def params() -> Params:
    rng = np.random.default_rng(0)
    return {
        "means3D": rng.normal(size=(50, 3)).astype(np.float32),
        "rgb_colors": rng.uniform(size=(50, 3)).astype(np.float32),
        "unnorm_rotations": rng.normal(size=(50, 4)).astype(np.float32),
        "logit_opacities": rng.normal(size=(50, 1)).astype(np.float32),
        "log_scales": rng.normal(-3, 1, size=(50, 1)).astype(np.float32),
        "cam_trans": np.zeros((1, 3, 7), np.float32),
    }


@pytest.mark.parametrize("write", [np.savez, np.savez_compressed])
def test_what_it_optimises_is_read(params: Params, tmp_path: Path, write: Any) -> None:
    path = tmp_path / "params.npz"
    write(path, **params)
    splats = formats.load(path)
    np.testing.assert_array_equal(splats.positions, params["means3D"])
    wxyz = params["unnorm_rotations"] / np.linalg.norm(params["unnorm_rotations"], axis=1)[:, None]
    np.testing.assert_allclose(splats.orientations[:, 3], wxyz[:, 0], rtol=1e-5)
    np.testing.assert_allclose(splats.scales, np.exp(params["log_scales"]).repeat(3, 1), rtol=1e-6)
    np.testing.assert_allclose(
        splats.opacities, 1 / (1 + np.exp(-params["logit_opacities"][:, 0])), rtol=1e-5
    )
    colours = 0.28209479 * splats.sh[:, 0] + 0.5
    np.testing.assert_allclose(colours, params["rgb_colors"], atol=1e-6)


def test_other_archives_are_named(params: Params, tmp_path: Path) -> None:
    path = tmp_path / "params.npz"

    def refused(match: str, **changes: NDArray[Any]) -> None:
        np.savez(path, **(params | changes))
        with pytest.raises(InputError, match=rf"params\.npz: {match}"):
            formats.load(path)

    refused("arrays of different lengths", means3D=params["means3D"][1:])
    refused("log_scales: ", log_scales=np.zeros((50, 2), np.float32))
    refused("means3D: ", means3D=np.zeros((50, 3), np.int32))
    refused("means3D: ", means3D=np.array([{}], object))
    np.savez(path, **params)
    damaged = bytearray(path.read_bytes())
    damaged[26:28] = b"\xff\x02"  # a name of 767 bytes, which zipfile quotes
    path.write_bytes(damaged)
    with pytest.raises(InputError, match=r"params\.npz: damaged: .{1,200}$"):
        formats.load(path)
    np.savez(path, **params)
    encrypted = bytearray(path.read_bytes())
    for head, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        encrypted[encrypted.find(head) + flags] |= 1
    path.write_bytes(encrypted)
    with pytest.raises(InputError, match=r"params\.npz: can't be unpacked: .*encrypted"):
        formats.load(path)
    np.savez(path, means3D=params["means3D"])
    with pytest.raises(InputError, match="no array rgb_colors"):
        formats.load(path)
