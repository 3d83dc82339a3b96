"""MuJoCo's own pictures of a model: what bodies look like, how far they are, and which is where.

How it works. The camera is MuJoCo's (lens, resolution, pose), but for its clip distances. One
pass of MuJoCo's renderer gives colours and window depths; bodies take one before it, in colours
that are numbers. Window depths are floats and reversed, so that depths are right to float32 at any
distance. Nothing softens an edge: a pixel is of one surface, that of its centre. So shadows,
reflections, fog, sky and multisampling are off, and what is translucent is opaque. Sites, and
geometries of the groups 3 to 5, MuJoCo's place for what collides, are not drawn.
"""

from __future__ import annotations

import os
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera
from rosplat_core.log_text import shown
from rosplat_tools.simulation.physics import load_mujoco

MOST_GEOMETRIES = 10_000  # of a scene
SLICES = 96  # of what is round
OPTICAL = np.diag([1.0, -1.0, -1.0])  # MuJoCo's cameras look along -z, and y is up


class NoGL(RuntimeError):
    """Nothing here draws with OpenGL; the text says why."""


@dataclass(frozen=True, eq=False)
class BodyPicture:
    """What a camera sees of a model; (height, width, ...) each."""

    seen: tuple[NDArray[np.uint8], NDArray[np.float32]] | int
    """RGB, black where nothing is, and depths along the camera's z [m], inf where nothing is; or
    the framebuffer of the given context that they are in, as Renderer.over() takes it."""
    bodies: NDArray[np.uint16] | None
    """Numbers of bodies, 0 where nothing is, and of the world's own; None if not asked for."""


class BodyPictures:
    """Draws a model without a window, by EGL or OSMesa, in any thread, but in one at a time."""

    def __init__(self, model: Any, width: int, height: int, context: Any = None) -> None:
        """width, height: of the first pictures [px]. context: of OpenGL, current within `with`, in
        which to leave pictures; None: they are read. Raises NoGL, naming what lacks."""
        self._mjr: Any = None
        self._mj, self._model = load_mujoco(), model
        self._size = width, height
        self._option = self._mj.MjvOption()
        self._option.sitegroup[:] = 0
        self._option.flags[self._mj.mjtVisFlag.mjVIS_RANGEFINDER] = False  # rays, as lines
        self._scene = self._mj.MjvScene(model, maxgeom=MOST_GEOMETRIES)
        for flag in ("SHADOW", "REFLECTION", "SKYBOX", "FOG", "HAZE"):
            self._scene.flags[getattr(self._mj.mjtRndFlag, f"mjRND_{flag}")] = False
        self._shared, self._own = context, None if context else _open(width, height)
        try:
            with self._current():
                self._mjr = self._mj.MjrContext(
                    _plain(model, width, height), self._mj.mjtFontScale.mjFONTSCALE_100
                )
        except Exception as error:  # of MuJoCo, PyOpenGL or the driver
            self._free()
            raise NoGL(shown(error, 300)) from error
        self._mjr.readDepthMap = self._mj.mjtDepthMap.mjDEPTH_ZEROFAR

    def draw(self, data: Any, camera: int, lens: Camera, *, bodies: bool = False) -> BodyPicture:
        """What a camera of the model sees, drawn as by `lens`, which camera_of() made of it."""
        with self._current():  # between pictures, other threads may have it
            return self._draw(data, camera, lens, bodies)

    def _current(self) -> Any:
        return self._own.as_current() if self._own else self._shared

    def _draw(self, data: Any, camera: int, lens: Camera, bodies: bool) -> BodyPicture:
        size = lens.width, lens.height
        self._mj.mjr_setBuffer(self._mj.mjtFramebuffer.mjFB_OFFSCREEN, self._mjr)
        if size != self._size:
            self._mj.mjr_resizeOffscreen(*size, self._mjr)
            self._size = size
        every = self._mj.mjtCatBit.mjCAT_ALL
        self._mj.mjv_updateScene(
            self._model, data, self._option, None, _fixed(camera), every, self._scene
        )
        for eye in self._scene.camera:
            scale = 1 if eye.orthographic else lens.near / eye.frustum_near
            for side in ("center", "width", "bottom", "top"):
                name = f"frustum_{side}"
                setattr(eye, name, scale * getattr(eye, name))
            eye.frustum_near, eye.frustum_far = lens.near, lens.far
        for geometry in self._scene.geoms[: self._scene.ngeom]:
            geometry.rgba[3] = 1
        view = self._mj.MjrRect(0, 0, *size)
        numbers = self._bodies(view) if bodies else None
        self._mj.mjr_render(view, self._scene, self._mjr)
        if self._shared:
            return BodyPicture(int(self._mjr.offFBO), numbers)
        colour = np.empty((lens.height, lens.width, 3), np.uint8)
        window = np.empty((lens.height, lens.width), np.float32)
        self._mj.mjr_readPixels(colour, window, view, self._mjr)
        return BodyPicture((colour[::-1], _depth(window[::-1], lens)), numbers)

    def _bodies(self, view: Any) -> NDArray[np.uint16]:
        flags = self._mj.mjtRndFlag
        coding = [int(flags.mjRND_SEGMENT), int(flags.mjRND_IDCOLOR)]
        coded = np.empty((view.height, view.width, 3), np.uint8)
        self._scene.flags[coding] = True
        try:
            self._mj.mjr_render(view, self._scene, self._mjr)
            self._mj.mjr_readPixels(coded, None, view, self._mjr)
        finally:
            self._scene.flags[coding] = False
        drawn = self._scene.geoms[: self._scene.ngeom]
        of_code = np.zeros(max((geometry.segid for geometry in drawn), default=-1) + 2, np.uint16)
        for geometry in drawn:
            if geometry.objtype == self._mj.mjtObj.mjOBJ_GEOM and geometry.segid >= 0:
                of_code[geometry.segid + 1] = self._model.geom_bodyid[geometry.objid]
        codes = np.zeros((view.height, view.width, 4), np.uint8)
        codes[..., :3] = coded[::-1]
        return np.asarray(of_code[codes.view("<u4")[..., 0]])

    def close(self) -> None:
        """Frees what the driver holds."""
        if self._mjr:
            with self._current():  # names of objects are another's in another context
                self._mjr.free()
            self._mjr = None
            self._free()

    def _free(self) -> None:
        if self._own:
            self._own.free()

    def __del__(self) -> None:
        """Frees it, too."""
        with suppress(RuntimeError):  # at the interpreter's end, MuJoCo ends EGL first
            self.close()


def camera_of(
    model: Any, data: Any, camera: int, width: int, height: int, near: float, far: float
) -> Camera:
    """A camera of a model as it is now, in pixels [px] and between distances [m]."""
    mj = load_mujoco()
    scene, through = mj.MjvScene(model, maxgeom=1), _fixed(camera)
    mj.mjv_updateCamera(model, data, through, scene)
    eye = scene.camera[0]
    half = eye.frustum_width or width / height * (eye.frustum_top - eye.frustum_bottom) / 2
    tall = eye.frustum_top - eye.frustum_bottom
    reach = 1.0 if eye.orthographic else eye.frustum_near
    if eye.orthographic:  # window depths are linear then, and coarse for a far away end
        far = min(far, eye.frustum_far)
    pose = np.eye(4)
    pose[:3, :3] = data.cam_xmat[camera].reshape(3, 3) @ OPTICAL
    pose[:3, 3] = data.cam_xpos[camera]
    return Camera(
        camera, width, height, fx=width / 2 * reach / half, fy=height * reach / tall,
        cx=width / 2 * (1 - eye.frustum_center / half),
        cy=height / 2 * (1 + (eye.frustum_top + eye.frustum_bottom) / tall),
        world_to_camera=np.asarray(np.linalg.inv(pose)), orthographic=bool(eye.orthographic),
        near=near, far=far,
    )  # fmt: skip


def _fixed(camera: int) -> Any:
    """What MuJoCo calls a camera that the model has."""
    fixed = load_mujoco().MjvCamera()
    fixed.type, fixed.fixedcamid = load_mujoco().mjtCamera.mjCAMERA_FIXED, camera
    return fixed


def _depth(window: NDArray[np.float32], lens: Camera) -> NDArray[np.float32]:
    near, far = lens.near, lens.far
    if lens.orthographic:
        depth = (far - window.astype(np.float64) * (far - near)).astype(np.float32)
        depth[window <= 0] = np.inf
        return depth
    depth = window * np.float32((far - near) / (near * far))
    depth += np.float32(1 / far)
    np.divide(1, depth, out=depth, where=window > 0)
    depth[window <= 0] = np.inf
    return depth


def _plain(model: Any, width: int, height: int) -> Any:
    """A copy of a model for a context: buffers of that size, one sample a pixel, no shadows, and
    balls that are round."""
    plain = copy(model)
    quality, buffers = plain.vis.quality, plain.vis.global_
    quality.offsamples = quality.shadowsize = 0
    quality.numslices, quality.numstacks = SLICES, SLICES // 2
    buffers.offwidth, buffers.offheight = width, height
    return plain


def _open(width: int, height: int) -> Any:
    """A context of OpenGL without a window: MUJOCO_GL's, or else the first that there is."""
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    reasons = []
    for name in (wanted,) if wanted in ("egl", "osmesa") else ("egl", "osmesa"):
        try:
            return _library(name).GLContext(width, height)
        except Exception as error:  # of PyOpenGL, ctypes or the driver: they have no common one
            reasons.append(f"{name}: {shown(error, 150)}")
    raise NoGL("; ".join(reasons) + " (Debian: libegl1 libgl1-mesa-dri, or libosmesa6)")


def _library(name: str) -> ModuleType:
    if name == "egl":
        import mujoco.egl as library
    else:
        import mujoco.osmesa as library
    found: ModuleType = library
    return found
