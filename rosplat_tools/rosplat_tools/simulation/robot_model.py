"""A robot's MuJoCo model in a map, and its state as time passes. Knows no ROS."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rosplat_core.splats import SceneError
from rosplat_tools.simulation.physics import compiled, load_mujoco, read_spec
from rosplat_tools.simulation.solids import BODY, Boxes, add_solids

Array = NDArray[np.float64]

VELOCITY = {  # actuators by which a robot follows a velocity, and their part of a Twist
    f"{kind}_{axis}": (kind, axis) for kind in ("linear", "angular") for axis in "xyz"
}
BROKEN = ("BADQPOS", "BADQVEL", "BADQACC", "BADCTRL")  # MuJoCo's warnings of states that are none


class BrokenState(RuntimeError):
    """The state is not finite, or beyond all bounds; the text says when."""


class RobotModel:
    """A model of an MJCF file with a map's solid parts around it."""

    def __init__(self, path: str | Path, solids: Boxes, pose: Array) -> None:
        """pose: (4, 4) of the solids in the file's world [m].

        Raises SceneError, naming the file, for one that MuJoCo can't read whole.
        """
        mujoco = load_mujoco()
        spec = read_spec(path)
        add_solids(spec, solids, pose)
        self.model = compiled(spec, path)
        self.data = mujoco.MjData(self.model)
        self._mujoco = mujoco
        names = [self.model.actuator(i).name for i in range(self.model.nu)]
        self.actuators = {name: i for i, name in enumerate(names) if name}
        """Numbers of actuators by their names."""
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

    def step(self, seconds: float) -> None:
        """Lets time pass, in whole steps. Raises BrokenState, after which reset() helps."""
        count = max(1, round(seconds / self.model.opt.timestep))
        before = self.time
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

    @property
    def follows_velocities(self) -> bool:
        """Whether it has an actuator named linear_x, or like another part of a Twist."""
        return any(name in VELOCITY for name in self.actuators)

    @property
    def base(self) -> int:
        """The body that a robot's odometry is of: the first that the first actuator moves."""
        for body in range(1, self.model.nbody):
            if self.model.body_dofnum[body] and self.model.body_parentid[body] == 0:
                return body
        return 0

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

    def sensor(self, name: str) -> Array | None:
        """What a sensor of the model measures now; None without one of that name."""
        number = self._mujoco.mj_name2id(self.model, self._mujoco.mjtObj.mjOBJ_SENSOR, name)
        return None if number < 0 else np.array(self.data.sensor(number).data)


def placed(position: Array, rotation: Array) -> Array:
    """(4, 4) of a position (3,) and a rotation matrix of any shape of nine. [m]"""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.reshape(rotation, (3, 3)), position
    return pose


def robot_file(name: str, folder: Path) -> Path:
    """The MJCF file of a robot: one of the folder by its name, or any by its path.

    Raises SceneError for one that is not there, naming those that are.
    """
    own = folder / f"{name}.xml"
    path = own if own.is_file() else Path(name).expanduser()
    if not path.is_file():
        known = ", ".join(sorted(each.stem for each in folder.glob("*.xml")))
        raise SceneError(f"robot '{name}': expected {known}, or an MJCF file")
    return path
