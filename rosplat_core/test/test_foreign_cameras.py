"""Camera files of INRIA, nerfstudio, Blender and COLMAP give the same cameras as our own."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from rosplat_core.cameras import Camera, load_cameras, look_at
from rosplat_core.quaternions import from_matrices
from rosplat_core.splats import InputError

CAMERAS = [
    Camera(i, 640, 480, 500.0, 510.0, 320.0, 240.0, look_at((3, i, 2), (0, 0, 0))) for i in range(3)
]


def assert_cameras(found: list[Camera], cx: float = 320.0, cy: float = 240.0) -> None:
    assert len(found) == len(CAMERAS)
    for one, other in zip(found, CAMERAS, strict=True):
        np.testing.assert_allclose(one.world_to_camera, other.world_to_camera, atol=1e-9)
        assert (one.width, one.height, one.fx, one.fy) == (640, 480, 500.0, 510.0)
        assert (one.cx, one.cy) == (cx, cy)


def write(path: Path, document: object) -> Path:
    path.write_text(json.dumps(document))
    return path


def opengl(camera: Camera) -> np.ndarray:
    return camera.camera_to_world @ np.diag([1, -1, -1, 1])


def transforms(**more: object) -> dict[str, object]:
    frames = [{"transform_matrix": opengl(camera).tolist()} for camera in CAMERAS]
    intrinsics = {"w": 640, "h": 480, "fl_x": 500.0, "fl_y": 510.0, "cx": 321.5, "cy": 239.0}
    return {**intrinsics, "frames": frames, **more}


def test_inria(tmp_path: Path) -> None:
    document = [
        {
            "id": camera.id, "img_name": "7.png", "width": 640, "height": 480,
            "position": camera.position.tolist(),
            "rotation": camera.camera_to_world[:3, :3].tolist(), "fx": 500.0, "fy": 510.0,
        }
        for camera in CAMERAS
    ]  # fmt: skip
    assert_cameras(load_cameras(write(tmp_path / "cameras.json", document)))
    del document[1]["fx"]
    with pytest.raises(InputError, match=r"cameras\.json: camera 1: .*fx"):
        load_cameras(write(tmp_path / "cameras.json", document))


def test_nerfstudio(tmp_path: Path) -> None:
    told: list[str] = []
    path = write(tmp_path / "transforms.json", transforms(k1=0.1, p2=0.0))
    assert_cameras(load_cameras(path, told.append), 321.5, 239.0)
    assert told == [f"{path}: lens distortion k1 left out: cameras are drawn without it"]


def test_cameras_that_see_all_around_are_named(tmp_path: Path) -> None:
    path = write(tmp_path / "transforms.json", transforms(camera_model="ORTHOPHOTO"))
    with pytest.raises(InputError, match="ORTHOPHOTO has no pinhole"):
        load_cameras(path)
    told: list[str] = []
    write(path, transforms(camera_model="OPENCV_FISHEYE"))
    assert_cameras(load_cameras(path, told.append), 321.5, 239.0)
    assert "OPENCV_FISHEYE left out" in told[0]


def test_nerfstudio_s_exported_maps(tmp_path: Path) -> None:
    """Poses of the file are applied COLMAP's; an exported map is turned and scaled again."""
    applied = np.eye(4)
    applied[:3] = [[0, 1, 0, 1], [1, 0, 0, 2], [0, 0, -1, 3]]
    turned = np.linalg.inv(look_at((1, 2, 3), (0, 0, 0)))
    frames = []
    for camera in CAMERAS:
        pose = opengl(camera)
        pose[:3, 3] /= 0.25  # 0.5 by the parser, over 2 that was applied
        frames.append({"transform_matrix": (np.linalg.inv(turned) @ pose).tolist()})
    document = transforms(applied_transform=applied[:3].tolist(), applied_scale=2.0, frames=frames)
    parsed = {"transform": (turned @ applied)[:3].tolist(), "scale": 0.5}
    write(tmp_path / "dataparser_transforms.json", parsed)
    told: list[str] = []
    path = write(tmp_path / "transforms.json", document)
    assert_cameras(load_cameras(path, told.append), 321.5, 239.0)
    assert "moved by dataparser_transforms.json" in told[0]


def test_blender(tmp_path: Path) -> None:
    (tmp_path / "train").mkdir()
    Image.new("RGB", (640, 480)).save(tmp_path / "train/r_0.png")
    angles = {
        "camera_angle_x": 2 * np.arctan(320 / 500), "camera_angle_y": 2 * np.arctan(240 / 510)
    }  # fmt: skip
    frames = [{"file_path": "./train/r_0", "transform_matrix": opengl(c).tolist()} for c in CAMERAS]
    path = write(tmp_path / "transforms_train.json", {**angles, "frames": frames})
    found = load_cameras(path)
    assert found[0].fx == pytest.approx(500)
    assert found[0].fy == pytest.approx(510)
    assert (found[0].width, found[0].height, found[0].cx) == (640, 480, 320)
    assert found[0].image == "./train/r_0.png"
    frames[1]["file_path"] = "./train/r_1"
    write(path, {**angles, "frames": frames})
    with pytest.raises(InputError, match=r"camera 1: .*no w, h"):
        load_cameras(path)


def quaternion(camera: Camera) -> list[float]:
    x, y, z, w = from_matrices(camera.world_to_camera[:3, :3]).tolist()
    return [w, x, y, z]


@pytest.mark.parametrize("wrong", [{"camera_angle_x": 0}, {"w": 1e308, "camera_angle_x": 1e-9}])
def test_numbers_that_no_camera_has_name_it(tmp_path: Path, wrong: dict[str, float]) -> None:
    path = tmp_path / "transforms.json"
    frame = {"transform_matrix": np.eye(4).tolist(), "w": 64, "h": 48, **wrong}
    path.write_text(json.dumps({"frames": [frame]}))
    with pytest.raises(InputError, match=r"transforms\.json: camera 0: "):
        load_cameras(path)


def test_colmap_in_text(tmp_path: Path) -> None:
    (tmp_path / "sparse/0").mkdir(parents=True)
    model = tmp_path / "sparse/0"
    (model / "cameras.txt").write_text("# lenses\n4 OPENCV 640 480 500 510 320 240 0 0 0.1 0\n")
    lines = ["# pictures"]
    for camera in reversed(CAMERAS):  # out of order, as COLMAP has them
        pose = [*quaternion(camera), *camera.world_to_camera[:3, 3].tolist()]
        lines += [f"{camera.id} {' '.join(map(repr, pose))} 4 {camera.id}.png", ""]
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    told: list[str] = []
    for path in (tmp_path, model, model / "images.txt"):
        assert_cameras(load_cameras(path, told.append))
    assert "lens distortion OPENCV left out" in told[0]


def test_colmap_in_binary(tmp_path: Path) -> None:
    lens = struct.pack("<QiiQQ4d", 1, 4, 1, 640, 480, 500, 510, 320, 240)
    (tmp_path / "cameras.bin").write_bytes(lens)
    images = struct.pack("<Q", len(CAMERAS))
    for camera in CAMERAS:
        pose = [*quaternion(camera), *camera.world_to_camera[:3, 3].tolist()]
        images += struct.pack("<i7di", camera.id, *pose, 4) + f"{camera.id}.png\0".encode()
        images += struct.pack("<Q", 2) + bytes(48)
    (tmp_path / "images.bin").write_bytes(images)
    assert_cameras(load_cameras(tmp_path / "images.bin"))
    (tmp_path / "images.bin").write_bytes(images[:100])
    with pytest.raises(InputError, match=r"a model of COLMAP: .*cut short"):
        load_cameras(tmp_path)


def colmap(folder: Path, lens: str, lines: list[str]) -> Path:
    """A model in text."""
    (folder / "cameras.txt").write_text(f"1 {lens}\n")
    (folder / "images.txt").write_text("\n".join(lines))
    return folder


def test_colmap_s_pictures_without_lines_of_points(tmp_path: Path) -> None:
    lines = []
    for camera in CAMERAS:
        pose = [*quaternion(camera), *camera.world_to_camera[:3, 3].tolist()]
        lines.append(f"{camera.id} {' '.join(map(repr, pose))} 1 {camera.id}.png")
    lines.insert(1, "12.5 7.25 -1 1.5 2.5 3")
    assert_cameras(load_cameras(colmap(tmp_path, "PINHOLE 640 480 500 510 320 240", lines)))


@pytest.mark.parametrize("lens", ["OPENCV_FISHEYE 9 9 5 5 4 4 0 0 0 0", "SIMPLE_FISHEYE 9 9 5 4 4"])
def test_fisheyes_of_colmap_are_bent_without_coefficients(tmp_path: Path, lens: str) -> None:
    told: list[str] = []
    load_cameras(colmap(tmp_path, lens, ["1 1 0 0 0 0 0 0 1 a.png"]), told.append)
    assert "FISHEYE left out" in told[0]


@pytest.mark.parametrize(
    ("lens", "said"),
    [
        ("EQUIRECTANGULAR 9 9 9 9", "equirectangular has no pinhole picture"),
        ("LOOKING_GLASS 9 9 1", "LOOKING_GLASS of 1"),
    ],
)
def test_colmap_s_cameras_that_are_none_here_are_named(
    tmp_path: Path, lens: str, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        load_cameras(colmap(tmp_path, lens, ["1 1 0 0 0 0 0 0 1 a.png"]))


def test_panoramas_of_nerfstudio_and_colmap_are_all_around(tmp_path: Path) -> None:
    document = transforms(camera_model="EQUIRECTANGULAR")
    lines = []
    for camera in CAMERAS:
        pose = [*quaternion(camera), *camera.world_to_camera[:3, 3].tolist()]
        lines += [f"{camera.id} {' '.join(map(repr, pose))} 1 a.png", ""]
    (tmp_path / "colmap").mkdir()
    for path in (
        write(tmp_path / "transforms.json", document),
        colmap(tmp_path / "colmap", "EQUIRECTANGULAR 640 480 640 480", lines),
    ):
        for one, other in zip(load_cameras(path, panoramas=True), CAMERAS, strict=True):
            np.testing.assert_allclose(one.world_to_camera, other.world_to_camera, atol=1e-9)
            assert (one.model, one.width, one.height) == ("equirectangular", 640, 480)
            assert (one.fx * 2 * np.pi, one.fy * np.pi) == pytest.approx((640, 480))
            assert (one.cx, one.cy) == (320, 240)


def test_colmap_s_newer_lenses_by_number(tmp_path: Path) -> None:
    image = struct.pack("<Qi7di", 1, 7, 1, 0, 0, 0, 0, 0, 0, 1) + b"a.png\0" + bytes(8)
    (tmp_path / "images.bin").write_bytes(image)
    lens = struct.pack("<QiiQQ3d", 1, 1, 14, 640, 480, 500, 320, 240)
    (tmp_path / "cameras.bin").write_bytes(lens)
    told: list[str] = []
    assert load_cameras(tmp_path, told.append)[0].fx == 500
    assert "SIMPLE_FISHEYE left out" in told[0]
    (tmp_path / "cameras.bin").write_bytes(lens[:12] + struct.pack("<i", 99) + lens[16:])
    with pytest.raises(InputError, match="camera model 99 isn't known"):
        load_cameras(tmp_path)


def test_a_byte_order_mark_and_sizes_as_floats(tmp_path: Path) -> None:
    entry = {
        "position": [1, 2, 3], "rotation": np.eye(3).tolist(), "width": 640.0, "height": 480.0,
        "fx": 500, "fy": 500,
    }  # fmt: skip
    path = tmp_path / "cameras.json"
    path.write_text("\ufeff" + json.dumps([entry]), encoding="utf-8")
    assert load_cameras(path)[0].width == 640


@pytest.mark.parametrize("more", [{"camera_model": "opencv_fisheye"}, {"is_fisheye": True}])
def test_fisheyes_by_any_name(tmp_path: Path, more: dict[str, object]) -> None:
    told: list[str] = []
    load_cameras(write(tmp_path / "transforms.json", transforms(**more)), told.append)
    assert "FISHEYE left out" in told[0]


def test_matrices_as_lists_of_numbers(tmp_path: Path) -> None:
    frames = [{"transform_matrix": opengl(camera).ravel().tolist()} for camera in CAMERAS]
    path = write(tmp_path / "transforms.json", transforms(frames=frames))
    assert_cameras(load_cameras(path), 321.5, 239.0)


def test_what_a_camera_lacks_is_named(tmp_path: Path) -> None:
    document = transforms()
    del document["fl_x"]
    with pytest.raises(InputError, match=r"camera 0: .*neither fl_x nor camera_angle_x"):
        load_cameras(write(tmp_path / "transforms.json", document))
    write(tmp_path / "transforms.json", transforms(frames=[{}]))
    with pytest.raises(InputError, match="camera 0: it has no 'transform_matrix'"):
        load_cameras(tmp_path / "transforms.json")
    model = colmap(tmp_path, "PINHOLE 9 9 5 5 4 4", ["1 1 0 0 0 0 0 0 7 a.png"])
    with pytest.raises(InputError, match=r"picture a\.png: .*no camera 7"):
        load_cameras(model)


def test_a_pointer_in_place_of_cameras_is_named(tmp_path: Path) -> None:
    (tmp_path / "cameras.json").write_text("version https://git-lfs.github.com/spec/v1\n")
    with pytest.raises(InputError, match=r"cameras\.json: a pointer of Git LFS"):
        load_cameras(tmp_path / "cameras.json")
