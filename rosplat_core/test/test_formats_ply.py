"""PLY: every layout that trainers write comes back as the same splats, and broken files say why."""

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.lib.recfunctions as structured
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rosplat_core.formats import InputError, axes, load, ply, save
from rosplat_core.models import Model
from rosplat_core.splats import Splats

plyfile = pytest.importorskip("plyfile")  # apt has none
PlyData, PlyElement = plyfile.PlyData, plyfile.PlyElement

Make = Callable[..., Splats]


def assert_same(a: Splats, b: Splats, tolerance: float = 1e-6) -> None:
    np.testing.assert_allclose(a.positions + a.origin, b.positions + b.origin, atol=1e-6)
    np.testing.assert_allclose(a.orientations, b.orientations, atol=tolerance)
    np.testing.assert_allclose(a.scales, b.scales, rtol=tolerance, atol=1e-30)
    np.testing.assert_allclose(a.opacities, b.opacities, atol=tolerance)
    np.testing.assert_array_equal(a.sh, b.sh)
    assert a.model is b.model


def rows_of(path: Path) -> NDArray[np.void]:
    return np.array(PlyData.read(path)["vertex"].data)


def without(rows: NDArray[np.void], name: str) -> NDArray[np.void]:
    return structured.drop_fields(rows, name)


def write_rows(path: Path, rows: NDArray[np.void], **form: object) -> None:
    PlyData([PlyElement.describe(rows, "vertex")], **form).write(path)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("model", Model)
def test_round_trip(random_splats: Make, tmp_path: Path, degree: int, model: Model) -> None:
    splats = random_splats(50, degree, model=model)
    save(tmp_path / "a.ply", splats)
    assert_same(load(tmp_path / "a.ply"), splats)


def test_further_properties_are_channels(
    random_splats: Make, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    channels = {"label": np.array([3, 2, 1]), "seen": np.array([0.5, np.nan, 0.25])}
    splats = replace(random_splats(3), channels=channels)
    save(tmp_path / "a.ply", splats)
    read = load(tmp_path / "a.ply")
    assert_same(read, splats)
    assert list(read.channels) == ["label", "seen"]
    for name, values in channels.items():
        np.testing.assert_array_equal(read.channels[name], values)
    # As trainers have them, beside what they write for viewers of points.
    rows = rows_of(tmp_path / "a.ply")
    for name in ["red", "green", "blue", *(f"feature_{i}" for i in range(10))]:
        rows = structured.append_fields(rows, name, np.arange(3, dtype="u1"), usemask=False)
    write_rows(tmp_path / "b.ply", rows)
    told: list[str] = []
    read = load(tmp_path / "b.ply", warn=told.append)
    assert list(read.channels) == ["label", "seen", *(f"feature_{i}" for i in range(6))]
    np.testing.assert_array_equal(read.channels["feature_5"], [0, 1, 2])
    assert len(told) == 1
    assert "left out 4 properties" in told[0]
    save(tmp_path / "a.splat", splats)
    assert "left out label, seen" in caplog.text
    with pytest.raises(InputError, match="channel 'opacity'"):
        save(tmp_path / "c.ply", replace(splats, channels={"opacity": np.zeros(3)}))


@pytest.mark.parametrize(
    ("ending", "warns"),
    [(".ply", False), (".glb", False), (".sog", False), (".spz", True), (".splat", True)],
)
def test_who_keeps_no_origin_warns_of_splats_far_away(
    random_splats: Make, tmp_path: Path, caplog: pytest.LogCaptureFixture, ending: str, warns: bool
) -> None:
    far = replace(random_splats(30), origin=np.array([4.5e5, 5.2e6, 0.0]))
    ordered = save(tmp_path / f"a{ending}", far)
    assert ("keeps no origin" in caplog.text) == warns
    read = load(tmp_path / f"a{ending}")
    off = read.positions + read.origin - (ordered.positions + ordered.origin)
    assert (np.abs(off).max() > 0.01) == warns


def test_no_splats(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.ply", random_splats(0))
    assert len(load(tmp_path / "a.ply")) == 0


def test_more_splats_than_a_block(random_splats: Make, tmp_path: Path) -> None:
    splats = random_splats(40_000, 0)
    save(tmp_path / "a.ply", splats)
    fractions: list[float] = []
    assert_same(load(tmp_path / "a.ply", progress=fractions.append), splats)
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1


def test_a_full_disk_is_named(random_splats: Make) -> None:
    with pytest.raises(OSError, match="No space left"), open("/dev/full", "wb") as full:
        ply.write(full, Path("/dev/full"), random_splats(20_000))


def test_writing_takes_little_memory_beside_the_splats(random_splats: Make, tmp_path: Path) -> None:
    splats = random_splats(100_000)
    tracemalloc.start()
    save(tmp_path / "a.ply", splats)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < splats.nbytes / 2


@given(opacity=st.floats(0, 1, width=32), scale=st.floats(0, 100, width=32))
@settings(deadline=None, max_examples=50)
def test_limits_survive(
    tmp_path_factory: pytest.TempPathFactory, opacity: float, scale: float
) -> None:
    path = tmp_path_factory.mktemp("limits") / "a.ply"
    splats = Splats(np.zeros((1, 3)), [[0, 0, 0, 1]], [[scale] * 3], [opacity], np.zeros((1, 1, 3)))  # type: ignore[arg-type]
    save(path, splats, overwrite=True)
    assert_same(load(path), splats, tolerance=1e-5)


def test_layout_is_that_of_the_inria_code(random_splats: Make, tmp_path: Path) -> None:
    splats = random_splats(3)
    save(tmp_path / "a.ply", splats)
    rows = rows_of(tmp_path / "a.ply")
    assert rows.dtype.names is not None
    assert rows.dtype.names[:9] == ("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2")
    assert rows.dtype.names[-8:-4] == ("opacity", "scale_0", "scale_1", "scale_2")
    np.testing.assert_array_equal(rows["rot_0"], splats.orientations[:, 3])
    np.testing.assert_array_equal(rows["f_rest_0"], splats.sh[:, 1, 0])
    np.testing.assert_array_equal(rows["f_rest_1"], splats.sh[:, 2, 0])
    np.testing.assert_array_equal(rows["f_rest_15"], splats.sh[:, 1, 1])
    np.testing.assert_allclose(np.exp(rows["scale_1"]), splats.scales[:, 1], rtol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-rows["opacity"])), splats.opacities, rtol=1e-5)


@pytest.mark.parametrize("form", [{"text": True}, {"byte_order": ">"}, {"byte_order": "<"}])
def test_text_and_byte_orders(random_splats: Make, tmp_path: Path, form: dict[str, object]) -> None:
    splats = random_splats(20, 1)
    save(tmp_path / "a.ply", splats)
    write_rows(tmp_path / "b.ply", rows_of(tmp_path / "a.ply"), **form)
    assert_same(load(tmp_path / "b.ply"), splats)


def test_text_is_read_by_parts_and_may_be_given_up(
    random_splats: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rosplat_core.formats.ply_file.ROWS", 7)
    splats = random_splats(50, 1)
    save(tmp_path / "a.ply", splats)
    write_rows(tmp_path / "b.ply", rows_of(tmp_path / "a.ply"), text=True)
    told: list[float] = []
    assert_same(load(tmp_path / "b.ply", told.append), splats)
    assert told == sorted(told)
    assert len(told) > 50 / 7

    def end(part: float) -> None:
        assert part < 0.5
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        load(tmp_path / "b.ply", end)


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=10)
def test_any_order_of_properties_and_types(
    random_splats: Make, tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    folder = tmp_path_factory.mktemp("order")
    splats = random_splats(10, 2)
    save(folder / "a.ply", splats)
    rows = rows_of(folder / "a.ply")
    rng = np.random.default_rng(seed)
    names = [*rng.permutation(rows.dtype.names or ()), "label"]
    shuffled = np.zeros(10, [(str(name), rng.choice(["f4", "f8"])) for name in names])
    for name in rows.dtype.names or ():
        shuffled[name] = rows[name]
    write_rows(folder / "b.ply", shuffled)
    assert_same(load(folder / "b.ply"), splats)


def test_far_doubles_keep_their_millimetres(random_splats: Make, tmp_path: Path) -> None:
    splats = replace(random_splats(20), origin=np.array([4.5e6, 5e5, 300.0]))
    save(tmp_path / "a.ply", splats)
    back = load(tmp_path / "a.ply")
    np.testing.assert_allclose(
        back.positions + back.origin, splats.positions + splats.origin, rtol=0, atol=1e-5
    )
    assert np.abs(back.positions).max() < 10


def test_2d_gaussians_are_flat(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.ply", random_splats(5))
    rows = rows_of(tmp_path / "a.ply")
    write_rows(
        tmp_path / "b.ply",
        without(rows, "scale_2"),
    )
    flat = load(tmp_path / "b.ply")
    assert not flat.scales[:, 2].any()
    assert flat.scales[:, :2].all()
    assert flat.model is Model.DISC


@pytest.mark.parametrize(
    ("comments", "expected"),
    [
        (["SplatRenderMode: mip"], Model.EWA_ANTIALIASED),
        (["splatrendermode: default"], Model.EWA),
        (["SplatRenderMode: ray"], Model.RAY),
        (["SplatRenderMode: disc"], Model.DISC),
        (["SplatRenderMode: 2dgs"], Model.DISC),
        (["antialiased 1", "SplatRenderMode: unheard of"], Model.EWA_ANTIALIASED),
        (["antialiased 1"], Model.EWA_ANTIALIASED),
        (["antialiased 0"], Model.EWA),
        (["antialiased 1", "SplatRenderMode: default"], Model.EWA),
        (["trained antialiased 1"], Model.EWA),
    ],
)
def test_comments_tell_how_it_was_trained(
    random_splats: Make, tmp_path: Path, comments: list[str], expected: Model
) -> None:
    save(tmp_path / "a.ply", random_splats(3))
    write_rows(tmp_path / "b.ply", rows_of(tmp_path / "a.ply"), comments=comments)
    assert load(tmp_path / "b.ply").model is expected


def test_mip_splatting_s_filter_is_applied_as_its_own_fused_ply_has_it(
    random_splats: Make, tmp_path: Path
) -> None:
    splats = random_splats(50)
    save(tmp_path / "a.ply", splats)
    filters = np.random.default_rng(0).uniform(0, 0.1, 50).astype(np.float32)
    rows = structured.append_fields(
        rows_of(tmp_path / "a.ply"), "filter_3D", filters, usemask=False
    )
    write_rows(tmp_path / "filtered.ply", rows)
    # After save_fused_ply() of Mip-Splatting.
    squares = splats.scales.astype(np.float64) ** 2
    wider = squares + filters[:, None] ** 2
    fused = replace(
        splats,
        scales=np.sqrt(wider),
        opacities=splats.opacities * np.sqrt(squares.prod(axis=1) / wider.prod(axis=1)),
        model=Model.EWA_ANTIALIASED,
    )
    assert_same(load(tmp_path / "filtered.ply"), fused, tolerance=1e-5)


def test_unusable_splats_are_dropped_and_counted(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.ply", random_splats(10))
    rows = rows_of(tmp_path / "a.ply")
    rows["x"][1] = np.nan
    rows["f_rest_7"][3] = -np.inf
    rows["scale_0"][4] = 200  # beyond float32 once it is no longer a logarithm
    for name in ("rot_0", "rot_1", "rot_2", "rot_3"):
        rows[name][6] = 0
    write_rows(tmp_path / "b.ply", rows)
    warnings: list[str] = []
    splats = load(tmp_path / "b.ply", warn=warnings.append)
    assert_same(splats, load(tmp_path / "a.ply")[np.array([0, 2, 5, 7, 8, 9])])
    assert len(warnings) == 1
    assert "b.ply: dropped 4 of 10" in warnings[0]


@pytest.mark.parametrize(
    ("comments", "up"),
    [
        (["Exported from Brush", "Vertical axis: 0 -1 0"], (0, -1, 0)),
        (["Exported from Brush", "Vertical axis: [0, 3, 4]"], (0, 0.6, 0.8)),
        (["Exported from Brush", "Vertical axis: y"], (0, -1, 0)),
        (["Generated by Nerstudio 1.1.5", "Vertical Axis: z"], (0, 0, 1)),
        (["vertical axis: z (local, metres)", "Vertical axis: nonsense"], (0, 0, 1)),
        (["up_axis: -x"], (-1, 0, 0)),
        (["Vertical axis: 0 0 0"], None),
        (["Vertical axis: nan 0 1"], None),
        (["the vertical axis: z"], None),
    ],
)
def test_a_comment_tells_the_vertical(
    random_splats: Make, tmp_path: Path, comments: list[str], up: tuple[float, ...] | None
) -> None:
    save(tmp_path / "a.ply", random_splats(3))
    write_rows(tmp_path / "b.ply", rows_of(tmp_path / "a.ply"), comments=comments)
    splats = load(tmp_path / "b.ply")
    assert splats.up == axes(tmp_path / "b.ply").up == (up and pytest.approx(up))
    for ending in (".ply", ".compressed.ply"):
        save(tmp_path / f"c{ending}", splats)
        assert load(tmp_path / f"c{ending}").up == (up and pytest.approx(up))


@pytest.mark.parametrize("with_rotations", [True, False])
def test_one_scale_makes_spheres(random_splats: Make, tmp_path: Path, with_rotations: bool) -> None:
    splats = random_splats(20, 0)
    save(tmp_path / "a.ply", replace(splats, scales=np.repeat(splats.scales[:, :1], 3, axis=1)))
    lacking = ["scale_1", "scale_2", *([] if with_rotations else [f"rot_{i}" for i in range(4)])]
    write_rows(tmp_path / "b.ply", structured.drop_fields(rows_of(tmp_path / "a.ply"), lacking))
    same, spheres = load(tmp_path / "a.ply"), load(tmp_path / "b.ply")
    np.testing.assert_array_equal(spheres.scales, same.scales)
    expected = same.orientations if with_rotations else np.tile([0, 0, 0, 1], (20, 1))
    np.testing.assert_array_equal(spheres.orientations, expected)


@pytest.mark.parametrize("names", [("red", "green", "blue"), ("r", "g", "b")])
@pytest.mark.parametrize(
    ("kind", "white"), [("u1", 255), ("u2", 65535), ("f4", 1), ("f4", 255), ("f8", 255)]
)
def test_red_green_blue_in_place_of_harmonics(
    random_splats: Make, tmp_path: Path, names: tuple[str, ...], kind: str, white: int
) -> None:
    save(tmp_path / "a.ply", random_splats(300, 0))
    rows = structured.drop_fields(rows_of(tmp_path / "a.ply"), [f"f_dc_{i}" for i in range(3)])
    colors = np.random.default_rng(0).uniform(0, 1, (300, 3))
    for name, values in zip(names, colors.T, strict=True):
        values = (values * white).astype(kind)
        rows = structured.append_fields(rows, name, values, usemask=False)
    write_rows(tmp_path / "b.ply", rows)
    splats = load(tmp_path / "b.ply")
    drawn = 0.5 + 0.28209479177387814 * splats.sh[:, 0]
    np.testing.assert_allclose(drawn, colors, atol=1e-6 if white == 1 else 1 / 254)
    assert not splats.channels


def test_bands_above_the_third_are_left_out(random_splats: Make, tmp_path: Path) -> None:
    splats = random_splats(10)
    save(tmp_path / "a.ply", splats)
    rows = rows_of(tmp_path / "a.ply")
    for i in reversed(range(45)):  # 15 coefficients a colour become 24
        number = i + 9 * (i // 15)
        rows = structured.rename_fields(rows, {f"f_rest_{i}": f"f_rest_{number}"})
    for number in sorted({*range(72)} - {i + 9 * (i // 15) for i in range(45)}):
        rows = structured.append_fields(rows, f"f_rest_{number}", np.full(10, 9.0), usemask=False)
    write_rows(tmp_path / "b.ply", rows)
    told: list[str] = []
    assert_same(load(tmp_path / "b.ply", warn=told.append), splats)
    assert told == [f"{tmp_path / 'b.ply'}: spherical harmonics above band 3 left out, of 4 bands"]


@pytest.mark.parametrize("named", ["half", "float16", "ushort", "short"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_half_floats_by_any_name(
    random_splats: Make, tmp_path: Path, named: str, order: str
) -> None:
    splats = replace(random_splats(20, 1), channels={"label": np.arange(20, dtype=np.float32)})
    save(tmp_path / "a.ply", splats)
    rows = rows_of(tmp_path / "a.ply")
    halves = [(name, f"{order}f2") for name in rows.dtype.names or () if name != "label"]
    packed = rows.astype([*halves, ("label", f"{order}u2")])
    form = "little" if order == "<" else "big"
    lines = [f"property {named} {name}" for name, _ in halves]
    head = [f"ply\nformat binary_{form}_endian 1.0\nelement vertex 20", *lines]
    head += ["property ushort label", "end_header", ""]
    (tmp_path / "b.ply").write_bytes("\n".join(head).encode() + packed.tobytes())
    read = load(tmp_path / "b.ply")
    np.testing.assert_allclose(read.positions, splats.positions, atol=2e-3)
    np.testing.assert_allclose(read.scales, splats.scales, rtol=4e-3)
    np.testing.assert_allclose(read.sh, splats.sh, atol=2e-3)
    np.testing.assert_array_equal(read.channels["label"], np.arange(20))


def test_text_has_many_names_for_no_number(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.ply", random_splats(12, 0))
    write_rows(tmp_path / "b.ply", rows_of(tmp_path / "a.ply"), text=True)
    head, body = (tmp_path / "b.ply").read_text().split("end_header\n")
    names = ["-nan(ind)", "nan(snan)", "1.#QNAN", "-1.#IND00", "1.#INF", "-1.#INF00", "nanq"]
    lines = body.splitlines()
    for number, name in enumerate(names):
        lines[number] = f"{name} {lines[number].partition(' ')[2]}"
    (tmp_path / "c.ply").write_text(head + "end_header\n" + "\n".join(lines))
    told: list[str] = []
    assert_same(load(tmp_path / "c.ply", warn=told.append), load(tmp_path / "a.ply")[7:])
    assert "dropped 7 of 12" in told[0]


def test_linear_scales_and_opacities_are_suspected(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.ply", random_splats(50, 0))
    rows = rows_of(tmp_path / "a.ply")
    for name in ("scale_0", "scale_1", "scale_2", "opacity"):
        rows[name] = np.random.default_rng(0).uniform(0.001, 0.1, 50)
    write_rows(tmp_path / "b.ply", rows)
    told: list[str] = []
    load(tmp_path / "a.ply", warn=told.append)
    assert not told
    load(tmp_path / "b.ply", warn=told.append)
    assert "scale_0 is from 0 to 1 in all splats: no logarithms" in told[0]
    assert "opacity is from 0 to 1 in all splats: no logits" in told[1]


def test_what_is_no_splat_is_named(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.ply", random_splats(3))
    rows = rows_of(tmp_path / "a.ply")
    anchors = structured.append_fields(rows, "f_anchor_feat_0", np.zeros(3), usemask=False)
    write_rows(tmp_path / "anchors.ply", anchors)
    write_rows(tmp_path / "unturned.ply", without(rows, "rot_3"))
    for name, reason in (("anchors", "anchors of Scaffold-GS"), ("unturned", "no property rot_3")):
        with pytest.raises(InputError, match=rf"{name}\.ply: .*{reason}"):
            load(tmp_path / f"{name}.ply")


def test_a_point_cloud_is_told_from_a_scene(tmp_path: Path) -> None:
    write_rows(tmp_path / "cloud.ply", np.zeros(5, [("x", "f4"), ("y", "f4"), ("z", "f4")]))
    with pytest.raises(
        InputError, match=r"cloud\.ply: not a Gaussian splat: no property opacity, f_dc_0"
    ):
        load(tmp_path / "cloud.ply")


def test_a_truncated_file_names_what_is_missing(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.ply", random_splats(10))
    whole = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "b.ply").write_bytes(whole[:-300])
    with pytest.raises(
        InputError, match=rf"b\.ply: truncated.* 10 rows .*{len(whole) - 300:,} bytes hold 8"
    ):
        load(tmp_path / "b.ply")


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        ("format ascii 2.0|end_header|", "version 1.0"),
        ("format binary_little_endian 1.0|element vertex 5|", "no end_header"),
        ("format ascii 1.0|element face 0|property float x|end_header|", "no element vertex"),
        ("format ascii 1.0|element vertex 2|property float x|end_header|1|oops|", "malformed"),
        ("format ascii 1.0|element vertex 2|property float x|end_header|1|", "truncated"),
        ("format ascii 1.0|element vertex -2|property float x|end_header|", "element vertex -2"),
        (f"format ascii 1.0|element vertex {10**14}|property float x|end_header|1|", "truncated"),
        (
            f"format binary_big_endian 1.0|element vertex {10**14}|property float x|end_header|",
            "truncated",
        ),
        (
            "format ascii 1.0|element vertex 0|property float x|property float x|end_header|",
            "'x' occurs more than once",
        ),
        (
            "format ascii 1.0|element vertex 0|property quaternion x|end_header|",
            "no such type",
        ),
        ("form\xe9t", "no end_header"),
        ("comment " + "x" * (1 << 17) + "|end_header|", "no end_header"),
        ("format ascii 1.0|element face 1|end_header|1|", "has rows, but no property"),
        ("end_header|", "no format"),
        ("property float x|end_header|", "property float x"),
        ("format ascii 1.0|element vertex 1|element vertex 1|end_header|", "element vertex 1"),
        (
            "format binary_little_endian 1.0|element face 1|property list uchar int i|"
            "element vertex 1|property float x|end_header|123456",
            "with lists before element vertex",
        ),
    ],
)
def test_broken_headers(tmp_path: Path, lines: str, reason: str) -> None:
    text = "ply\n" + lines.replace("|", "\n")
    (tmp_path / "broken.ply").write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=rf"broken\.ply: .*{reason}"):
        load(tmp_path / "broken.ply")


def test_lists_and_odd_counts_are_refused(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.ply", random_splats(2, 1))
    rows = rows_of(tmp_path / "a.ply")
    names = rows.dtype.names or ()
    write_rows(tmp_path / "odd.ply", without(rows, "f_rest_8"))
    with pytest.raises(InputError, match=r"8 properties f_rest_\*"):
        load(tmp_path / "odd.ply")
    listed = np.empty(2, [(name, "O" if name == "opacity" else "f4") for name in names])
    for name in names:
        for i in range(2):
            listed[name][i] = np.zeros(1, "f4") if name == "opacity" else 0
    write_rows(tmp_path / "list.ply", listed)
    with pytest.raises(InputError, match="opacity is a list"):
        load(tmp_path / "list.ply")


def test_a_failed_save_leaves_the_old_file(random_splats: Make, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.obj: can't write"):
        save(tmp_path / "a.obj", random_splats(1))
    with pytest.raises(InputError, match="nowhere"):
        save(tmp_path / "nowhere" / "a.ply", random_splats(1))
    save(tmp_path / "a.ply", random_splats(1))
    with pytest.raises(InputError, match="exists already"):
        save(tmp_path / "a.ply", random_splats(2))
    save(tmp_path / "a.ply", random_splats(2), overwrite=True)
    assert len(load(tmp_path / "a.ply")) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


def test_a_trained_scene(scene: Callable[[str], Path]) -> None:
    splats = load(scene("train-1000.ply"))
    assert (len(splats), splats.sh_degree) == (1000, 3)
    np.testing.assert_allclose(np.linalg.norm(splats.orientations, axis=1), 1, rtol=1e-5)


@pytest.mark.parametrize("before", ["scalar_", "scal_", "scalar_scal_"])
def test_fields_that_cloudcompare_kept_are_read(
    random_splats: Make, tmp_path: Path, before: str
) -> None:
    splats = random_splats(5, 1)
    save(tmp_path / "a.ply", splats)
    rows = rows_of(tmp_path / "a.ply")
    kept = {*ply.POSITION, *ply.NORMAL}
    rows.dtype.names = tuple(n if n in kept else before + n for n in rows.dtype.names or ())
    points = np.zeros(5, "u1")  # its colours of points, beside those of the splats
    write_rows(tmp_path / "b.ply", structured.append_fields(rows, "red", points, usemask=False))
    assert_same(load(tmp_path / "b.ply"), splats)


def test_other_names_of_the_same_are_read(random_splats: Make, tmp_path: Path) -> None:
    splats = random_splats(5, 1)
    save(tmp_path / "a.ply", splats)
    rows = rows_of(tmp_path / "a.ply")
    others = {usual: other for other, usual in ply.SAME.items()}
    rows.dtype.names = tuple(others.get(name, name) for name in rows.dtype.names or ())
    write_rows(tmp_path / "b.ply", rows)
    assert_same(load(tmp_path / "b.ply"), splats)


@pytest.mark.parametrize("name", ["trbf_center", "scale_t"])
def test_scenes_in_motion_are_named(random_splats: Make, tmp_path: Path, name: str) -> None:
    save(tmp_path / "a.ply", replace(random_splats(5), channels={name: np.zeros(5)}))
    with pytest.raises(InputError, match=f"a scene in motion, by its property {name}"):
        load(tmp_path / "a.ply")


def test_blanks_at_the_ends_of_a_header_s_lines(random_splats: Make, tmp_path: Path) -> None:
    splats = random_splats(5)
    save(tmp_path / "a.ply", splats)
    head, end, rows = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    (tmp_path / "b.ply").write_bytes((head + end).replace(b"\n", b" \t\n") + rows)
    assert_same(load(tmp_path / "b.ply"), splats)
