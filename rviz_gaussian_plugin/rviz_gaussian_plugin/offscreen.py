"""The renderer without rviz: draws a map into memory, on the GPU or in software."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera
from rosplat_core.rendering import RenderSettings, insert_all, pose
from rosplat_core.splats import Splats, check_splats
from rosplat_ros.program.processes import end_with_parent
from rviz_gaussian_plugin import _offscreen  # type: ignore[attr-defined]
from rviz_gaussian_plugin._config import OGRE_PLUGINS


class Renderer(_offscreen.Renderer):  # type: ignore[misc]
    """An Ogre scene that holds one map and draws it into a texture.

    One in a process; all calls but `apply`, `set_order` and `read_order` must come from the thread
    that made it. Needs an X display (`ensure_display`) with OpenGL 2.1, else raises RuntimeError.
    """

    def __init__(self) -> None:
        if not os.environ.get("DISPLAY"):
            raise RuntimeError("the renderer needs an X display: DISPLAY is not set")
        super().__init__(str(_media_folder()), OGRE_PLUGINS)


class CardRenderer:
    """Holds a map and draws it on the graphics card, for a SplatCamera as for one's own pictures.

    One in a process, in any thread: threads that draw wait for one another. Where there is no card,
    the processor draws. Needs an X display (`ensure_display`), else raises RuntimeError.
    """

    def __init__(self, splats: Splats) -> None:
        check_splats(splats)
        # Else NVIDIA's GLX keeps its EGL, by which MuJoCo draws bodies, out of this process.
        os.environ.setdefault("__GLVND_DISALLOW_PATCHING", "1")
        self._thread = ThreadPoolExecutor(1, "card")  # OpenGL is one thread's
        self._renderer: Renderer = self._thread.submit(Renderer).result()
        self.settings: RenderSettings = self._renderer.settings
        self.settings.depths = True
        """How pictures are drawn."""
        self.device: str = self._renderer.renderer_info
        """What draws, by OpenGL's name."""
        self._beside: list[Any] = []
        self._drawn = 0
        insert_all(self._renderer, splats)

    def beside(self) -> Any:
        """Another map, empty, which is in all pictures from now on."""
        self._beside.append(self._thread.submit(self._renderer.add_map).result())
        return self._beside[-1]

    def picture(
        self,
        camera: Camera,
        *,
        scene_depth: NDArray[np.float32] | None = None,
        beside: Sequence[Any] = (),
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Premultiplied RGBA (height, width, 4), and the mean depths of splats (height, width)
        along the camera's z [m], NaN where there is none.

        scene_depth: (height, width) depths of opaque objects [m], inf where there is none, which
        hide the splats behind them. beside: all maps that beside() made.
        """
        if list(beside) != self._beside:
            raise ValueError("a CardRenderer draws all of its maps: one SplatCamera has `riding`")
        return self._thread.submit(self._draw, camera, scene_depth).result()

    def _draw(
        self, camera: Camera, scene_depth: NDArray[np.float32] | None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        self._drawn += 1
        self._renderer.set_camera("picture", self._drawn, *pose(camera))
        self._renderer.upload(all=True)
        self._renderer.draw("picture", sort_now=True, scene_depth=scene_depth)
        return self._renderer.read_color(), self._renderer.read_depth()

    def close(self) -> None:
        """Frees what OpenGL holds. There are no pictures afterwards."""
        self._thread.submit(self._free).result()
        self._thread.shutdown()

    def _free(self) -> None:
        del self._renderer, self._beside, self.settings


def _media_folder() -> Path:
    """Where the shaders are installed: beside the packages of the same prefix."""
    for parent in Path(__file__).resolve().parents:
        media = parent / "share" / "rviz_gaussian_plugin" / "ogre_media"
        if media.is_dir():
            return media
    raise RuntimeError("the shaders of rviz_gaussian_plugin are not installed")


@contextlib.contextmanager
def ensure_display(width: int = 1920, height: int = 1080) -> Iterator[str]:
    """Gives the process an X display: the one in DISPLAY, else an Xvfb for as long as the block.

    Raises RuntimeError where there is neither a display nor Xvfb.
    """
    if os.environ.get("DISPLAY"):
        yield os.environ["DISPLAY"]
        return
    if not shutil.which("Xvfb"):
        raise RuntimeError("there is no X display and no Xvfb to make one: install xvfb")
    read, write = os.pipe()
    server = subprocess.Popen(
        [
            "Xvfb",
            "-displayfd",
            str(write),
            "-screen",
            "0",
            f"{width}x{height}x24",
            "-nolisten",
            "tcp",
            "-noreset",  # clients that come during a reset, after the last one left, fail
        ],
        pass_fds=[write],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C ends the program first, then its display
        preexec_fn=end_with_parent,
    )
    os.close(write)
    try:
        with os.fdopen(read) as pipe:
            number = pipe.readline().strip()
        if not number:
            raise RuntimeError("Xvfb did not start")
        os.environ["DISPLAY"] = f":{number}"
        yield os.environ["DISPLAY"]
    finally:
        os.environ.pop("DISPLAY", None)
        server.terminate()
        server.wait()
