"""A robot's MuJoCo model in a map, and its state as time passes. Knows no ROS."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core.first_look import sample
from rosplat_core.occupancy import RESOLUTION
from rosplat_core.rigid import placed
from rosplat_core.splats import InputError, Splats
from rosplat_core.upright import standing_pose
from rosplat_tools.simulation.physics import compiled, load_mujoco, read_spec
from rosplat_tools.simulation.solids import (
    BODY,
    GROUP,
    Boxes,
    add_object,
    add_solids,
    free_place,
    solids,
)

Array = NDArray[np.float64]

VELOCITY = {  # actuators by which a robot follows a velocity, and their part of a Twist
    f"{kind}_{axis}": (kind, axis) for kind in ("linear", "angular") for axis in "xyz"
}
BROKEN = ("BADQPOS", "BADQVEL", "BADQACC", "BADCTRL")  # MuJoCo's warnings of states that are none


class BrokenState(RuntimeError):
    """The state is not finite, or beyond all bounds; the text says when."""


class RobotModel:
    """A model of an MJCF file with a map's solid parts around it."""

    def __init__(
        self,
        path: str | Path,
        solids: Boxes,
        pose: Array,
        objects: Mapping[str, Boxes] | None = None,
    ) -> None:
        """pose: (4, 4) of the solids in the file's world [m]. objects: by name, further ones that
        move freely, in the same frame.

        Raises InputError, naming the file, for one that MuJoCo can't read whole.
        """
        mujoco = load_mujoco()
        mujoco.set_mju_user_warning(lambda text: None)  # else it writes a file; step() tells
        spec = read_spec(path)
        for geometry in spec.worldbody.geoms:
            if geometry.type == mujoco.mjtGeom.mjGEOM_PLANE:
                geometry.group = GROUP  # the map is the ground that is seen
        add_solids(spec, solids, pose)
        self.objects = {
            name: add_object(spec, name, boxes, pose) for name, boxes in (objects or {}).items()
        }
        """By name, the pose (4, 4) of each object's body where it begins. [m]"""
        self.model = compiled(spec, path)
        self.data = mujoco.MjData(self.model)
        self._mujoco = mujoco
        self.actuators = self._named("actuator", self.model.nu)
        """Numbers of actuators by names that topics can have."""
        self.cameras = self._named("camera", self.model.ncam)
        """Numbers of cameras, likewise."""
        self.sites = self._named("site", self.model.nsite)
        """Numbers of sites, likewise."""
        self.sensors = self._named("sensor", self.model.nsensor)
        """Numbers of sensors, likewise."""
        self._asked = 0.0
        self.reset()

    @property
    def time(self) -> float:
        """Since the last reset. [s]"""
        return float(self.data.time)

    def reset(self) -> None:
        """Begins anew, at the file's first keyframe if it has any."""
        if self.model.nkey:
            self._mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        else:
            self._mujoco.mj_resetData(self.model, self.data)
        self._mujoco.mj_forward(self.model, self.data)
        self._asked = self.time

    def step(self, seconds: float) -> None:
        """Lets time pass, in whole steps: what one call leaves over, later ones make up for.

        Raises BrokenState, after which reset() helps.
        """
        before = self.time
        self._asked += seconds
        count = int((self._asked - before) / self.model.opt.timestep + 0.01)
        self._mujoco.mj_step(self.model, self.data, count)
        warnings = [self.data.warning[getattr(self._mujoco.mjtWarning, f"mjWARN_{name}")]
                    for name in BROKEN]  # fmt: skip
        if any(warning.number for warning in warnings):
            raise BrokenState(f"the state is not finite after {before:.2f} s")

    def command(self, actuator: str, value: float) -> None:
        """Sets what an actuator is to do, within its range. Raises ValueError for a number that is
        not finite, KeyError for an actuator that there is not."""
        if not np.isfinite(value):
            raise ValueError(f"{actuator}: {value} is not finite")
        number = self.actuators[actuator]
        if self.model.actuator_ctrllimited[number]:
            value = float(np.clip(value, *self.model.actuator_ctrlrange[number]))
        self.data.ctrl[number] = value

    def _named(self, kind: str, count: int) -> dict[str, int]:
        found: dict[str, int] = {}
        for number in range(count):
            name = getattr(self.model, kind)(number).name or f"{kind}_{number}"
            usable = re.sub("[^A-Za-z0-9_]", "_", name)
            if not usable[0].isalpha():
                usable = f"{kind}_{usable.lstrip('_')}"
            found[another(usable, found, str(number))] = number
        return found

    @property
    def travels(self) -> bool:
        """Whether its base moves freely, or an actuator is named like a part of a Twist."""
        joint = self.model.body_jntadr[self.base]
        free = self._mujoco.mjtJoint.mjJNT_FREE
        is_free = joint >= 0 and self.model.jnt_type[joint] == free
        return bool(is_free or self.actuators.keys() & VELOCITY.keys())

    @property
    def base(self) -> int:
        """The body that a robot's odometry is of: of the tree that has the most bodies, the first
        that moves. 0 if none does."""
        trees = self.model.body_rootid
        robot = np.bincount(trees[1:], minlength=1).argmax()
        moves = (trees == robot) & (self.model.body_dofnum > 0)
        return int(moves.argmax())

    def bodies(self) -> list[tuple[int, str, int]]:
        """Number, name and parent's number of each body of the robot's file."""
        found = []
        for body in range(1, self.model.nbody):
            name = self.model.body(body).name
            if name != BODY:
                found.append((body, name or f"body_{body}", int(self.model.body_parentid[body])))
        return found

    def pose(self, body: int) -> Array:
        """(4, 4) of a body in the world. [m]"""
        return placed(self.data.xpos[body], self.data.xmat[body])

    def velocity(self, body: int) -> Array:
        """(6,) linear and angular velocity of a body in its own frame. [m/s, rad/s]"""
        found = np.zeros(6)
        kind = self._mujoco.mjtObj.mjOBJ_XBODY
        self._mujoco.mj_objectVelocity(self.model, self.data, kind, body, found, 1)
        return np.roll(found, 3)

    def joints(self) -> list[tuple[str, int, int]]:
        """Name, place in qpos and place in qvel of each joint that turns about an axis or slides
        along one."""
        kinds = self._mujoco.mjtJoint
        single = (int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE))
        return [
            (self.model.joint(i).name or f"joint_{i}", int(self.model.jnt_qposadr[i]),
             int(self.model.jnt_dofadr[i]))
            for i in range(self.model.njnt) if self.model.jnt_type[i] in single
        ]  # fmt: skip

    def cast(self, eye: Array, rays: Array, but: int) -> Array:
        """Distances (n,) at which rays (n, 3), of unit length, from an eye (3,) meet what cameras
        see of bodies, but for one body; inf where they meet none. [m]"""
        groups = np.array([1, 1, 1, 0, 0, 0], np.uint8)
        found, count = np.empty(len(rays)), len(rays)
        self._mujoco.mj_multiRay(
            self.model, self.data, eye, np.ascontiguousarray(rays).ravel(), groups, 1, but,
            np.empty(count, np.int32), found, None, count, 1e9,
        )  # fmt: skip
        return np.where(found < 0, np.inf, found)

    def measured(self, sensor: int) -> Array:
        """What a sensor measures, by its number, in MuJoCo's units."""
        first = self.model.sensor_adr[sensor]
        return np.array(self.data.sensordata[first : first + self.model.sensor_dim[sensor]])

    def imu(self) -> tuple[str, Array, Array, Array] | None:
        """The first site at which the model has a gyroscope and an accelerometer; the site's
        rotation (3, 3) in the world, and what both measure, (3,) each [rad/s, m/s^2]."""
        kinds = self._mujoco.mjtSensor
        turns, accelerations = (
            {int(self.model.sensor_objid[i]): int(self.model.sensor_adr[i])
             for i in np.flatnonzero(self.model.sensor_type == kind)}
            for kind in (kinds.mjSENS_GYRO, kinds.mjSENS_ACCELEROMETER)
        )  # fmt: skip
        for name, site in self.sites.items():
            if site in turns and site in accelerations:
                turn, acceleration = (
                    self.data.sensordata[each[site] :][:3] for each in (turns, accelerations)
                )
                return name, self.data.site_xmat[site].reshape(3, 3), turn, acceleration
        return None


def another(name: str, taken: Collection[str], suffix: str) -> str:
    """The name, with the suffix as often as it takes to be none of those taken."""
    while name in taken:
        name = f"{name}_{suffix}"
    return name


@dataclass(frozen=True, eq=False)
class Standing:
    """A robot that stands in a map."""

    robot: RobotModel
    map_pose: Array
    """(4, 4) of the map in the robot's world. [m]"""
    place: tuple[float, float, float]
    """x, y and height of the robot's origin in the map that stands upright. [m]"""
    has_room: bool
    """Whether there is ground with room for it; else it is where it was wished for, at height 0."""
    boxes: int
    """That it may run into."""
    riding: dict[str, tuple[Splats, Array]] = field(default_factory=dict)
    """The objects' splats, as SplatCamera takes them."""


def put_in_map(
    path: str | Path,
    splats: Splats,
    up: ArrayLike,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    resolution: float = RESOLUTION,
    objects: Mapping[str, Splats] | None = None,
) -> Standing:
    """Puts a robot of an MJCF file into a map, on its ground.

    up (3,): the map's vertical. start: x, y [m] and yaw [rad] in the map that stands upright, or
    the nearest place with room. resolution: edge of voxels [m]. objects: by name, further splats in
    the map's coordinates, each of which is a body that moves freely; its voxels are half as wide,
    and its hollows solid. Raises InputError.
    """
    standing = standing_pose(sample(splats), up)
    boxes = solids(splats, standing, resolution)
    things = {}
    for name, thing in (objects or {}).items():
        things[name] = solids(thing, standing, resolution / 2, filled=True)
        if not len(things[name]):
            raise InputError(f"object {name}: nothing of it is solid")
    x, y, yaw = start
    found = free_place(boxes, (x, y))
    place = found or (x, y, 0.0)
    turn = [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
    to_robot = np.asarray(np.linalg.inv(placed(np.array(place), np.array(turn))))
    robot = RobotModel(path, boxes, to_robot, things)
    map_pose = to_robot @ standing
    riding = {
        name: (thing, np.linalg.inv(robot.objects[name]) @ map_pose)
        for name, thing in (objects or {}).items()
    }
    return Standing(robot, map_pose, place, found is not None, len(boxes), riding)


def robot_file(name: str, folder: Path) -> Path:
    """The MJCF file of a robot: one of the folder by its name, or any by its path.

    Raises InputError for one that is not there, naming those that are.
    """
    own = folder / f"{name}.xml"
    path = own if own.is_file() else Path(name).expanduser()
    if not path.is_file():
        known = ", ".join(sorted(each.stem for each in folder.glob("*.xml")))
        raise InputError(f"robot '{name}': expected {known}, or an MJCF file")
    return path
