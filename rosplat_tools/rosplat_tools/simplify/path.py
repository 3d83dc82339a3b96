"""The path of cameras whose views matter, from files of cameras, poses and intrinsics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from rosplat_core.cameras import Camera, load_cameras, load_trajectory
from rosplat_core.splats import InputError

BAGS = (".mcap", ".db3")


def along(cameras: Path | None, trajectory: Path | None) -> list[Camera] | None:
    """The cameras of a file, or the first of them at each pose of a trajectory; None for neither.

    cameras: a camera file, or where a trajectory is given a camera_info file. trajectory: a file as
    the TUM benchmark has it, a bag, or BAG:TOPIC. Raises InputError.
    """
    if cameras is None:
        if trajectory:
            raise InputError("--trajectory has no intrinsics: give --cameras, too")
        return None
    if trajectory and cameras.suffix in (".yaml", ".yml"):
        return _at_each_pose(trajectory, load_camera_info(cameras))
    found = load_cameras(cameras)
    if not found:
        raise InputError(f"{cameras}: holds no cameras")
    return _at_each_pose(trajectory, found[0]) if trajectory else found


def _at_each_pose(trajectory: Path, camera: Camera) -> list[Camera]:
    """The camera at each pose of a bag, of BAG:TOPIC, or of a file for load_trajectory."""
    bag, _, topic = str(trajectory).partition(":")
    if not (Path(bag).is_dir() or Path(bag).suffix in BAGS):
        return load_trajectory(trajectory, camera)
    from rosplat_tools.simplify.bag_path import poses

    return [
        replace(camera, id=number, world_to_camera=np.linalg.inv(pose).astype(np.float64))
        for number, pose in enumerate(poses(bag, topic))
    ]


def load_camera_info(path: Path) -> Camera:
    """A camera of a calibration's YAML, or of a message as `ros2 topic echo` prints it.

    It is at the origin, and takes rectified pictures. Raises InputError naming file and field.
    """
    try:
        document = next(iter(yaml.safe_load_all(path.read_text(encoding="utf-8"))), None)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except (ValueError, yaml.YAMLError) as error:
        raise InputError(f"{path}: is no YAML") from error
    if not isinstance(document, dict):
        raise InputError(f"{path}: is no camera_info")

    def value(*names: str) -> object:
        for name in names:
            if name in document:
                found = document[name]
                return found["data"] if isinstance(found, dict) and "data" in found else found
        raise InputError(f"{path}: no {' or '.join(names)}")

    try:
        projection = np.reshape(np.asarray(value("p", "projection_matrix"), np.float64), (3, 4))
        fx, fy, cx, cy = projection[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
        # For ROS the centre of the top left pixel is (0, 0).
        return Camera(
            0, value("width", "image_width"), value("height", "image_height"),  # type: ignore[arg-type]
            fx, fy, cx + 0.5, cy + 0.5, np.eye(4),
        )  # fmt: skip
    except (ValueError, TypeError) as error:
        raise InputError(f"{path}: {error}") from error
