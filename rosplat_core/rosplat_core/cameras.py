"""Cameras that look at a scene: their file format, and where to put them. Knows no ROS.

A camera file is a JSON list of objects with id, width, height, fx, fy, cx, cy [px] and
world_to_camera (4x4, OpenCV: x right, y down, z forward [m]); image, orthographic, near, far and
model may be given as well. foreign_cameras.py has the files of others that are read, too.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import MISSING, asdict, dataclass, fields, replace
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core import foreign_cameras
from rosplat_core.formats.bounds import naming_the_file
from rosplat_core.formats.strangers import impostor
from rosplat_core.log_text import shown
from rosplat_core.program.files import write_text
from rosplat_core.quaternions import from_matrices
from rosplat_core.rigid import rigid
from rosplat_core.splats import InputError, Splats, check_kind
from rosplat_core.view import frame_at

_log = logging.getLogger(__name__)

UP = (0.0, 0.0, 1.0)  # REP-103
PINHOLE, EQUIRECTANGULAR = MODELS = "", "equirectangular"


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera without lens distortion. Raises ValueError for values that can't be one.

    The centre of the first pixel is (0.5, 0.5), as for COLMAP, gsplat and OpenGL. For ROS and
    OpenCV it is (0, 0): add 0.5 to their cx and cy, as from_camera_info does.
    """

    id: int
    width: int
    """Size of the picture. [px]"""
    height: int
    fx: float
    """Focal lengths [px]; for orthographic cameras [px/m], for panoramas [px/rad]."""
    fy: float
    cx: float
    """Principal point, where the centre of the top left pixel is (0.5, 0.5). [px]"""
    cy: float
    world_to_camera: NDArray[np.float64]
    """(4, 4) rigid transform into the optical frame: x right, y down, z forward. [m]

    A rotation that is off by up to 1e-2 becomes the nearest one, and the log says so once.
    """
    orthographic: bool = False
    near: float = 0.01
    """Depths along z between which splats are drawn. [m]"""
    far: float = 1e10
    image: str | None = None
    """Name of the picture that the camera took, beside the camera file."""
    model: str = PINHOLE
    """"equirectangular" for a panorama: x is the longitude, y the latitude, 0 ahead."""

    def __post_init__(self) -> None:
        """Converts the transform and checks every value."""
        for name in ("id", "width", "height"):
            value = getattr(self, name)
            if (
                not isinstance(value, Integral)
                or isinstance(value, bool)
                or (name != "id" and value < 1)
            ):
                least = "" if name == "id" else " of 1 or more"
                raise ValueError(f"{name} is {value!r}, expected a whole number{least}")
            object.__setattr__(self, name, int(value))
        for name in ("fx", "fy", "cx", "cy", "near", "far"):
            value = getattr(self, name)
            if not isinstance(value, Real) or not _is_finite(value):
                raise ValueError(f"{name} is {value!r}, expected a finite number")
            object.__setattr__(self, name, float(value))
        if not isinstance(self.orthographic, bool):
            raise ValueError(f"orthographic is {self.orthographic!r}, expected true or false")
        if not isinstance(self.image, str | None):
            raise ValueError(f"image is {self.image!r}, expected a name")
        if self.model not in MODELS or (self.model and self.orthographic):
            raise ValueError(f"model is {self.model!r}, expected none or '{EQUIRECTANGULAR}'")
        if not (self.fx > 0 and self.fy > 0):
            raise ValueError(f"fx, fy are {self.fx}, {self.fy}, expected more than 0")
        if not 0 < self.near < self.far:
            raise ValueError(f"near, far are {self.near}, {self.far}, expected 0 < near < far")
        transform = rigid(self.world_to_camera, "world_to_camera")
        given = np.asarray(self.world_to_camera, np.float64)
        if (transform[:3, :3] != given[:3, :3]).any():  # another rotation at the same place
            place = np.linalg.solve(given[:3, :3], given[:3, 3])
            transform[:3, 3] = transform[:3, :3] @ place
        object.__setattr__(self, "world_to_camera", transform)

    @classmethod
    def from_camera_info(
        cls, info: Any, world_to_camera: ArrayLike | None = None, id: int = 0
    ) -> Camera:
        """The camera of rectified pictures, by a sensor_msgs/CameraInfo or what has its fields.

        Takes width, height and the projection matrix p, else k where p is zero, and moves the
        principal point by half a pixel: for ROS, the centre of the first pixel is (0, 0).
        world_to_camera: by default, the camera is at the origin. Raises ValueError.
        """
        try:
            p, k = (np.asarray(matrix, np.float64) for matrix in (info.p, info.k))
            fx, cx, fy, cy = p[[0, 2, 5, 6]] if p.any() else k[[0, 2, 4, 5]]
            width, height = int(info.width), int(info.height)
        except (AttributeError, TypeError, ValueError, IndexError) as error:
            raise ValueError(f"no CameraInfo with width, height, p and k: {error}") from error
        pose = np.eye(4) if world_to_camera is None else world_to_camera
        centre = float(cx) + 0.5, float(cy) + 0.5
        return cls(id, width, height, float(fx), float(fy), *centre, np.asarray(pose, np.float64))

    @property
    def position(self) -> NDArray[np.float64]:
        """(3,) centre of projection in the world. [m]"""
        rotation, translation = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        # Not by the transpose: a rotation of few digits, far from 0, would be metres off.
        return np.asarray(np.linalg.solve(rotation, -translation), np.float64)

    @property
    def camera_to_world(self) -> NDArray[np.float64]:
        """(4, 4) pose of the optical frame in the world. [m]"""
        pose = np.eye(4)
        pose[:3, :3] = self.world_to_camera[:3, :3].T
        pose[:3, 3] = self.position
        return pose

    @property
    def orientation(self) -> NDArray[np.float64]:
        """(4,) unit quaternion x, y, z, w of the optical frame in the world."""
        return from_matrices(self.camera_to_world[:3, :3])


def _is_finite(value: Real) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number that no float holds
        return False


def load_cameras(
    path: str | Path,
    warn: Callable[[str], object] = _log.warning,
    *,
    panoramas: bool = False,
) -> list[Camera]:
    """Reads a camera file: ours, INRIA's cameras.json, nerfstudio's transforms.json, or COLMAP's.

    COLMAP's is a folder, or one of its files. warn is called with what is left out, such as lens
    distortion. panoramas: whether these may be among them. Raises InputError naming the file, the
    camera and the field.
    """
    path, told = Path(path), list[str]()
    with naming_the_file(path):
        try:
            entries: Any = foreign_cameras.colmap(path, told.append)
            if entries is None:
                document = json.loads(path.read_text(encoding="utf-8-sig"))
                entries = foreign_cameras.entries(document, path, told.append)
        except (ValueError, RecursionError) as error:
            if isinstance(error, InputError):
                raise
            what = impostor(path.read_bytes() if path.is_file() else b"") or f"not JSON: {error}"
            raise InputError(f"{path}: {what}") from error
    for text in dict.fromkeys(told):
        warn(text)
    if not isinstance(entries, list):
        raise InputError(f"{path}: expected a list of cameras")
    cameras = [_camera(entry, f"{path}: camera {index}") for index, entry in enumerate(entries)]
    for index, camera in enumerate(cameras):
        if camera.model and not panoramas:
            raise InputError(f"{path}: camera {index}: {camera.model} has no pinhole picture")
    return cameras


def _camera(entry: Any, where: str) -> Camera:
    if not isinstance(entry, dict):
        raise InputError(f"{where}: expected an object")
    known = {field.name: field.default is MISSING for field in fields(Camera)}
    missing = [name for name, required in known.items() if required and name not in entry]
    if missing:
        raise InputError(f"{where}: no {', '.join(missing)}")
    try:
        return Camera(**{name: value for name, value in entry.items() if name in known})
    except ValueError as error:
        raise InputError(f"{where}: {shown(str(error), 300)}") from error


def resized(camera: Camera, pixels: int) -> Camera:
    """The camera with a picture of about `pixels` pixels at most, of the same view."""
    factor = min(1.0, math.sqrt(pixels / (camera.width * camera.height)))
    return replace(
        camera,
        width=max(1, round(factor * camera.width)), height=max(1, round(factor * camera.height)),
        fx=factor * camera.fx, fy=factor * camera.fy, cx=factor * camera.cx, cy=factor * camera.cy,
    )  # fmt: skip


def picture_of(path: Path, camera: Camera) -> Path | None:
    """The picture that a camera of a file, or of COLMAP's folder, took; None without one."""
    folder = path if path.is_dir() else path.parent
    return folder / camera.image if camera.image else None


def check_cameras(cameras: object) -> None:
    """Raises TypeError for what is no sequence of cameras."""
    if not isinstance(cameras, Sequence) or isinstance(cameras, str):
        raise TypeError(f"cameras: expected several of Camera, got {type(cameras).__name__}")
    for camera in cameras:
        check_kind(camera, Camera, "camera")


def save_cameras(path: str | Path, cameras: Sequence[Camera]) -> None:
    """Writes a camera file. Raises InputError when it can't be written."""
    check_cameras(cameras)
    entries = [
        asdict(camera) | {"world_to_camera": camera.world_to_camera.tolist()} for camera in cameras
    ]
    with naming_the_file(Path(path)):
        write_text(Path(path), json.dumps(entries, indent=1) + "\n")


def load_trajectory(path: str | Path, camera: Camera) -> list[Camera]:
    """Reads a trajectory of the TUM benchmark (Sturm et al. 2012): `camera` at each of its poses.

    A line is time x y z qx qy qz qw [s, m], the optical frame's pose in the world. Raises
    InputError naming the file and the line.
    """
    with naming_the_file(Path(path)):
        try:
            text = Path(path).read_text(encoding="utf-8")
        except ValueError as error:
            raise InputError(f"{path}: is no text") from error
    cameras: list[Camera] = []
    for number, line in enumerate(text.splitlines(), 1):
        values = line.partition("#")[0].split()
        if not values:
            continue
        try:
            _, *pose = (float(value) for value in values)
        except ValueError:
            pose = []
        if len(pose) != 7 or not np.isfinite(pose).all() or not any(pose[3:]):
            raise InputError(f"{path}: line {number}: expected time x y z qx qy qz qw")
        world_to_camera = np.asarray(np.linalg.inv(frame_at(pose[:3], pose[3:])), np.float64)
        cameras.append(replace(camera, id=len(cameras), world_to_camera=world_to_camera))
    if not cameras:
        raise InputError(f"{path}: holds no poses")
    return cameras


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = UP) -> NDArray[np.float64]:
    """(4, 4) world_to_camera of a camera at eye (3,) that looks at target (3,). [m]

    up (3,) points to the top of the picture; where it is parallel to the view, another axis does.
    Raises ValueError when eye and target are the same point.
    """
    eye, target, up = (np.asarray(v, np.float64) for v in (eye, target, up))
    forward = target - eye
    if not np.linalg.norm(forward) > 0:
        raise ValueError("a camera can't look at its own position")
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9 * np.linalg.norm(up):
        right = np.cross(forward, np.eye(3)[np.abs(up).argmin()])
    right = right / np.linalg.norm(right)
    transform = np.eye(4)
    transform[:3, :3] = [right, np.cross(forward, right), forward]
    transform[:3, 3] = -transform[:3, :3] @ eye
    return transform


def orbit(
    bounds: ArrayLike,
    count: int,
    *,
    width: int = 1280,
    height: int = 720,
    fov: float = 0.9,
    elevation: float = 0.35,
    azimuth: float = 0.0,
    up: ArrayLike = UP,
) -> list[Camera]:
    """count cameras, evenly spaced on a circle, each of which sees all of the bounds (2, 3). [m]

    width, height: of the pictures [px]. fov: the smaller angle of view [rad]. elevation: above the
    horizon [rad]. azimuth: where the circle begins [rad]. up (3,): the scene's vertical.
    Raises ValueError for a fov that isn't between 0 and pi.
    """
    if not 0 < fov < math.pi:
        raise ValueError(f"fov is {fov}, expected 0 < fov < pi")
    if np.shape(corners := np.array(bounds, dtype=object)) != (2, 3):
        raise ValueError(f"bounds: expected two corners (2, 3), got {np.shape(corners)}")
    lower, upper = corners.astype(np.float64)
    target = (lower + upper) / 2
    radius = max(float(np.linalg.norm(upper - lower)) / 2, 1e-6)
    distance = radius / math.sin(fov / 2)
    focal = min(width, height) / 2 / math.tan(fov / 2)
    vertical = np.asarray(up, np.float64) / np.linalg.norm(up)
    # Any two axes that complete the vertical; for z up they are x and y.
    first = np.eye(3)[(int(np.abs(vertical).argmax()) + 1) % 3]
    first = first - vertical * (first @ vertical)
    first = first / np.linalg.norm(first)
    second = np.cross(vertical, first)
    cameras = []
    for index in range(count):
        angle = azimuth + 2 * math.pi * index / count
        horizontal = math.cos(angle) * first + math.sin(angle) * second
        outward = math.cos(elevation) * horizontal + math.sin(elevation) * vertical
        transform = look_at(target + distance * outward, target, vertical)
        cameras.append(Camera(index, width, height, focal, focal, width / 2, height / 2, transform))
    return cameras


@dataclass(frozen=True)
class Place:
    """Where the bulk of a scene is: its middle and half its diagonal. [m]"""

    centre: NDArray[np.float64]
    radius: float


def place(splats: Splats) -> Place:
    """The place of the middle 90 % of the splats along each axis: few stray ones don't move it."""
    sample = splats.positions[:: len(splats) // 1_000_000 + 1]
    low, high = np.quantile(sample.astype(np.float64), [0.05, 0.95], axis=0)
    centre = (low + high) / 2 + splats.origin
    return Place(centre, max(float(np.linalg.norm(high - low)) / 2, 1e-3))
