"""The renderer without rviz: draws a map into memory, on the GPU or in software."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera
from rosplat_core.rendering import RenderSettings, insert_all, posed
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


class CardRenderer(_offscreen.CardRenderer):  # type: ignore[misc]
    """Holds a map and draws it on the graphics card, over bodies that a SplatCamera draws there.

    One in a process, in any thread: threads that draw wait for one another. Needs EGL with OpenGL
    4.4, and no display; else raises RuntimeError.
    """

    settings: RenderSettings
    """How pictures are drawn."""
    device: str
    """What draws, by OpenGL's name."""
    context: Any
    """Of OpenGL, current within `with`: what is drawn there need not be read."""

    def __init__(self, splats: Splats) -> None:
        check_splats(splats)
        super().__init__(str(_media_folder()))
        self._beside: list[Any] = []
        insert_all(self.add_map(), splats)

    def beside(self) -> Any:
        """Another map, empty, which is in all pictures from now on."""
        self._beside.append(self.add_map())
        return self._beside[-1]

    def over(
        self, camera: Camera, below: int | None = None, *, beside: Sequence[Any] = ()
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.bool_]]:
        """As of Renderer. below: a framebuffer of the context, whose first row is the bottom, and
        whose window depths are 1 where the camera's `near` is and 0 at its `far`. beside: all maps
        that beside() made."""
        if list(beside) != self._beside:
            raise ValueError("a CardRenderer draws all of its maps: one SplatCamera has `riding`")
        colour, depth, surface = self.draw(posed(camera), below or 0)
        return colour, depth, surface


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
