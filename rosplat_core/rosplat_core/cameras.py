"""Cameras that look at a scene: their file format, and where to put them. Knows no ROS.

A camera file is a JSON list of objects with id, width, height, fx, fy, cx, cy [px] and
world_to_camera (4x4, OpenCV: x right, y down, z forward [m]); image, orthographic, near and far may
be given as well.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import MISSING, asdict, dataclass, fields, replace
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core.program.files import write_text
from rosplat_core.quaternions import from_matrices, to_matrices
from rosplat_core.splats import SceneError, Splats

UP = (0.0, 0.0, 1.0)  # REP-103


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera without lens distortion. Raises ValueError for values that can't be one."""

    id: int
    width: int
    """Size of the picture. [px]"""
    height: int
    fx: float
    """Focal lengths [px]; for orthographic cameras [px/m]."""
    fy: float
    cx: float
    """Principal point, where the centre of the top left pixel is (0.5, 0.5). [px]"""
    cy: float
    world_to_camera: NDArray[np.float64]
    """(4, 4) rigid transform into the optical frame: x right, y down, z forward. [m]"""
    orthographic: bool = False
    near: float = 0.01
    """Depths along z between which splats are drawn. [m]"""
    far: float = 1e10
    image: str | None = None
    """Name of the picture that the camera took, beside the camera file."""

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
        if not (self.fx > 0 and self.fy > 0):
            raise ValueError(f"fx, fy are {self.fx}, {self.fy}, expected more than 0")
        if not 0 < self.near < self.far:
            raise ValueError(f"near, far are {self.near}, {self.far}, expected 0 < near < far")
        try:
            transform = np.array(self.world_to_camera, np.float64)  # a copy: callers go on
        except (TypeError, ValueError, OverflowError):
            transform = np.empty(0)
        if transform.shape != (4, 4) or not np.isfinite(transform).all():
            raise ValueError("world_to_camera: expected 4x4 finite numbers")
        rotation = transform[:3, :3]
        rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4)
        if not rigid or np.linalg.det(rotation) < 0 or (transform[3] != (0, 0, 0, 1)).any():
            raise ValueError("world_to_camera: expected a rotation and a translation")
        object.__setattr__(self, "world_to_camera", transform)

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


def load_cameras(path: str | Path) -> list[Camera]:
    """Reads a camera file. Raises SceneError naming the file, the camera and the field."""
    try:
        entries = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise SceneError(f"{path}: not JSON: {error}") from error
    if not isinstance(entries, list):
        raise SceneError(f"{path}: expected a list of cameras")
    return [_camera(entry, f"{path}: camera {index}") for index, entry in enumerate(entries)]


def _camera(entry: Any, where: str) -> Camera:
    if not isinstance(entry, dict):
        raise SceneError(f"{where}: expected an object")
    known = {field.name: field.default is MISSING for field in fields(Camera)}
    missing = [name for name, required in known.items() if required and name not in entry]
    if missing:
        raise SceneError(f"{where}: no {', '.join(missing)}")
    try:
        return Camera(**{name: value for name, value in entry.items() if name in known})
    except ValueError as error:
        raise SceneError(f"{where}: {error}") from error


def save_cameras(path: str | Path, cameras: Sequence[Camera]) -> None:
    """Writes a camera file. Raises SceneError when it can't be written."""
    entries = [
        asdict(camera) | {"world_to_camera": camera.world_to_camera.tolist()} for camera in cameras
    ]
    try:
        write_text(Path(path), json.dumps(entries, indent=1) + "\n")
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:  # no name of a file
        raise SceneError(f"{path}: {error}") from error


def load_trajectory(path: str | Path, camera: Camera) -> list[Camera]:
    """Reads a trajectory of the TUM benchmark (Sturm et al. 2012): `camera` at each of its poses.

    A line is time x y z qx qy qz qw [s, m], the optical frame's pose in the world. Raises
    SceneError naming the file and the line.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise SceneError(f"{path}: is no text") from error
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
            raise SceneError(f"{path}: line {number}: expected time x y z qx qy qz qw")
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = to_matrices(pose[3:]).T
        world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ pose[:3]
        cameras.append(replace(camera, id=len(cameras), world_to_camera=world_to_camera))
    if not cameras:
        raise SceneError(f"{path}: holds no poses")
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
    lower, upper = np.asarray(bounds, np.float64)
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
