"""glTF: attributes lie as KHR_gaussian_splatting has them, and stand where nodes place them."""

import base64
import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rosplat_core.cameras import Camera, look_at
from rosplat_core.formats import InputError, axes, load, save
from rosplat_core.models import Model
from rosplat_core.quaternions import to_matrices
from rosplat_core.rendering import render
from rosplat_core.splats import Splats

Make = Callable[..., Splats]
Change = Callable[[Any], None]

PREFIX = "KHR_gaussian_splatting:"


def parts(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON and the buffer of a .glb."""
    data = path.read_bytes()
    magic, version, length, size, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    held, kind = struct.unpack_from("<I4s", data, 20 + size)
    assert (held, kind, len(data) % 4) == (len(data) - 28 - size, b"BIN\0", 0)
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def write(path: Path, asset: Any, buffer: bytes) -> Path:
    """A .glb of these."""
    text = json.dumps(asset).encode()
    text += b" " * (-len(text) % 4)
    length = 28 + len(text) + len(buffer)
    head = struct.pack("<4sIII4s", b"glTF", 2, length, len(text), b"JSON")
    path.write_bytes(head + text + struct.pack("<I4s", len(buffer), b"BIN\0") + buffer)
    return path


@pytest.fixture
def changed(random_splats: Make, tmp_path: Path) -> Callable[[Change], Path]:
    """A .glb of 20 splats of degree 1 whose JSON somebody changed."""

    def make(change: Change) -> Path:
        save(tmp_path / "whole.glb", random_splats(20, 1), overwrite=True)
        asset, buffer = parts(tmp_path / "whole.glb")
        change(asset)
        return write(tmp_path / "a.glb", asset, buffer)

    return make


def test_a_splat_by_hand(tmp_path: Path) -> None:
    values = {
        "POSITION": ("VEC3", [1, -2, 3]),
        "KHR_gaussian_splatting:ROTATION": ("VEC4", [0, -1, 0, 0]),
        "KHR_gaussian_splatting:SCALE": ("VEC3", [0.5, 0.25, 2]),
        "KHR_gaussian_splatting:OPACITY": ("SCALAR", [0.75]),
        "KHR_gaussian_splatting:SH_DEGREE_0_COEF_0": ("VEC3", [0.1, 0.2, 0.3]),
        "KHR_gaussian_splatting:SH_DEGREE_1_COEF_0": ("VEC3", [1, 2, 3]),
        "KHR_gaussian_splatting:SH_DEGREE_1_COEF_1": ("VEC3", [4, 5, 6]),
        "KHR_gaussian_splatting:SH_DEGREE_1_COEF_2": ("VEC3", [7, 8, 9]),
    }
    buffer, views, accessors = b"", [], []
    for kind, numbers in values.values():
        data = struct.pack(f"<{len(numbers)}f", *numbers)
        views.append({"buffer": 0, "byteOffset": len(buffer), "byteLength": len(data)})
        accessors.append(
            {"bufferView": len(accessors), "componentType": 5126, "count": 1, "type": kind}
        )
        buffer += data
    primitive = {
        "attributes": {name: index for index, name in enumerate(values)},
        "mode": 0,
        "extensions": {
            "KHR_gaussian_splatting": {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
        },
    }
    asset = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(buffer)}],
    }
    splats = load(write(tmp_path / "a.glb", asset, buffer))
    np.testing.assert_array_equal(splats.positions, [[1, -2, 3]])
    np.testing.assert_array_equal(splats.orientations, [[0, -1, 0, 0]])
    np.testing.assert_array_equal(splats.scales, [[0.5, 0.25, 2]])
    np.testing.assert_array_equal(splats.opacities, [0.75])
    np.testing.assert_array_equal(
        splats.sh[0], np.float32([[0.1, 0.2, 0.3], [1, 2, 3], [4, 5, 6], [7, 8, 9]])
    )
    assert axes(tmp_path / "a.glb").up == (0, 1, 0)


@pytest.mark.parametrize("degree", range(4))
def test_round_trip(random_splats: Make, tmp_path: Path, degree: int) -> None:
    splats = random_splats(20_000, degree, model=Model(degree))
    save(tmp_path / "a.glb", splats)
    back = load(tmp_path / "a.glb")
    for name in ("positions", "scales", "opacities", "sh", "model"):
        np.testing.assert_array_equal(getattr(back, name), getattr(splats, name))
    np.testing.assert_allclose(back.orientations, splats.orientations, atol=2e-7)


def test_a_far_map_keeps_its_millimetres(random_splats: Make, tmp_path: Path) -> None:
    splats = replace(random_splats(100), origin=np.array([3e6, 0, -5e5]))
    save(tmp_path / "a.glb", splats)
    back = load(tmp_path / "a.glb")
    moved = back.positions + (back.origin - splats.origin) - splats.positions
    np.testing.assert_allclose(moved, 0, atol=1e-5)


def test_what_the_specification_wants(random_splats: Make, tmp_path: Path) -> None:
    splats = random_splats(100)
    save(tmp_path / "a.glb", splats)
    asset, buffer = parts(tmp_path / "a.glb")
    (primitive,) = asset["meshes"][0]["primitives"]
    position = asset["accessors"][primitive["attributes"]["POSITION"]]
    assert position["min"] == splats.positions.min(axis=0).tolist()
    assert position["max"] == splats.positions.max(axis=0).tolist()
    ends = [view["byteOffset"] + view["byteLength"] for view in asset["bufferViews"]]
    assert ends[-1] == asset["buffers"][0]["byteLength"] == len(buffer)
    assert all(end % 4 == 0 for end in ends)
    colour = asset["bufferViews"][primitive["attributes"]["COLOR_0"]]["byteOffset"]
    encoded = np.clip(0.28209479 * splats.sh[0, 0] + 0.5, 0, 1)
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(list(buffer[colour : colour + 3]), 255 * linear, atol=0.51)
    assert buffer[colour + 3] == round(255 * float(splats.opacities[0]))


def test_no_splats_are_a_file_too(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.glb", random_splats(0))
    assert len(load(tmp_path / "a.glb")) == 0


@pytest.mark.parametrize("embedded", [True, False])
def test_text_with_a_buffer(random_splats: Make, tmp_path: Path, embedded: bool) -> None:
    splats = random_splats(20)
    save(tmp_path / "a.glb", splats)
    asset, buffer = parts(tmp_path / "a.glb")
    (tmp_path / "the buffer.bin").write_bytes(buffer)
    data = f"data:application/octet-stream;base64,{base64.b64encode(buffer).decode()}"
    asset["buffers"][0]["uri"] = data if embedded else "the%20buffer.bin"
    (tmp_path / "b.gltf").write_text(json.dumps(asset))
    np.testing.assert_array_equal(load(tmp_path / "b.gltf").sh, splats.sh)


def test_whole_numbers(tmp_path: Path, changed: Callable[[Change], Path]) -> None:
    """Of each attribute that may be packed; SCALE as it is, the others as parts of the largest."""

    def pack(asset: Any) -> None:
        attributes = asset["meshes"][0]["primitives"][0]["attributes"]
        for name, kind, normalized in (
            ("POSITION", 5122, False),
            (f"{PREFIX}ROTATION", 5120, True),
            (f"{PREFIX}SCALE", 5121, False),
            (f"{PREFIX}OPACITY", 5123, True),
        ):
            accessor = asset["accessors"][attributes[name]]
            accessor |= {"componentType": kind, "normalized": normalized}
            asset["bufferViews"][accessor["bufferView"]]["byteStride"] = 8

    asset, buffer = parts(changed(pack))
    data = bytearray(buffer)
    attributes = asset["meshes"][0]["primitives"][0]["attributes"]
    for name, form, numbers in (
        ("POSITION", "<3h", (-300, 7, 20)),
        (f"{PREFIX}ROTATION", "<4b", (-128, 0, 0, 127)),
        (f"{PREFIX}SCALE", "<3B", (1, 2, 255)),
        (f"{PREFIX}OPACITY", "<H", (13107,)),
    ):
        view = asset["bufferViews"][asset["accessors"][attributes[name]]["bufferView"]]
        view["byteLength"] = 160
        for row in range(20):
            struct.pack_into(form, data, view["byteOffset"] + 8 * row, *numbers)
    view = asset["bufferViews"][asset["accessors"][attributes[f"{PREFIX}OPACITY"]]["bufferView"]]
    data += data[view["byteOffset"] : view["byteOffset"] + 160]
    view["byteOffset"] = len(buffer)
    for row in range(20):
        struct.pack_into("<H", data, len(buffer) + 8 * row, 13107)
    asset["buffers"][0]["byteLength"] = len(data)
    splats = load(write(tmp_path / "b.glb", asset, bytes(data)))
    np.testing.assert_array_equal(splats.positions[3], [-300, 7, 20])
    np.testing.assert_allclose(splats.orientations[3], np.sqrt([0.5, 0, 0, 0.5]) * [-1, 0, 0, 1])
    np.testing.assert_array_equal(splats.scales[3], [1, 2, 255])
    np.testing.assert_allclose(splats.opacities[:19], 0.2)


@pytest.mark.parametrize("offset", [0, 8])
def test_interleaved_attributes(random_splats: Make, tmp_path: Path, offset: int) -> None:
    """All of a splat's floats side by side, from some byte of the view on."""
    splats = random_splats(20, 0)
    save(tmp_path / "a.glb", splats)
    asset, _ = parts(tmp_path / "a.glb")
    columns = {
        "POSITION": splats.positions,
        f"{PREFIX}ROTATION": splats.orientations,
        f"{PREFIX}SCALE": splats.scales,
        f"{PREFIX}OPACITY": splats.opacities[:, None],
        f"{PREFIX}SH_DEGREE_0_COEF_0": splats.sh[:, 0],
    }
    data = bytes(offset) + np.concatenate(list(columns.values()), axis=1).tobytes()
    asset["bufferViews"] = [{"buffer": 0, "byteLength": len(data), "byteStride": 56}]
    asset["buffers"] = [{"byteLength": len(data)}]
    place = offset
    for name, values in columns.items():
        asset["accessors"][attributes(asset)[name]] |= {"bufferView": 0, "byteOffset": place}
        place += 4 * values.shape[1]
    read = load(write(tmp_path / "b.glb", asset, data))
    np.testing.assert_array_equal(read.positions, splats.positions)
    np.testing.assert_array_equal(read.scales, splats.scales)
    np.testing.assert_array_equal(read.opacities, splats.opacities)
    np.testing.assert_array_equal(read.sh, splats.sh)


def picture(splats: Splats, pose: np.ndarray) -> np.ndarray:
    """What a camera sees that stands 6 m before splats of a given pose, wherever that is."""
    seen = look_at((1, 2, 6), (0, 0, 0), (0, 1, 0)) @ np.linalg.inv(pose)
    return render(splats, Camera(0, 96, 64, 90, 90, 48, 32, seen))


def test_a_turned_node_looks_the_same_from_its_side(
    random_splats: Make, changed: Callable[[Change], Path]
) -> None:
    turn = np.array([0.1, -0.7, 0.3, 0.6])
    turn /= np.linalg.norm(turn)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = to_matrices(turn), (3, -4, 5)

    def place(asset: Any) -> None:
        asset["nodes"] = [
            {"children": [1], "translation": pose[:3, 3].tolist()},
            {"mesh": 0, "rotation": turn.tolist()},
        ]

    placed = load(changed(place))
    before, after = picture(random_splats(20, 1), np.eye(4)), picture(placed, pose)
    assert before.max() > 0.5
    np.testing.assert_allclose(after, before, atol=2e-3)  # the rasteriser's own numbers


def test_stretched_and_mirrored_nodes(
    random_splats: Make, changed: Callable[[Change], Path]
) -> None:
    """Covariances are those that the specification gives: M C C^T M^T."""
    whole = random_splats(20, 1)
    for scale in ((2, 2, 2), (2, 1, 0.5), (-1, 1, 1)):
        matrix = np.diag([*scale, 1.0])

        def place(asset: Any, matrix: np.ndarray = matrix) -> None:
            asset["nodes"][0]["matrix"] = matrix.T.flatten().tolist()

        placed = load(changed(place))
        axes_before = to_matrices(whole.orientations) * whole.scales[:, None, :]
        axes_after = to_matrices(placed.orientations) * placed.scales[:, None, :]
        half = np.diag(scale) @ axes_before
        np.testing.assert_allclose(
            axes_after @ axes_after.transpose(0, 2, 1), half @ half.transpose(0, 2, 1), atol=1e-6
        )
        np.testing.assert_allclose(placed.positions, whole.positions * scale, rtol=1e-6)
    # Band 1's third is along x, which was mirrored last.
    np.testing.assert_allclose(placed.sh, whole.sh * [[1], [1], [1], [-1]], atol=1e-5)


def test_a_mesh_in_two_places(random_splats: Make, changed: Callable[[Change], Path]) -> None:
    def twice(asset: Any) -> None:
        asset["nodes"] = [{"mesh": 0}, {"mesh": 0, "translation": [0, 0, 9]}]
        asset["scenes"] = [{"nodes": [1]}, {"nodes": [0, 1]}]
        asset["scene"] = 1

    splats, whole = load(changed(twice)), random_splats(20, 1)
    assert len(splats) == 40
    np.testing.assert_array_equal(splats.positions[:20], whole.positions)
    np.testing.assert_array_equal(splats.positions[20:], whole.positions + np.float32([0, 0, 9]))


def told(asset: Any) -> Any:
    return asset["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"]


def attributes(asset: Any) -> Any:
    return asset["meshes"][0]["primitives"][0]["attributes"]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda a: a["asset"].update(version="3.0"), "glTF '3.0' can't be read"),
        (lambda a: a.update(extensionsRequired=["EXT_x"]), "requires 'EXT_x'"),
        (lambda a: told(a).update(kernel="disc"), "kernel 'disc'"),
        (lambda a: attributes(a).pop(f"{PREFIX}SCALE"), f"no attribute {PREFIX}SCALE"),
        (lambda a: attributes(a).pop(f"{PREFIX}SH_DEGREE_1_COEF_1"), "SH_DEGREE_1_COEF_1"),
        (lambda a: a["accessors"][2].update(count=19), "different lengths"),
        (lambda a: a["accessors"][2].update(count=21), "truncated"),
        (lambda a: a["accessors"][2].update(count=1 << 40), "count is 1099511627776"),
        (lambda a: a["accessors"][2].update(count=True), "count is True"),
        (lambda a: a["accessors"][2].update(sparse={}), "sparse"),
        (lambda a: a["accessors"][2].update(type="MAT4"), "'MAT4'"),
        (lambda a: a["accessors"][2].update(componentType=5130), "type 5130"),
        (lambda a: a["accessors"][2].update(bufferView=99), r"no bufferViews\[99\]"),
        (lambda a: a["bufferViews"][0].update(byteOffset=-4), "byteOffset is -4"),
        (lambda a: a["bufferViews"][0].update(byteStride=0), "byteStride is 0"),
        (lambda a: a["buffers"][0].update(byteLength=1 << 50), "truncated: buffer 0"),
        (lambda a: a["nodes"][0].update(children=[0]), "node 0 stands in two places"),
        (lambda a: a["nodes"][0].update(matrix=[1] * 15), "broken glTF"),
        (lambda a: a["nodes"][0].update(scale=[1e308, 1, float("inf")]), "not finite"),
        (lambda a: a["nodes"][0].update(rotation=[0, 0, 0, 0]), "no quaternion"),
        (lambda a: a.pop("nodes"), "broken glTF"),
        (lambda a: (a.pop("extensionsUsed"), a.pop("nodes"), a.pop("scenes")), "holds no splats"),
        (lambda a: a["meshes"][0]["primitives"][0].update(mode=[1e308] * 256), "not as points"),
        (lambda a: a["meshes"][0]["primitives"][0].pop("mode"), "mode 4, not as points"),
    ],
)
def test_what_is_wrong_is_named(
    changed: Callable[[Change], Path], change: Change, reason: str
) -> None:
    with pytest.raises(InputError, match=rf"a\.glb: .*{reason}") as error:
        load(changed(change))
    assert len(str(error.value)) < 1000


def test_compressed_splats_are_refused_by_their_extension(
    changed: Callable[[Change], Path],
) -> None:
    """Until KHR_gaussian_splatting_compression_spz_2, a draft, is settled."""

    def compress(asset: Any) -> None:
        name = "KHR_gaussian_splatting_compression_spz_2"
        told(asset)["extensions"] = {name: {"bufferView": 0}}
        for accessor in asset["accessors"]:
            del accessor["bufferView"]

    with pytest.raises(InputError, match=r"packed by KHR_gaussian_splatting_compression_spz_2"):
        load(changed(compress))


@pytest.mark.parametrize("uri", ["../b.bin", "/etc/passwd", "http://host/b.bin", "none.bin", ""])
def test_buffers_lie_below_the_scene(
    changed: Callable[[Change], Path], tmp_path: Path, uri: str
) -> None:
    asset, _ = parts(changed(lambda asset: None))
    asset["buffers"][0]["uri"] = uri
    (tmp_path / "b.gltf").write_text(json.dumps(asset))
    with pytest.raises(InputError, match=r"b\.gltf: .*(no file below|No such file)"):
        load(tmp_path / "b.gltf")


def test_many_places_of_a_mesh_are_a_claim(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.glb", random_splats(500))
    asset, buffer = parts(tmp_path / "a.glb")
    asset |= {"nodes": [{"mesh": 0}] * 9000, "scenes": [{"nodes": list(range(9000))}]}
    with pytest.raises(InputError, match=r"4,500,000 splats can't be packed in"):
        load(write(tmp_path / "b.glb", asset, buffer))


def test_a_file_that_is_cut_off(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.glb", random_splats(20))
    whole = (tmp_path / "a.glb").read_bytes()
    for size in (4, 11, 19, 300, len(whole) - 1):
        (tmp_path / "b.glb").write_bytes(whole[:size])
        with pytest.raises(InputError, match=r"b\.glb: truncated"):
            load(tmp_path / "b.glb")


def test_linear_colours_are_told(changed: Callable[[Change], Path]) -> None:
    path = changed(lambda asset: told(asset).update(colorSpace="lin_rec709_display"))
    warned: list[str] = []
    load(path, warn=warned.append)
    assert "lin_rec709_display" in warned[0]


def test_numbers_that_gltf_has_not(random_splats: Make, tmp_path: Path) -> None:
    splats = random_splats(3)
    splats.positions[1, 1] = np.inf
    with pytest.raises(InputError, match="not finite can't be written"):
        save(tmp_path / "a.glb", splats)
    assert not (tmp_path / "a.glb").exists()


@pytest.mark.parametrize(
    ("name", "wrong", "said"),
    [
        ("SCALE", np.log, "scales are negative: logarithms"),  # splat-transform until June 2026
        ("OPACITY", lambda p: np.log(p / (1 - p)), "opacities are no shares: logits"),  # JSplat
    ],
)
def test_trained_numbers_are_taken_for_what_they_are(
    random_splats: Make, tmp_path: Path, name: str, wrong: Callable[[Any], Any], said: str
) -> None:
    splats = random_splats(200, 1)
    splats.opacities[:] = np.linspace(0.75, 0.99, 200)
    save(tmp_path / "a.glb", splats)
    asset, buffer = parts(tmp_path / "a.glb")
    accessor = asset["accessors"][attributes(asset)[PREFIX + name]]
    view = asset["bufferViews"][accessor["bufferView"]]
    part = slice(view["byteOffset"], view["byteOffset"] + view["byteLength"])
    data = bytearray(buffer)
    data[part] = wrong(np.frombuffer(buffer[part], "<f4")).astype("<f4").tobytes()
    warned: list[str] = []
    found = load(write(tmp_path / "b.glb", asset, bytes(data)), warn=warned.append)
    assert said in warned[0]
    np.testing.assert_allclose(found.scales, splats.scales, rtol=1e-5)
    np.testing.assert_allclose(found.opacities, splats.opacities, atol=1e-6)


def test_splats_are_there_whatever_extensions_used_says(
    changed: Callable[[Change], Path],
) -> None:
    path = changed(
        lambda asset: (asset.pop("extensionsUsed"), told(asset).update(colorSpace="BT.709-sRGB"))
    )
    warned: list[str] = []
    assert len(load(path, warn=warned.append)) == 20
    assert not warned  # it is a draft's name for sRGB
