"""Camera files of trainers, as entries of our own files (cameras.py).

INRIA's cameras.json: a list with `position` and `rotation` of each camera in the world, x right, y
down, z forward; the principal point is the middle of the picture.

transforms.json of nerfstudio, instant-ngp and Blender: `frames`, each with a `transform_matrix`
from the camera, x right, y up, z back, to the world; `fl_x fl_y cx cy w h` for all or for each, or
`camera_angle_x` and pictures that tell their size. Where nerfstudio's dataparser_transforms.json
lies beside it, cameras are where its exported maps have them: turned, centred, scaled.

COLMAP's model: a folder with cameras and images, .bin or .txt, from the world to the camera.

All have the centre of the first pixel at (0.5, 0.5), as we do. Lens distortion is left out. An
EQUIRECTANGULAR picture is all around, whatever its parameters.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from rosplat_core.formats.bounds import refusing
from rosplat_core.log_text import shown
from rosplat_core.quaternions import to_matrices
from rosplat_core.splats import InputError

Entry = dict[str, Any]
Warn = Callable[[str], object]

PARSED = "dataparser_transforms.json"
DISTORTION = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
# Beginnings of models' names
NO_PINHOLE = ("OMNIDIRECTIONAL", "VR180", "ORTHO")
PANORAMA = "EQUIRECTANGULAR"
FISHEYE = "FISHEYE"  # in a model's name: bent without coefficients, too
FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
# What nerfstudio did to COLMAP's coordinates before transforms.json had a field for it.
APPLIED = [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]]
# COLMAP's models by number: their name, and how many parameters they have.
MODELS = (
    ("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8), ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12), ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4), ("DIVISION", 5), ("SIMPLE_FISHEYE", 3), ("FISHEYE", 4), ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
)  # fmt: skip
PLACES = (".", "sparse/0", "sparse", "colmap/sparse/0")  # of a model in a folder of pictures


def entries(document: Any, path: Path, warn: Warn) -> Any:
    """The entries of a JSON document; one of an unknown kind is returned as it is.

    Raises InputError that names the file, the camera and the field.
    """
    if isinstance(document, dict) and "frames" in document:
        return _transforms(document, path, warn)
    if isinstance(document, list) and document and all(map(_is_inria, document)):
        return [_inria(entry, path, index) for index, entry in enumerate(document)]
    return document


def colmap(path: Path, warn: Warn) -> list[Entry] | None:
    """The entries of a model in a folder, or beside one of its files; None where there is none."""
    folder = path if path.is_dir() else path.parent
    if path.is_file() and path.stem not in ("cameras", "images"):
        return None
    for place in PLACES if path.is_dir() else (".",):
        for ending, lenses, images in (
            (".bin", _binary_lenses, _binary_images), (".txt", _text_lenses, _text_images),
        ):  # fmt: skip
            files = [folder / place / f"{name}{ending}" for name in ("cameras", "images")]
            if all(file.is_file() for file in files):
                with refusing(f"{folder / place}: a model of COLMAP"):
                    found = dict(lenses(files[0]))
                    placed = sorted(images(files[1]), key=lambda image: image[0])
                return [_colmap(folder, found, image, warn) for image in placed]
    return None


# --- INRIA ----------------------------------------------------------------------------------------


def _is_inria(entry: Any) -> bool:
    return isinstance(entry, dict) and {"position", "rotation"} <= entry.keys()


def _inria(entry: Entry, path: Path, index: int) -> Entry:
    with refusing(f"{path}: camera {index}"):
        pose = np.eye(4)
        pose[:3, :3] = np.reshape(entry["rotation"], (3, 3))
        pose[:3, 3] = entry["position"]
        width, height = int(entry["width"]), int(entry["height"])
        return {
            "id": entry.get("id", index), "width": width, "height": height,
            "fx": entry["fx"], "fy": entry["fy"],
            "cx": entry.get("cx", width / 2), "cy": entry.get("cy", height / 2),
            "world_to_camera": _inverse(pose),
            "image": _picture(path.parent, str(entry.get("img_name", ""))),
        }  # fmt: skip


# --- nerfstudio, instant-ngp, Blender -------------------------------------------------------------


def _transforms(document: Entry, path: Path, warn: Warn) -> list[Entry]:
    with refusing(f"{path}: frames"):
        frames = [document | frame for frame in document["frames"]]
    bent = [name for name in DISTORTION if any(frame.get(name) for frame in frames)]
    models = {str(frame.get("camera_model", "")).upper() for frame in frames}
    if any(frame.get("is_fisheye") for frame in frames):  # instant-ngp's
        models.add(FISHEYE)
    if round_ := sorted(model for model in models if model.startswith(NO_PINHOLE)):
        raise InputError(f"{path}: camera model {shown(round_[0])} has no pinhole picture")
    bent += sorted(model for model in models if FISHEYE in model)
    if bent:
        warn(f"{path}: lens distortion {', '.join(bent)} left out: cameras are drawn without it")
    with refusing(str(path.with_name(PARSED))):
        moved, scale = _parsed(document, path, warn)
    return [_frame(frame, path, index, moved, scale, bent) for index, frame in enumerate(frames)]


def _frame(
    frame: Entry, path: Path, index: int, moved: NDArray[Any], scale: float, bent: list[str]
) -> Entry:
    with refusing(f"{path}: camera {index}"):
        pose = moved @ _affine(frame["transform_matrix"]) @ FROM_OPENGL
        pose[:3, 3] *= scale
        picture = _picture(path.parent, str(frame.get("file_path", "")))
        width, height = _size(frame, path.parent, picture)
        if str(frame.get("camera_model", "")).upper() == PANORAMA:
            turn = _inverse(pose)
            return {"id": index, "world_to_camera": turn, **_panorama(width, height, picture)}
        if not {"fl_x", "camera_angle_x"} & frame.keys():
            raise ValueError("neither fl_x nor camera_angle_x")
        fx = frame["fl_x"] if "fl_x" in frame else _focal(width, frame["camera_angle_x"])
        fy = fx
        if "fl_y" in frame:
            fy = frame["fl_y"]
        elif "camera_angle_y" in frame:
            fy = _focal(height, frame["camera_angle_y"])
        return {
            "id": index, "width": width, "height": height, "fx": fx, "fy": fy,
            "cx": frame.get("cx", width / 2), "cy": frame.get("cy", height / 2),
            "world_to_camera": _inverse(pose), "image": None if bent else picture,
        }  # fmt: skip


def _panorama(width: int, height: int, picture: str | None) -> Entry:
    return {
        "width": width, "height": height, "fx": width / math.tau, "fy": height / math.pi,
        "cx": width / 2, "cy": height / 2, "model": PANORAMA.lower(), "image": picture,
    }  # fmt: skip


def _parsed(document: Entry, path: Path, warn: Warn) -> tuple[NDArray[np.float64], float]:
    """From the file's world to that of nerfstudio's exported maps: a transform, then a scale."""
    beside = path.with_name(PARSED)
    if not beside.is_file():
        return np.eye(4), 1.0
    parsed = json.loads(beside.read_text(encoding="utf-8-sig"))
    warn(f"{path}: cameras are moved by {PARSED} beside it")
    applied = _affine(document.get("applied_transform", APPLIED))
    scale = float(parsed["scale"]) / float(document.get("applied_scale", 1.0))
    return _affine(parsed["transform"]) @ np.linalg.inv(applied), scale


def _affine(rows: Any) -> NDArray[np.float64]:
    """(4, 4) of three or four rows, or of their numbers one after the other."""
    matrix = np.eye(4)
    matrix[:3] = np.asarray(rows, np.float64).reshape(-1, 4)[:3]
    return matrix


def _focal(pixels: int, angle: float) -> float:
    return pixels / 2 / math.tan(angle / 2)


def _size(frame: Entry, folder: Path, picture: str | None) -> tuple[int, int]:
    """Of a frame's picture, by the file or by the picture itself. [px]"""
    if "w" in frame and "h" in frame:
        return int(frame["w"]), int(frame["h"])
    if picture is None:
        raise ValueError("no w, h, and no picture that tells them")
    from PIL import Image

    with Image.open(folder / picture) as image:
        return image.size


def _picture(folder: Path, name: str) -> str | None:
    """The name of a picture that is there, relative to the folder; Blender leaves out .png."""
    names = [name, f"{name}.png", f"images/{name}"] if name else []
    return next((n for n in names if len(n) < 256 and (folder / n).is_file()), None)


# --- COLMAP ---------------------------------------------------------------------------------------

Lens = tuple[str, int, int, tuple[float, ...]]  # model, width, height [px], parameters
Image = tuple[str, int, int, tuple[float, ...], tuple[float, ...]]  # name, id, lens, wxyz, xyz


def _colmap(folder: Path, lenses: dict[int, Lens], image: Image, warn: Warn) -> Entry:
    name, number, lens, wxyz, translation = image
    with refusing(f"{folder}: picture {shown(name)}"):
        if lens not in lenses:
            raise ValueError(f"no camera {lens}")
        model, width, height, parameters = lenses[lens]
        if model.startswith(NO_PINHOLE):
            raise InputError(f"{folder}: camera model {model} has no pinhole picture")
        if (model, len(parameters)) not in MODELS:
            raise ValueError(f"camera model {model} of {len(parameters)} numbers isn't known")
        transform = np.eye(4)
        transform[:3, :3] = to_matrices([*wxyz[1:], wxyz[0]])
        transform[:3, 3] = translation
        placed = {"id": number, "world_to_camera": transform.tolist()}
        if model == PANORAMA:
            return placed | _panorama(width, height, _picture(folder, name))
        one = model.startswith(("SIMPLE", "RADIAL"))
        fx, fy, cx, cy = parameters[:1] + parameters[:3] if one else parameters[:4]
        bent = FISHEYE in model or any(parameters[3 if one else 4 :])
        if bent:
            warn(f"{folder}: lens distortion {model} left out: cameras are drawn without it")
        return placed | {
            "width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy,
            "image": None if bent else _picture(folder, name),
        }  # fmt: skip


def _text_lenses(file: Path) -> Iterator[tuple[int, Lens]]:
    for line in file.read_text(encoding="utf-8-sig").splitlines():
        if line.strip() and not line.startswith("#"):
            number, model, width, height, *parameters = line.split()
            yield int(number), (model, int(width), int(height), tuple(map(float, parameters)))


def _text_images(file: Path) -> Iterator[Image]:
    for line in file.read_text(encoding="utf-8-sig").splitlines():
        if line.strip() and not line.startswith("#") and not _are_points(line.split()):
            number, *numbers, lens, name = line.split(maxsplit=9)
            pose = tuple(map(float, numbers))
            yield name, int(number), int(lens), pose[:4], pose[4:]


def _are_points(words: list[str]) -> bool:
    """Whether a line has a picture's points, x y id each; some programs write none."""
    return len(words) % 3 == 0 and words[-1].removeprefix("-").isdecimal()


def _binary_lenses(file: Path) -> Iterator[tuple[int, Lens]]:
    with file.open("rb") as stream:
        for _ in range(_read(stream, "<Q")[0]):
            number, model, width, height = _read(stream, "<iiQQ")
            if not 0 <= model < len(MODELS):
                raise ValueError(f"camera model {model} isn't known")
            name, count = MODELS[model]
            yield number, (name, width, height, _read(stream, f"<{count}d"))


def _binary_images(file: Path) -> Iterator[Image]:
    with file.open("rb") as stream:
        for _ in range(_read(stream, "<Q")[0]):
            number, *pose, lens = _read(stream, "<i7di")
            name = bytearray()
            while (character := stream.read(1)) not in (b"\0", b""):
                name += character
            stream.seek(24 * _read(stream, "<Q")[0], 1)  # its points
            yield name.decode(), number, lens, tuple(pose[:4]), tuple(pose[4:])


def _read(stream: BinaryIO, form: str) -> tuple[Any, ...]:
    data = stream.read(struct.calcsize(form))
    if len(data) < struct.calcsize(form):
        raise ValueError("cut short")
    return struct.unpack(form, data)


def _inverse(pose: NDArray[np.float64]) -> list[list[float]]:
    inverse: list[list[float]] = np.linalg.inv(pose).tolist()
    return inverse
