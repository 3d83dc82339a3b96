"""Maps in the messages of other packages: what is written is read again, and what is odd is named.

The messages are stand-ins with the fields of the packages' own definitions.
"""

import warnings
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from core_fixtures import random_splats
from geometry_msgs.msg import Point, Quaternion, Vector3
from point_cloud import cloud
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from rosplat_core.models import Model
from rosplat_core.splats import InputError, Splats, concatenate
from rosplat_tools import foreign
from rosplat_tools.foreign import (
    compact_rows,
    gaussian_array,
    gaussian_splats,
    point_cloud,
    splat_array,
    splat_blob,
    splat_tiles,
)
from rosplat_tools.foreign.covariances import to_covariances

ARRAYS = ("positions", "orientations", "scales", "opacities", "sh")


def silent(text: str) -> None:
    raise AssertionError(text)


class Message(SimpleNamespace):
    """A message with default values."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**{**self.defaults(), **given})

    def defaults(self) -> dict[str, Any]:
        return {}


class GaussianArray(Message):
    def defaults(self) -> dict[str, Any]:
        return {"gaussians": [], "refresh": False}


class SingleGaussian(Message):
    def defaults(self) -> dict[str, Any]:
        return {"xyz": (), "rotation": (), "scale": (), "opacity": 0}


class OlderGaussian(Message):
    def defaults(self) -> dict[str, Any]:
        return {"xyz": Point(), "rotation": Quaternion(), "scale": Vector3(), "opacity": 0.0}


class GaussianSplats(Message):
    TYPE_3DGS, TYPE_2DGS = 0, 1
    RASTERIZE_MODE_CLASSIC, RASTERIZE_MODE_ANTIALIASED = 0, 1


class SplatArray(Message):
    def defaults(self) -> dict[str, Any]:
        return {"splats": []}


class SplatTileChunk(Message):
    CLEAR_ALL, UPSERT_TILE, DELETE_TILE, COMMIT, HEARTBEAT = range(5)

    def defaults(self) -> dict[str, Any]:
        numbers = "tile_x tile_y tile_z lod chunk_index splat_count uncompressed_size chunk_crc64"
        return dict.fromkeys(numbers.split(), 0) | {"data": b"", "chunk_count": 1}


class SplatBlobChunk(Message):
    def defaults(self) -> dict[str, Any]:
        turn = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0)
        shift = SimpleNamespace(x=0.0, y=0.0, z=0.0)
        return {"map_from_source": SimpleNamespace(rotation=turn, translation=shift)}


KINDS: dict[str, Any] = {
    "point_cloud": PointCloud2,
    "gaussian_array": GaussianArray,
    "gaussian_splats": GaussianSplats,
    "splat_array": SplatArray,
    "splat_tiles": SplatTileChunk,
    "splat_blob": SplatBlobChunk,
}
HEADER = Header(frame_id="/odom")


@pytest.fixture(autouse=True)
def message_classes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The parts of messages whose packages aren't here."""
    monkeypatch.setattr(splat_array, "message_class", lambda _: Message)
    monkeypatch.setattr(gaussian_array, "message_class", lambda _: SingleGaussian)


def written(name: str, splats: Splats) -> list[Any]:
    return list(foreign.foreign(name).messages(KINDS[name], splats, HEADER))


def read(name: str, messages: list[Any]) -> Splats:
    reader = foreign.foreign(name).Reader(f"/{name}", silent)
    assert [reader.add(message) for message in messages][-1]
    assert reader.frame_id in ("odom", "")  # without ROS 1's slash
    return reader.splats()


def assert_alike(found: Splats, splats: Splats, opacity: float, sh: float) -> None:
    assert len(found) == len(splats)
    assert found.model == splats.model
    places = [np.lexsort((each.positions + each.origin).T.round(4)) for each in (found, splats)]
    one, other = found[places[0]], splats[places[1]]
    np.testing.assert_allclose(
        one.positions + one.origin, other.positions + other.origin, atol=1e-5
    )
    np.testing.assert_allclose(one.opacities, other.opacities, atol=opacity)
    np.testing.assert_allclose(one.sh, other.sh, atol=sh)
    shapes, truths = to_covariances(one), to_covariances(other)
    size = np.abs(truths).max(axis=(1, 2), keepdims=True)
    assert (np.abs(shapes - truths) <= 1e-3 * size + 2**-24).all()  # a half's


@pytest.mark.parametrize("name", foreign.TYPES)
@pytest.mark.parametrize("degree", [0, 2])
def test_a_map_comes_back(name: str, degree: int) -> None:
    splats = random_splats(5000, degree)
    eight_bits = name not in ("point_cloud", "gaussian_splats", "splat_blob")
    opacity = 0.5 / 255 + 1e-6 if eight_bits else 1e-6
    if name != "splat_tiles":
        assert_alike(read(name, written(name, splats)), splats, opacity, 1e-5)
        return
    base = replace(splats, sh=np.clip(splats.sh[:, :1], -1.7, 1.7))  # what 8 bits can hold
    whole = replace(base, sh=np.concatenate([base.sh, splats.sh[:, 1:]], axis=1))
    assert_alike(
        read(name, written(name, whole)), base, opacity, 0.5 / 255 / compact_rows.C0 + 1e-5
    )


@pytest.mark.parametrize("name", foreign.TYPES)
def test_an_empty_map_comes_back(name: str) -> None:
    assert len(read(name, written(name, random_splats(10, 0)[:0]))) == 0


def test_every_type_has_a_topic_of_its_own() -> None:
    kinds = [foreign.foreign(name) for name in foreign.TYPES]
    assert len({kind.TOPIC for kind in kinds}) == len({kind.TYPE for kind in kinds}) == len(kinds)


def test_a_type_that_is_not_as_it_was_is_named() -> None:
    def kind(name: str, *fields: str) -> Any:
        return SimpleNamespace(TYPE=name, FIELDS=fields)

    with pytest.raises(InputError, match="Map is of no_such_package, which isn't installed"):
        foreign.message_of(kind("no_such_package/msg/Map"))
    with pytest.raises(InputError, match="Header has no means in this release of std_msgs"):
        foreign.message_of(kind("std_msgs/msg/Header", "frame_id", "means"))


# --- Point clouds ---------------------------------------------------------------------------------


@pytest.mark.parametrize("how", [{}, {"big_endian": True}, {"height": 5, "gap": 12}])
def test_a_cloud_is_what_the_same_ply_is(how: dict[str, Any]) -> None:
    splats = random_splats(100, 2)
    found = read("point_cloud", [cloud(splats, **how)])
    for name in ARRAYS:
        np.testing.assert_allclose(
            getattr(found, name), getattr(splats, name), rtol=1e-5, atol=1e-6
        )


def test_further_fields_of_a_cloud_are_channels() -> None:
    splats = replace(random_splats(100), channels={"label": np.arange(100)})
    found = read("point_cloud", [cloud(splats)])
    np.testing.assert_array_equal(found.channels["label"], np.arange(100))


def test_drivers_count_a_cloud_s_fields_as_they_like() -> None:
    splats = random_splats(50, 0)
    message = cloud(splats)
    for field in message.fields:
        field.count = 0
    np.testing.assert_array_equal(read("point_cloud", [message]).sh, splats.sh)
    place = {field.name: field.offset for field in cloud(splats).fields}
    message.fields = [
        PointField(name=name, offset=place[first], datatype=7, count=count)
        for name, first, count in [
            ("position", "x", 3), ("f_dc", "f_dc_0", 3), ("opacity", "opacity", 1),
            ("scale", "scale_0", 3), ("rot", "rot_0", 4),
        ]
    ]  # fmt: skip
    found = read("point_cloud", [message])
    np.testing.assert_allclose(found.positions, splats.positions, atol=1e-6)
    np.testing.assert_allclose(found.orientations, splats.orientations, atol=1e-6)
    message.fields[1].count = 50
    with pytest.raises(InputError, match="point_step: 68 bytes, field f_dc of 50 numbers ends"):
        read("point_cloud", [message])


def test_what_pcl_leaves_in_a_cloud() -> None:
    splats = random_splats(50, 0)
    message = cloud(splats)
    message.height = 0
    message.fields = [
        *message.fields,
        PointField(name="_", offset=0, datatype=2, count=4),
        PointField(name="_", offset=8, datatype=2, count=4),
    ]
    np.testing.assert_array_equal(read("point_cloud", [message]).sh, splats.sh)
    message.fields = [*message.fields, PointField(name="x", offset=0, datatype=7, count=1)]
    with pytest.raises(InputError, match="fields: x is there twice"):
        read("point_cloud", [message])
    message = cloud(splats)
    message.fields = [PointField(name="q", offset=0, datatype=2, count=2**29)]
    message.point_step = 2**30
    with pytest.raises(InputError, match="fields: more than 4,096 numbers a point"):
        read("point_cloud", [message])


@pytest.mark.parametrize(("name", "datatype"), [("rgb", 7), ("rgb", 6), ("rgba", 6)])
@pytest.mark.parametrize("big_endian", [False, True])
def test_packed_colours_are_colours(name: str, datatype: int, big_endian: bool) -> None:
    splats = random_splats(50, 0)
    message = cloud(splats, big_endian=big_endian)
    place = {field.name: field for field in message.fields}
    rows = np.frombuffer(message.data, np.uint8).reshape(50, -1).copy()
    packed = np.arange(50, dtype=np.uint32) << 16 | 20 << 8 | 200
    begin = place["f_dc_0"].offset
    rows[:, begin : begin + 4] = (
        packed.astype(">u4" if big_endian else "<u4").view(np.uint8).reshape(50, 4)
    )
    message.data = rows.tobytes()
    message.fields = [field for field in message.fields if not field.name.startswith("f_dc")]
    message.fields.append(PointField(name=name, offset=begin, datatype=datatype, count=1))
    colours = (0.2820948 * read("point_cloud", [message]).sh[:, 0] + 0.5) * 255
    np.testing.assert_allclose(colours[:, 0], np.arange(50), atol=1e-3)
    np.testing.assert_allclose(colours[:, 1:], [[20, 200]] * 50, atol=1e-3)


def test_quaternions_by_letters_are_quaternions() -> None:
    splats = random_splats(50, 0)
    message = cloud(splats)
    for field in message.fields:
        if field.name.startswith("rot_"):
            field.name = "rot_" + "wxyz"[int(field.name[-1])]
    np.testing.assert_allclose(
        read("point_cloud", [message]).orientations, splats.orientations, atol=1e-6
    )


def test_a_cloud_that_is_no_map_is_named() -> None:
    message = cloud(random_splats(10, 0))
    message.fields = message.fields[:3]
    with pytest.raises(InputError, match=r"/point_cloud: .*no property opacity"):
        read("point_cloud", [message])
    for name, value, error in [
        ("width", 11, "data: "),
        ("point_step", 8, "point_step: 8 bytes, field z ends after 12"),
        ("point_step", 2**32 - 1, "point_step: 4294967295 bytes"),
        ("height", 3, "data: "),
        ("data", b"", "data: 0 bytes"),
    ]:
        message = cloud(random_splats(10, 0))
        setattr(message, name, value)
        with pytest.raises(InputError, match=f"/point_cloud: {error}"):
            read("point_cloud", [message])


# --- Messages that add up -------------------------------------------------------------------------


def test_arrays_add_up_until_one_refreshes() -> None:
    first, more = random_splats(9000, 1), random_splats(700, 2, seed=2)
    messages = written("gaussian_array", first)
    assert [message.refresh for message in messages] == [True, False, False]
    added = written("gaussian_array", more)
    added[0].refresh = False
    found = read("gaussian_array", messages + added)
    assert len(found) == 9700
    assert_alike(found[9000:], more, 0.003, 1e-5)
    assert len(read("gaussian_array", messages + written("gaussian_array", more))) == 700


def test_arrays_of_messages_as_they_were_until_may_2025(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fields x, y, z, w of a quaternion have the numbers of one whose w is first."""
    monkeypatch.setattr(gaussian_array, "message_class", lambda _: OlderGaussian)
    splats = random_splats(300, 1)
    messages = written("gaussian_array", splats)
    turn = messages[0].gaussians[5].rotation
    np.testing.assert_allclose((turn.y, turn.z, turn.w, turn.x), splats.orientations[5], atol=1e-6)
    assert_alike(read("gaussian_array", messages), splats, 1e-6, 1e-5)


def test_tiles_come_and_go_at_their_commit() -> None:
    reader = splat_tiles.Reader("/tiles", silent)
    splats = random_splats(3000, 0)
    messages = written("splat_tiles", splats)
    assert not any(reader.add(message) for message in messages[:-1])
    assert len(reader.splats()) == 0
    assert reader.add(messages[-1])
    assert len(reader.splats()) == 3000
    tile = messages[1]
    common = {"session_id": "b", "version": 7, "header": HEADER}
    where = {"tile_x": tile.tile_x, "tile_y": tile.tile_y, "tile_z": tile.tile_z}
    reader.add(SplatTileChunk(operation=SplatTileChunk.DELETE_TILE, **common, **where))
    assert len(reader.splats()) == 3000
    assert reader.add(SplatTileChunk(operation=SplatTileChunk.COMMIT, **common))
    assert len(reader.splats()) == 3000 - tile.splat_count
    assert not reader.add(SplatTileChunk(operation=SplatTileChunk.HEARTBEAT, **common))


def test_a_commit_without_all_chunks_changes_nothing() -> None:
    reader = splat_tiles.Reader("/tiles", silent)
    messages = written("splat_tiles", random_splats(300, 0))
    messages[1].chunk_count = 2
    with pytest.raises(InputError, match=r"/tiles: version 0 is committed, and tiles lack chunks"):
        for message in messages:
            reader.add(message)
    assert len(reader.splats()) == 0
    for message in written("splat_tiles", random_splats(300, 0)):
        reader.add(message)
    assert len(reader.splats()) == 300


def test_a_blob_of_several_chunks_comes_in_any_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(splat_blob, "CHUNK", 1000)
    splats = random_splats(200, 1)
    messages = written("splat_blob", splats)
    assert len(messages) > 10
    assert_alike(read("splat_blob", messages[::-1]), splats, 1e-6, 1e-5)
    moved = written("splat_blob", splats)
    for message in moved:
        message.map_from_source.translation.x = 5.0
        message.map_from_source.rotation.z = 2.0  # half a turn, of no unit length
        message.map_from_source.rotation.w = 0.0
    pose = np.diag([-1.0, -1.0, 1.0, 1.0])
    pose[0, 3] = 5
    assert_alike(read("splat_blob", moved), splats.moved(pose), 1e-6, 1e-5)


def test_what_never_becomes_whole_is_forgotten() -> None:
    reader = splat_blob.Reader("/blob", silent)
    for version in range(100):
        (message,) = written("splat_blob", random_splats(10, 0))
        message.version, message.chunk_count = version, 2
        reader.add(message)
    assert len(reader._chunks._coming) <= 4


def test_discs_have_no_third_scale() -> None:
    splats = random_splats(100, 0)
    (message,) = written("gaussian_splats", splats)
    message.type = GaussianSplats.TYPE_2DGS
    assert not read("gaussian_splats", [message]).scales[:, 2].any()
    message.scales = splats.scales[:, :2].ravel()
    found = read("gaussian_splats", [message])
    np.testing.assert_array_equal(found.scales[:, :2], splats.scales[:, :2])


@pytest.mark.parametrize("model", [Model.EWA, Model.EWA_ANTIALIASED, Model.DISC])
def test_a_model_stays_as_it_is(model: Model) -> None:
    splats = random_splats(10, 0)
    splats.scales[:, 2] = 0
    splats = replace(splats, model=model)
    assert read("gaussian_splats", written("gaussian_splats", splats)).model == model


@pytest.mark.parametrize(
    ("name", "change", "error"),
    [
        ("gaussian_array", {"gaussians.1.spherical_harmonics": [0.0] * 3}, r"gaussians\[1\]"),
        ("gaussian_array", {"gaussians.0.spherical_harmonics": [0.0] * 5}, "5 numbers, known are"),
        ("gaussian_splats", {"quats": [1.0]}, "quats: 1 numbers, expected 12 for 3 splats"),
        ("gaussian_splats", {"sh_rest": [1.0]}, "sh_rest: 1 numbers"),
        ("gaussian_splats", {"sh_degree": 9}, "sh_degree: 9, at most 3"),
        ("gaussian_splats", {"type": 7}, "type: 7 is neither"),
        ("splat_array", {"splats.1.spherical_harmonics": np.zeros(3)}, r"splats\[1\]"),
        ("splat_array", {"splats.0.harmonics_deg": 9}, "harmonics_deg: 9"),
        ("splat_blob", {"format": "gltf"}, "format: 'gltf'"),
        ("splat_blob", {"compression": "zstd"}, "compression: 'zstd'"),
        ("splat_blob", {"format": "a\n" + "x" * 5000}, r"format: 'a\\n.{90,120}, known are"),
        ("splat_blob", {"map_from_source.translation.x": np.inf}, "map_from_source: not finite"),
        ("splat_blob", {"map_from_source.rotation.w": np.nan}, "map_from_source: not finite"),
        ("splat_blob", {"data": b"ply\n"}, "uncompressed_size"),
        ("splat_blob", {"chunk_index": 1}, "chunk_index: 1"),
        ("splat_tiles", {"encoding": "mesh"}, "encoding: 'mesh'"),
        ("splat_tiles", {"data": b"abc", "uncompressed_size": 3}, "3 bytes are no rows of 32"),
        ("splat_tiles", {"operation": 9}, "operation: 9"),
    ],
)
def test_what_contradicts_itself_is_named(name: str, change: dict[str, Any], error: str) -> None:
    messages = written(name, random_splats(3, 1))
    for path, value in change.items():
        target: Any = messages[name == "splat_tiles"]  # whose first clears
        *way, last = path.split(".")
        for step in way:
            target = target[int(step)] if step.isdigit() else getattr(target, step)
        setattr(target, last, value)
    with pytest.raises(InputError, match=f"/{name}: .*{error}"):
        read(name, messages)


@pytest.mark.parametrize("name", foreign.TYPES)
def test_numbers_beyond_float_are_dropped_without_a_warning_of_numpy(name: str) -> None:
    splats = random_splats(8, 1)
    splats.scales[0] = 3e38
    splats.positions[1, 0] = np.inf
    splats.orientations[2] = 3e38
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        messages = written(name, splats)
    told: list[str] = []
    reader = foreign.foreign(name).Reader(f"/{name}", told.append)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for message in messages:
            reader.add(message)
        found = reader.splats()
    assert 0 < len(found) < 8
    assert np.isfinite(found.positions).all()
    assert np.isfinite(found.scales).all()


def test_the_parts_of_a_growing_map_are_kept_once() -> None:
    reader = gaussian_array.Reader("/gaussian_model", silent)
    parts = [random_splats(50, 0, seed=seed) for seed in range(4)]
    for part in parts:
        for message in written("gaussian_array", part):
            message.refresh = False
            reader.add(message)
        reader.splats()
    assert len(reader._parts) == 1
    assert_alike(reader.splats(), concatenate(parts), 0.003, 1e-5)


def test_another_low_pass_filter_is_said() -> None:
    (message,) = written("gaussian_splats", random_splats(3, 0))
    message.eps2d = 0.1
    said: list[str] = []
    gaussian_splats.Reader("/gaussian_splats", said.append).add(message)
    assert said == ["/gaussian_splats: eps2d: 0.1 px^2, drawn with the usual 0.3"]


def test_a_point_cloud_is_what_share_sends() -> None:
    (message,) = written("point_cloud", random_splats(20, 1))
    assert message.row_step == message.point_step * message.width == len(message.data)
    assert point_cloud.TYPE == "sensor_msgs/msg/PointCloud2"
