"""What cameras of a MuJoCo model see: its bodies and a map of splats in one picture. Knows no ROS.

How it works. MuJoCo draws the bodies (body_pictures.py). The rasteriser blends the splats whose
centres are in front of a pixel's body, front to back, and what light is left shows the body: that
is exact for translucent splats on either side of a body, and for bodies within the map. Splats that
ride on a body are a group whose pose follows it, drawn in one order with the map.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core.cameras import Camera
from rosplat_core.quaternions import from_matrices
from rosplat_core.rendering import CpuRenderer, Renderer, insert_groups, move
from rosplat_core.rigid import placed, rigid
from rosplat_core.splats import Splats
from rosplat_tools.simulation.body_pictures import BodyPictures, NoGL, camera_of
from rosplat_tools.simulation.physics import load_mujoco

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SplatPicture:
    """What a camera sees of bodies and a map."""

    colour: NDArray[np.uint8]
    """(height, width, 3) RGB over black."""
    depth: NDArray[np.float32]
    """(height, width) along the camera's z [m]; inf where nothing takes half of the light."""
    bodies: NDArray[np.uint16] | None
    """(height, width) numbers of bodies, 0 for splats, the world, and nothing; None if not asked
    for."""
    camera: Camera
    """That took it, in MuJoCo's world."""


class SplatCamera:
    """Takes pictures with the cameras of a MuJoCo model that stands in a map.

    Threads that draw wait for one another. Environments of one model share a SplatCamera: each
    picture may be of another MjData.
    """

    def __init__(
        self,
        model: Any,
        data: Any,
        splats: Splats | Renderer,
        *,
        map_pose: ArrayLike | None = None,
        riding: Mapping[str, tuple[Splats, ArrayLike]] | None = None,
        width: int = 640,
        height: int = 360,
        near: float = 0.02,
        far: float = 1e4,
    ) -> None:
        """model, data: MjModel, and the MjData that pictures are of by default. splats: a map, or a
        renderer that holds one, which several SplatCameras may share. map_pose: (4, 4) the map's
        pose in MuJoCo's world [m].
        riding: by the name of a body, splats that move with it, and their pose (4, 4) in its frame.
        width, height: of pictures of cameras without a resolution of their own [px]. near, far:
        distances between which things are drawn [m].

        Where nothing draws with OpenGL, pictures are of the map alone, and `problem` says why.
        Raises ValueError for a pose that is none and a body that there is not, InputError where
        MuJoCo is not installed.
        """
        self._mj = load_mujoco()
        self._model, self._data = model, data
        self.renderer: Renderer = CpuRenderer(splats) if isinstance(splats, Splats) else splats
        self.map_pose = rigid(np.eye(4) if map_pose is None else map_pose, "map_pose")
        self.riders = Riders(model, riding or {}, self.renderer)
        """The splats that ride on bodies."""
        self._size, self._clip = (width, height), (near, far)
        self.problem = ""
        """Why bodies are not drawn; empty if they are."""
        self._drawing = Lock()
        self._bodies: BodyPictures | None = None
        try:
            self._bodies = BodyPictures(model, width, height, self.renderer.context)
        except NoGL as error:
            self.problem = str(error)

    def render(
        self, camera: int | str, data: Any = None
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Colours (height, width, 3) and depths (height, width) that a camera sees, as of
        SplatPicture. camera: its number or name. data: another MjData of the model. Raises
        ValueError for a camera that there is not, and data of another model."""
        picture = self.picture(camera, data)
        return picture.colour, picture.depth

    def picture(self, camera: int | str, data: Any = None, *, bodies: bool = False) -> SplatPicture:
        """As render(); bodies: also which body is where."""
        data = self._own(data)
        lens = self.camera(camera, data)
        in_map = Camera(**(vars(lens) | {"world_to_camera": lens.world_to_camera @ self.map_pose}))
        with self._drawing:
            solid = self._bodies.draw(data, lens.id, lens, bodies=bodies) if self._bodies else None
            colour, depth, surface = self.renderer.over(
                in_map,
                solid.seen if solid else None,
                beside=self.riders.at(data, self.map_pose),
            )
        numbers = None
        if bodies:
            numbers = np.zeros(depth.shape, np.uint16)
            if solid and solid.bodies is not None:
                numbers = np.where(surface, numbers, solid.bodies)
        return SplatPicture(colour, depth, numbers, lens)

    def camera(self, camera: int | str, data: Any = None) -> Camera:
        """A camera of the model, by its number or name, as it is now in MuJoCo's world."""
        data = self._own(data)
        number = camera
        if isinstance(camera, str):
            number = self._mj.mj_name2id(self._model, self._mj.mjtObj.mjOBJ_CAMERA, camera)
        if not isinstance(number, int) or not 0 <= number < self._model.ncam:
            names = ", ".join(self._model.camera(i).name for i in range(self._model.ncam))
            raise ValueError(f"camera '{camera}': the model has {names or 'none'}")
        own = self._model.cam_resolution[number].tolist()
        width, height = own if min(own) > 1 else self._size
        return camera_of(self._model, data, number, width, height, *self._clip)

    def _own(self, data: Any) -> Any:
        """The data, or the default ones. Raises ValueError for those of another model."""
        if data is not None and data.signature != self._model.signature:
            raise ValueError("data: expected an MjData of the SplatCamera's model")
        return self._data if data is None else data

    def close(self) -> None:
        """Frees what the graphics driver holds. Later pictures are of the map alone."""
        if self._bodies:
            self._bodies.close()
        self._bodies, self.problem = None, "closed"


class Riders:
    """Splats that ride on bodies of a MuJoCo model, each body's in a group of their own."""

    def __init__(
        self, model: Any, riding: Mapping[str, tuple[Splats, ArrayLike]], renderer: Renderer
    ) -> None:
        """riding: as of SplatCamera. renderer: draws them. Raises ValueError."""
        mj = load_mujoco()
        self._bodies: list[tuple[int, Array]] = []
        for name, (_, pose) in riding.items():
            body = mj.mj_name2id(model, mj.mjtObj.mjOBJ_BODY, name)
            if body < 0:
                raise ValueError(f"riding: the model has no body '{name}'")
            self._bodies.append((body, rigid(pose, f"riding['{name}']")))
        self._map = renderer.beside() if riding else None
        self._revision = insert_groups(self._map, [splats for splats, _ in riding.values()])

    def at(self, data: Any, map_pose: Array) -> list[Any]:
        """The maps to draw beside another, with their splats where the bodies are now.

        data: MjData. map_pose: (4, 4) the map's pose in MuJoCo's world [m].
        """
        if not self._map:
            return []
        self._revision += 1
        poses = {
            number: (*pose[:3, 3].tolist(), *from_matrices(pose[:3, :3]).tolist())
            for number, pose in self.poses(data, map_pose).items()
        }
        move(self._map, poses, self._revision)
        return [self._map]

    def poses(self, data: Any, map_pose: Array) -> dict[int, Array]:
        """By number, each one's pose (4, 4) in the map's frame. [m]"""
        from_world = np.linalg.inv(map_pose)
        return {
            number: from_world @ placed(data.xpos[body], data.xmat[body]) @ pose
            for number, (body, pose) in enumerate(self._bodies)
        }
