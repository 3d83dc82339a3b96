"""Messages and files as no honest peer sends them: valid ones, damaged by what their fields are.

Seed and number of a case give the same again. A field that a message gets is damaged by its type
without a word here; what makes it valid is a line in `_batch`, `order` or `view_camera`.
"""

from __future__ import annotations

import base64
import gzip
import io
import json
import os
import struct
import zipfile
from array import array
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from core_fixtures import random_splats
from geometry_msgs.msg import Point, Pose, Quaternion
from ksplat_file import ksplat
from numpy.random import Generator
from streamed_scene import write_scene

from rosplat_core import _core, formats, payload
from rosplat_msgs.msg import GaussianArray, SplatOrder, ViewCamera
from rosplat_sorter.order_slots import PACKED, SHARED, SLOTS, pack
from rosplat_sorter.shared_orders import OrderBuffer
from rosplat_testing.messages import arrays_of, is_usable

CASES = int(os.environ.get("ROSPLAT_FUZZ_CASES") or 2000)
SEED = int(os.environ.get("ROSPLAT_FUZZ_SEED") or 0)
CASE = os.environ.get("ROSPLAT_FUZZ_CASE")

MOST = GaussianArray.MAX_SLOTS
WHOLE = (
    0, 1, 2, 3, 255, 1023, 1024, 1025, 1 << 16, MOST - 1, MOST, 1 << 31, (1 << 32) - 1, 1 << 63,
)  # fmt: skip
DOUBLES = (
    np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, 1e-100, 1e-45, 1e-7, 1.0, -1.0, 1.0 + 1e-15,
    1e9, 1e30, 3.5e38, 1e100, -1e100, 1e308,
)  # fmt: skip
FLOATS = (np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, -1e-45, 1e-20, -1.0, 1e20, -3.4e38, 3.4e38)
TEXTS = ("", "other", "a\n\x1b[31m" * 20, "x" * 5000, "../../etc/passwd", "\N{SNOWMAN}")
CHANNELS = [f"channel{i}" for i in range(10)]  # two more than a map has
# Sorters see an empty slot where an opacity is below 1/255.
SOLID = {"opacities": (np.nan, np.inf, -np.inf, 7.0, 3.4e38)}


def cases(count: int) -> Iterator[int]:
    """Numbers of cases to run: all, or the one that is asked for."""
    yield from [int(CASE)] if CASE else range(count)


def random(case: int) -> Generator:
    """What a case is made of."""
    return np.random.default_rng([SEED, case])


def one_of(rng: Generator, values: Sequence[Any]) -> Any:
    return values[int(rng.integers(len(values)))]


# --- Messages -------------------------------------------------------------------------------------


def batches(rng: Generator) -> list[GaussianArray]:
    """Some batches of one map, half of them with one or two things wrong."""
    model = int(rng.integers(4))
    made = []
    for revision in range(1, int(rng.integers(2, 6))):
        message = _batch(rng, revision)
        message.model = model
        for _ in range(one_of(rng, [0, 0, 1, 2])):
            damage(rng, message)
        made.append(message)
    return made


def _batch(rng: Generator, revision: int) -> GaussianArray:
    message = GaussianArray(map_id="map", revision=revision, sh_degree=int(rng.integers(4)))
    message.header.frame_id = "map"
    message.operation = one_of(rng, [0, 1, 1, 2, 3] if revision > 1 else [0, 0, 1, 2])
    if message.operation == GaussianArray.MOVE:
        message.groups = array(
            "I", rng.permutation(8)[: rng.integers(8)].astype(np.uint32).tobytes()
        )
        message.poses = [_pose(rng) for _ in message.groups]
        return message
    message.group = one_of(rng, [0, 0, 0, 1, 7])
    message.count = n = one_of(rng, [0, 1, 2, 7, 100])
    if rng.integers(50) == 0:  # a page for each
        message.slots = array("I", rng.integers(MOST, size=n).astype(np.uint32).tobytes())
    elif rng.integers(2):
        slots = [one_of(rng, WHOLE[:10]) + int(rng.integers(3)) for _ in range(n)]
        message.slots = array("I", [min(slot, MOST - 1) for slot in slots])
    else:
        message.first_slot = min(one_of(rng, WHOLE[:10]), MOST - n)
    if message.operation == GaussianArray.DELETE:
        if not len(message.slots) and rng.integers(2):
            message.count = MOST - message.first_slot
        return message
    message.positions = array("f", rng.normal(size=3 * n) * 5)
    message.orientations = array("f", rng.normal(size=4 * n))
    message.scales = array("f", np.exp(rng.uniform(-7, 1, 3 * n)))
    message.opacities = array("f", rng.uniform(0.1, 1, n))
    message.sh = array("f", rng.normal(size=3 * (message.sh_degree + 1) ** 2 * n))
    names = list(rng.choice(CHANNELS, one_of(rng, [0, 0, 1, 3]), replace=False))
    message.channel_names = [str(name) for name in names]
    message.channels = array("f", rng.normal(size=len(names) * n))
    if not rng.integers(4):
        _compress(message, one_of(rng, [payload.QUANTISED, payload.PACKED]))
    return message


def _pose(rng: Generator) -> Pose:
    (x, y, z), (qx, qy, qz, qw) = rng.normal(size=3).tolist(), rng.normal(size=4).tolist()
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def _compress(message: GaussianArray, format: str) -> None:
    arrays = arrays_of(message)
    pack = _core.pack_splats if format == payload.PACKED else payload.encode
    message.payload = array("B", pack(arrays, is_usable(arrays)).tobytes())
    message.format = format
    for name in ("positions", "orientations", "scales", "opacities", "sh"):
        setattr(message, name, array("f"))


def view_camera(rng: Generator) -> ViewCamera:
    """A camera near the map, mostly with some numbers that make no picture."""
    message = ViewCamera(
        view_id="view", sequence=1, projection=int(rng.integers(3)), width=64, height=48,
        fx=60.0, fy=60.0, cx=32.0, cy=24.0, near_clip=0.1, far_clip=100.0,
    )  # fmt: skip
    message.pose.position.z = -20.0
    for _ in range(int(rng.integers(4))):
        damage(rng, message)
    return message


def order(rng: Generator, most: int, shared: OrderBuffer) -> SplatOrder:
    """An order of some slots below `most`, whichever way it travels, half of them damaged."""
    slots = rng.permutation(min(most, 1000))[: int(rng.integers(1001))].astype(np.uint32)
    message = SplatOrder(
        view_id="view", sequence=1, map_id="map", revision=1, backend="native", count=len(slots),
        encoding=one_of(rng, [SLOTS, PACKED, SHARED]),
    )  # fmt: skip
    if message.encoding == SLOTS:
        message.slots = array("I", slots.tobytes())
    elif message.encoding == PACKED:
        message.slot_bits = int(rng.integers(10, 33))
        message.packed = pack(slots, message.slot_bits)
    else:
        shared.begin(len(slots))[:] = slots
        message.segment, message.generation = shared.finish()
    for _ in range(one_of(rng, [0, 0, 1, 2])):
        damage(rng, message)
    return message


def damage(rng: Generator, message: Any) -> None:
    """Says something else in one of a message's fields, or in one of a field's own."""
    types = message.get_fields_and_field_types()
    field = one_of(rng, list(types))
    value = getattr(message, field)
    if hasattr(value, "get_fields_and_field_types"):
        damage(rng, value)
    elif types[field] == "sequence<string>":
        setattr(message, field, _damaged_names(rng, value))
    elif isinstance(value, list):  # of messages
        if value and rng.integers(4):
            damage(rng, one_of(rng, value))
        else:
            del value[int(rng.integers(len(value) + 1)) :]
    elif isinstance(value, array):
        setattr(message, field, _damaged_array(rng, field, value))
    else:
        setattr(message, field, one_of(rng, _values(types[field])))


def _damaged_names(rng: Generator, names: list[str]) -> list[str]:
    """One says something else, is gone or there twice, or they are many."""
    place = int(rng.integers(len(names) + 1))
    text = one_of(rng, [*TEXTS, *names])
    return [*names[:place], *one_of(rng, [[], [text], [text] * 1000]), *names[place + 1 :]]


def _values(kind: str) -> Sequence[Any]:
    """What a field of a type in ROS's interface language may be made to say."""
    others = {"boolean": (False, True), "string": TEXTS, "float": FLOATS, "double": DOUBLES}
    if kind in others:
        return others[kind]
    return [value for value in WHOLE if value <= np.iinfo(kind).max]


def _damaged_array(rng: Generator, field: str, values: array[Any]) -> array[Any]:
    if rng.integers(4) == 0 or not len(values):
        zeros = array(values.typecode, [0] * (len(values) + 2))
        return (values + zeros)[: int(rng.integers(0, len(values) + 3))]
    kind = {"f": "float", "d": "double", "I": "uint32", "B": "uint8"}[values.typecode]
    values[int(rng.integers(len(values)))] = one_of(rng, SOLID.get(field) or _values(kind))
    return values


# --- Files ----------------------------------------------------------------------------------------

Scene = dict[str, bytes]
"""A scene's files by name; the first is the one that is opened."""

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
JSON_VALUES: list[Any] = [
    None, True, -1, 0, 1, 2**25, 2**31, 2**63, 10**30, 1.5, float("nan"), float("inf"), 1e308, "",
    "x", "meta.json", "../a", "\0", "a" * 5000, [], [0], [[]], [1e308] * 256, {}, {"files": []},
]  # fmt: skip
WORDS = [b"0", b"-1", b"1e9", b"99999999999999999999", b"4294967295", b"x\ny", b"list uchar"]


def scenes(folder: Path) -> list[Scene]:
    """A small scene in each format that is read, and in each of its variants."""
    folder.mkdir()
    made: list[Scene] = []
    splats = random_splats(40, 1)
    for module in formats.FORMATS:
        if hasattr(module, "write") and module is not formats.usd:
            (suffix,) = module.SUFFIXES
            path = folder / f"scene{suffix}"
            formats.save(path, splats)
            made.append({path.name: path.read_bytes()})
    made.append({"text.ply": _as_text(folder / "scene.ply")})
    made += _as_gltf((folder / "scene.glb").read_bytes())
    near = splats[:]
    near.positions[:] = np.clip(near.positions, -2.4, 2.4)
    made += [{"s.ksplat": ksplat([near[:25], near[25:]], level)} for level in range(3)]
    for version, width in ((1, 19), (2, 22), (3, 23)):
        header = struct.pack("<4sIIBBBB", b"NGSP", version, 40, 1, 12, 0, 0)
        body = np.random.default_rng(version).bytes(40 * (width + 9))
        made.append({"s.spz": gzip.compress(header + body)})
    params = io.BytesIO()
    np.savez(
        params, means3D=splats.positions, rgb_colors=splats.sh[:, 0],
        unnorm_rotations=splats.orientations, logit_opacities=splats.opacities[:, None],
        log_scales=np.log(splats.scales),
    )  # fmt: skip
    made.append({"params.npz": params.getvalue()})
    streamed = write_scene(folder / "streamed", chunks=2, environment=True, levels=(40, 10))
    made.append(
        {streamed.name: streamed.read_bytes()}
        | {
            str(path.relative_to(streamed.parent)): path.read_bytes()
            for path in sorted(streamed.parent.glob("*/*"))
        }
    )
    return made


def camera_files() -> list[Scene]:
    """A small file of cameras of each kind that is read."""
    pose = np.eye(4).tolist()
    size, lens = {"width": 64, "height": 48}, {"fx": 50.0, "fy": 50.0}
    ours = {"id": 1, **size, **lens, "cx": 32.0, "cy": 24.0, "world_to_camera": pose, "near": 0.1}
    inria = {"id": 1, **size, **lens, "position": [0, 0, 1.0], "rotation": np.eye(3).tolist()}
    frame = {"file_path": "a.png", "transform_matrix": pose}
    nerf = {"fl_x": 50.0, "fl_y": 50.0, "w": 64, "h": 48, "k1": 0.1, "camera_model": "OPENCV"}
    nerf |= {"applied_transform": pose[:3], "applied_scale": 1.0, "frames": [frame, frame]}
    blender = {"camera_angle_x": 0.7, "frames": [frame | {"w": 64, "h": 48}]}
    parsed = {"transform": pose[:3], "scale": 0.5}
    lenses = struct.pack("<QiiQQ4d", 1, 1, 1, 64, 48, 50, 50, 32, 24)
    image = struct.pack("<i7di6sQ24x", 1, 1, 0, 0, 0, 0, 0, 1, 1, b"a.png", 1)
    transforms, beside = json.dumps(nerf).encode(), json.dumps(parsed).encode()
    return [
        {"cameras.json": json.dumps([ours, ours]).encode()},
        {"cameras.json": json.dumps([inria, inria]).encode()},
        {"transforms.json": transforms},
        {"transforms.json": transforms, "dataparser_transforms.json": beside},
        {"transforms.json": json.dumps(blender).encode()},
        {"cameras.txt": b"1 PINHOLE 64 48 50 50 32 24\n", "images.txt": b"1 1 0 0 0 0 0 1 1 a\n\n"},
        {"cameras.bin": lenses, "images.bin": struct.pack("<Q", 1) + image},
    ]


def lens_files() -> list[Scene]:
    """A small calibration of each kind."""
    f_theta = {
        "resolution": [96, 54], "principal_point": [47.9, 27.4], "max_angle": 1.35,
        "reference_poly": "ANGLE_TO_PIXELDIST", "linear_cde": [0.99975, 6e-5, -1e-4],
        "angle_to_pixeldist_poly": [0, 47, -0.95, 2.5, -4.2, 1.5],
        "pixeldist_to_angle_poly": [0, 0.021, 1e-5, -8e-7, 2.5e-8, -1.8e-10],
    }  # fmt: skip
    back = f_theta | {"reference_poly": "PIXELDIST_TO_ANGLE"}
    bent = (
        b"image_width: 64\nimage_height: 48\ndistortion_model: plumb_bob\n"
        b"camera_matrix: { data: [ 43, 0, 30, 0, 43, 22, 0, 0, 1 ] }\n"
        b"distortion_coefficients: { data: [ -0.34, 0.12, 0.0008, -0.0003, 0 ] }\n"
        b"projection_matrix: { data: [ 40, 0, 31, 0, 0, 40, 22, 0, 0, 0, 1, 0 ] }\n"
    )
    round_ = bent.replace(b"plumb_bob", b"equidistant").replace(b", 0 ] }", b" ] }", 1)
    files = [{"lens.json": json.dumps(each).encode()} for each in (f_theta, back)]
    return [*files, {"lens.yaml": bent}, {"lens.yaml": round_}]


def usd_scenes(folder: Path) -> list[Scene]:
    """A small scene of each kind of OpenUSD's, which usd-core writes."""
    folder.mkdir()
    made = []
    for suffix in formats.usd.SUFFIXES:
        path = folder / f"scene{suffix}"
        formats.save(path, random_splats(40, 1))
        made.append({path.name: path.read_bytes()})
    return made


def _as_gltf(data: bytes) -> list[Scene]:
    """A .glb as text, with its buffer inside it and beside it."""
    asset, buffer = _glb(data)
    told = json.loads(asset)
    told["nodes"] = [{"children": [1], "rotation": [0, 0.6, 0, 0.8]}, told["nodes"][0]]
    uris = [f"data:;base64,{base64.b64encode(buffer).decode()}", "buffer.bin"]
    texts = []
    for uri in uris:
        told["buffers"][0]["uri"] = uri
        texts.append(json.dumps(told).encode())
    return [{"a.gltf": texts[0]}, {"b.gltf": texts[1], "buffer.bin": buffer}]


def _glb(data: bytes) -> tuple[bytes, bytes]:
    """The JSON and the buffer of a .glb."""
    end = 20 + int.from_bytes(data[12:16], "little")
    return data[20:end], data[end + 8 :]


def _as_text(path: Path) -> bytes:
    from plyfile import PlyData

    ply = PlyData.read(path)
    ply.text = True
    out = io.BytesIO()
    ply.write(out)
    return out.getvalue()


def damaged(rng: Generator, data: bytes) -> bytes:
    """Data that lost something or says something else, down to what it is packed of."""
    inside: Callable[[Generator, bytes], bytes] | None = None
    if data[:2] == b"\x1f\x8b":
        inside = _damaged_gzip
    elif data[:4] == b"PK\x03\x04":
        inside = _damaged_zip
    elif data[:1] in (b"{", b"["):
        inside = _damaged_text_of_json
    elif data[:4] == b"glTF":
        inside = _damaged_glb
    elif data[:4] == b"ply\n":
        inside = _damaged_header
    elif data.isascii() and b"\0" not in data:
        inside = _damaged_words
    if inside and rng.integers(4):
        return inside(rng, data)
    return _damaged_bytes(rng, data)


def _damaged_bytes(rng: Generator, data: bytes) -> bytes:
    """One change or a few, half of them near the beginning."""
    out = bytearray(data)
    for _ in range(one_of(rng, (1, 1, 1, 3, 20))):
        place = int(rng.integers(min(len(out), one_of(rng, (64, 1 << 30))) or 1))
        kind = rng.integers(5)
        if kind == 0 and out:
            out[place] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            number = one_of(rng, NUMBERS)
            out[place : place + len(number)] = number
        elif kind == 2:
            del out[place : place + one_of(rng, (1, 4, 100, len(out)))]
        elif kind == 3:
            out[place:place] = rng.bytes(one_of(rng, (1, 4, 100)))
        else:
            out[place : place + one_of(rng, (4, 100))] = out[:4]
    return bytes(out)


def _damaged_gzip(rng: Generator, data: bytes) -> bytes:
    return gzip.compress(damaged(rng, gzip.decompress(data)), 1)


def _damaged_zip(rng: Generator, data: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as whole, zipfile.ZipFile(out, "w") as bundle:
        names = whole.namelist()
        told = [name for name in names if name.endswith(".json")]
        victim = one_of(rng, told if told and rng.integers(2) else names)
        for name in names:
            content = whole.read(name)
            bundle.writestr(name, damaged(rng, content) if name == victim else content)
    return out.getvalue()


def _damaged_glb(rng: Generator, data: bytes) -> bytes:
    text, buffer = _glb(data)
    text = _damaged_text_of_json(rng, text)
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + len(buffer), len(text), b"JSON")
    return head + text + struct.pack("<I4s", len(buffer), b"BIN\0") + buffer


def _damaged_header(rng: Generator, data: bytes) -> bytes:
    """A PLY of which a word of the header is another one of it, or a number."""
    header, end, rows = data.partition(b"end_header\n")
    words = header.split(b" ")
    words[int(rng.integers(len(words)))] = one_of(rng, [*words, *WORDS])
    return b" ".join(words) + end + rows


def _damaged_words(rng: Generator, data: bytes) -> bytes:
    """Text of which a word is another one of it, or a number."""
    words = data.split(b" ")
    words[int(rng.integers(len(words)))] = one_of(rng, [*words, *WORDS, b"nan", b"1e308"])
    return b" ".join(words)


def _damaged_text_of_json(rng: Generator, data: bytes) -> bytes:
    return json.dumps(_damaged_json(rng, json.loads(data))).encode()


def _damaged_json(rng: Generator, value: Any) -> Any:
    """The value with one of its parts replaced or missing."""
    if not value or not isinstance(value, dict | list) or rng.random() < 0.1:
        return one_of(rng, JSON_VALUES)
    key = one_of(rng, list(value) if isinstance(value, dict) else range(len(value)))
    if rng.random() < 0.15:
        del value[key]
    else:
        value[key] = _damaged_json(rng, value[key])
    return value
