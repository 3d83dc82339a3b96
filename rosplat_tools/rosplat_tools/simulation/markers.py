"""A robot's bodies as markers for rviz2, in the frames that TF has of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from rosplat_core.rigid import placed
from rosplat_ros.poses import to_point, to_pose, to_vector
from rosplat_tools.simulation.physics import load_mujoco
from rosplat_tools.simulation.robot_model import RobotModel

Array = NDArray[np.float64]

SHOWN_GROUPS = 3  # of geometries, from 0: what cameras see


def markers_of(robot: RobotModel, frames: Mapping[int, str]) -> MarkerArray:
    """What cameras see of a robot: a marker for each geometry, and for each end of a capsule.

    frames: of bodies, by their numbers. Each marker is fixed to one: who shows them follows TF. The
    first clears those of before.
    """
    kinds = {name: int(value) for name, value in load_mujoco().mjtGeom.__members__.items()}
    own = {number for number, _, _ in robot.bodies()}
    model, shapes = robot.model, []
    for i in range(model.ngeom):
        body = int(model.geom_bodyid[i])
        if body not in own or model.geom_group[i] >= SHOWN_GROUPS:
            continue
        pose = _in_body(robot, body, i)
        kind, size = int(model.geom_type[i]), 2 * model.geom_size[i]
        made: list[Marker] = []
        if kind == kinds["mjGEOM_BOX"]:
            made = [_shape(Marker.CUBE, size, pose)]
        elif kind == kinds["mjGEOM_SPHERE"]:
            made = [_shape(Marker.SPHERE, np.repeat(size[0], 3), pose)]
        elif kind == kinds["mjGEOM_ELLIPSOID"]:
            made = [_shape(Marker.SPHERE, size, pose)]
        elif kind in (kinds["mjGEOM_CYLINDER"], kinds["mjGEOM_CAPSULE"]):
            made = [_shape(Marker.CYLINDER, size[[0, 0, 1]], pose)]
        elif kind == kinds["mjGEOM_MESH"]:
            made = [_mesh(model, int(model.geom_dataid[i]), pose)]
        if kind == kinds["mjGEOM_CAPSULE"]:
            for end in (-size[1] / 2, size[1] / 2):
                cap = pose @ placed(np.array([0, 0, end]), np.eye(3))
                made.append(_shape(Marker.SPHERE, np.repeat(size[0], 3), cap))
        material = int(model.geom_matid[i])
        colour = model.geom_rgba[i] if material < 0 else model.mat_rgba[material]
        for marker in made:
            marker.header = Header(frame_id=frames[body])
            marker.color = ColorRGBA(**dict(zip("rgba", map(float, colour), strict=True)))
            marker.frame_locked = True
            shapes.append(marker)
    for number, marker in enumerate(shapes):
        marker.ns, marker.id = "robot", number
    return MarkerArray(markers=[Marker(action=Marker.DELETEALL), *shapes])


def _in_body(robot: RobotModel, body: int, geometry: int) -> Array:
    data = robot.data
    pose = placed(data.geom_xpos[geometry], data.geom_xmat[geometry])
    return np.asarray(np.linalg.inv(robot.pose(body)) @ pose)


def _shape(kind: int, size: Array, pose: Array) -> Marker:
    return Marker(type=kind, pose=to_pose(pose), scale=to_vector(size))


def _mesh(model: Any, mesh: int, pose: Array) -> Marker:
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    corners = model.mesh_vert[int(model.mesh_vertadr[mesh]) :]
    marker = _shape(Marker.TRIANGLE_LIST, np.ones(3), pose)
    faces = model.mesh_face[first : first + count].ravel()
    marker.points = [to_point(corner) for corner in corners[faces]]
    return marker
