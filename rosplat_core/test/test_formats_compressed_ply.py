"""Compressed PLY: fields decode as splat-transform's decompress-ply.ts has them, and come back."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.lib.recfunctions as structured
import pytest

from rosplat_core.formats import InputError, format_of, load, save
from rosplat_core.models import Model
from rosplat_core.splats import Splats

plyfile = pytest.importorskip("plyfile")  # apt has none
PlyData, PlyElement = plyfile.PlyData, plyfile.PlyElement

Make = Callable[..., Splats]

RANGES = [
    f"{end}_{name}"
    for names in (("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b"))
    for end in ("min", "max")
    for name in names
]
PACKED = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]


def random_file(path: Path, count: int, coefficients: int = 0, colors: bool = True) -> PlyData:
    """A file of random bits."""
    rng = np.random.default_rng(count)
    names = RANGES if colors else RANGES[:12]
    chunk = np.zeros(-(-count // 256), [(name, "f4") for name in names])
    for name in names:
        chunk[name] = rng.uniform(-3, 3, len(chunk))
    vertex = np.zeros(count, [(name, "u4") for name in PACKED])
    for name in PACKED:
        vertex[name] = rng.integers(0, 2**32, count)
    elements = [PlyElement.describe(chunk, "chunk"), PlyElement.describe(vertex, "vertex")]
    if coefficients:
        sh = np.zeros(count, [(f"f_rest_{i}", "u1") for i in range(3 * coefficients)])
        for name in sh.dtype.names or ():
            sh[name] = rng.integers(0, 256, count)
        elements.append(PlyElement.describe(sh, "sh"))
    ply = PlyData(elements, byte_order="<")
    ply.write(path)
    return ply


@pytest.mark.parametrize("coefficients", [0, 3, 8, 15])
@pytest.mark.parametrize("colors", [False, True])
def test_each_splat_decodes_by_the_source(tmp_path: Path, coefficients: int, colors: bool) -> None:
    path = tmp_path / "a.ply"
    ply = random_file(path, 600, coefficients, colors)
    splats = load(path)
    assert format_of(path).NAME == "compressed PLY"
    assert splats.sh.shape == (600, 1 + coefficients, 3)
    for i in (0, 1, 255, 256, 511, 599):
        row, ranges = ply["vertex"].data[i], ply["chunk"].data[i // 256]

        def between(name: str, fraction: float, ranges: np.void = ranges) -> float:
            least, most = float(ranges[f"min_{name}"]), float(ranges[f"max_{name}"])
            return least * (1 - fraction) + most * fraction

        def of_3(packed: np.uint32) -> list[float]:
            bits = int(packed)
            return [(bits >> 21) / 2047, (bits >> 11 & 1023) / 1023, (bits & 2047) / 2047]

        expected = [between(a, f) for a, f in zip("xyz", of_3(row[PACKED[0]]), strict=True)]
        np.testing.assert_allclose(splats.positions[i], expected, atol=1e-5)
        names = ("scale_x", "scale_y", "scale_z")
        expected = [between(a, f) for a, f in zip(names, of_3(row[PACKED[2]]), strict=True)]
        np.testing.assert_allclose(np.log(splats.scales[i]), expected, atol=1e-5)
        color = list(int(row[PACKED[3]]).to_bytes(4, "big"))
        rgb = [c / 255 for c in color[:3]]
        if colors:
            rgb = [between(a, f) for a, f in zip("rgb", rgb, strict=True)]
        np.testing.assert_allclose(splats.sh[i, 0] * 0.28209479 + 0.5, rgb, atol=1e-5)
        assert splats.opacities[i] == pytest.approx(color[3] / 255)
        bits = int(row[PACKED[1]])
        wxyz = [((bits >> s & 1023) / 1023 - 0.5) * np.sqrt(2) for s in (20, 10, 0)]
        wxyz.insert(bits >> 30, np.sqrt(max(0, 1 - np.square(wxyz).sum())))
        xyzw = np.roll(wxyz, -1) / np.linalg.norm(wxyz)
        np.testing.assert_allclose(splats.orientations[i], xyzw, atol=1e-5)
        for j in range(3 * coefficients):
            byte = int(ply["sh"].data[f"f_rest_{j}"][i])
            value = {0: -4.0, 255: 4.0}.get(byte, ((byte + 0.5) / 256 - 0.5) * 8)
            stored = splats.sh[i, 1 + j % coefficients, j // coefficients]
            assert stored == pytest.approx(value, abs=1e-6)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("model", Model)
def test_round_trip(random_splats: Make, tmp_path: Path, degree: int, model: Model) -> None:
    splats = random_splats(20_001, degree, model=model)
    splats.sh[:] = np.clip(splats.sh, -3.9, 3.9)
    written = save(tmp_path / "a.compressed.ply", splats)
    back = load(tmp_path / "a.compressed.ply")
    assert back.model is model
    np.testing.assert_allclose(back.positions, written.positions, atol=8 * 0.51 / 1023)
    least = np.exp(-20)  # stands for a disc's third scale
    logarithms = [np.log(np.maximum(each.scales, least)) for each in (back, written)]
    np.testing.assert_allclose(*logarithms, atol=6 * 0.51 / 1023)
    np.testing.assert_allclose(back.opacities, written.opacities, atol=0.51 / 255)
    np.testing.assert_allclose(back.sh[:, 0], written.sh[:, 0], atol=8 * 0.51 / 255)
    np.testing.assert_allclose(back.sh[:, 1:], written.sh[:, 1:], atol=0.51 / 32)
    cosine = np.abs((back.orientations * written.orientations).sum(axis=1))
    assert np.degrees(2 * np.arccos(np.minimum(cosine, 1))).max() < 0.4


@pytest.mark.parametrize("count", [0, 1, 256])
def test_whole_and_part_chunks(random_splats: Make, tmp_path: Path, count: int) -> None:
    written = save(tmp_path / "a.compressed.ply", random_splats(count, 1))
    back = load(tmp_path / "a.compressed.ply")
    np.testing.assert_allclose(back.positions, written.positions, atol=0.01)
    assert len(PlyData.read(tmp_path / "a.compressed.ply")["chunk"].data) == (count + 255) // 256


def test_flat_splats_and_lost_numbers(random_splats: Make, tmp_path: Path) -> None:
    splats = random_splats(10)
    splats.scales[:, 2] = 0
    save(tmp_path / "a.compressed.ply", splats)
    assert load(tmp_path / "a.compressed.ply").scales[:, 2].max() < 1e-8
    splats.opacities[3] = np.nan
    with pytest.raises(InputError, match=r"b\.compressed\.ply: a number that is not finite"):
        save(tmp_path / "b.compressed.ply", splats)


@pytest.mark.parametrize(
    ("element", "change", "reason"),
    [
        ("chunk", "min_scale_y", "no property min_scale_y of element chunk"),
        ("chunk", "max_g", "no property max_g of element chunk"),
        ("chunk", 1, "1 chunks of 256 for 600 splats"),
        ("chunk", None, "no element chunk"),
        ("vertex", "packed_color", "no property uint packed_color of element vertex"),
        ("sh", "f_rest_4", "8 properties f_rest_"),
        ("sh", {"f_rest_4": "f_rest_9"}, "not a Gaussian splat: no property f_rest_4"),
        ("sh", 599, "element sh: expected bytes, for 600 splats"),
    ],
)
def test_broken_layouts(
    tmp_path: Path, element: str, change: str | dict[str, str] | int | None, reason: str
) -> None:
    path = tmp_path / "a.ply"
    ply = random_file(path, 600, 3)
    elements = []
    for part in ply.elements:
        rows = part.data
        if part.name == element:
            if change is None:
                continue
            if isinstance(change, str):
                rows = structured.drop_fields(rows, change)
            elif isinstance(change, dict):
                rows = structured.rename_fields(rows, change)
            else:
                rows = rows[:change]
        elements.append(PlyElement.describe(np.array(rows), part.name))
    PlyData(elements, byte_order="<").write(path)
    with pytest.raises(InputError, match=rf"a\.ply: {reason}"):
        load(path)


def test_an_element_of_no_harmonics_as_gsplat_writes_it(
    random_splats: Make, tmp_path: Path
) -> None:
    save(tmp_path / "a.compressed.ply", random_splats(3, 0))
    head, end, rows = (tmp_path / "a.compressed.ply").read_bytes().partition(b"end_header\n")
    (tmp_path / "b.compressed.ply").write_bytes(head + b"element sh 3\n" + end + rows)
    assert len(load(tmp_path / "b.compressed.ply")) == 3


def test_an_element_sh_of_something_else_is_no_harmonics(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    random_file(path, 300, 3)
    path.write_bytes(path.read_bytes().replace(b"f_rest_", b"others_"))
    assert load(path).sh_degree == 0
