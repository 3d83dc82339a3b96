"""Prints what an issue about drawing needs: the graphics driver, and what the renderer makes of it.

`ros2 run rviz_gaussian_plugin graphics_report > report.txt`. Needs an X display, or Xvfb.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import platform
import sys

import numpy as np
from numpy.typing import NDArray

from rosplat_core import rendering
from rosplat_core.cameras import orbit
from rosplat_core.program.output import say
from rosplat_core.scenes import PROCEDURAL, load_scene
from rviz_gaussian_plugin.offscreen import Renderer, ensure_display

VIEW = "graphics report"
SIZE = (320, 240)  # of the pictures that are compared [px]

# Numbers of the OpenGL registry.
STRINGS = {"vendor": 0x1F00, "renderer": 0x1F01, "version": 0x1F02, "GLSL": 0x8B8C}
LIMITS = {
    "storage buffer [bytes]": 0x90DE,
    "storage buffers of a compute shader": 0x90DB,
    "storage buffers of a vertex shader": 0x90D6,
    "shared memory of a work group [bytes]": 0x8262,
    "invocations of a work group": 0x90EB,
    "texture width [px]": 0x0D33,
    "samples": 0x8D57,
}
SUBGROUPS = {"width": 0x9532, "stages": 0x9533, "features": 0x9534}
EXTENSIONS, EXTENSION_COUNT = 0x1F03, 0x821D


def main(arguments: list[str] | None = None) -> int:
    """Prints the report. Returns 1, and says why, where nothing can be drawn."""
    parser = argparse.ArgumentParser(prog="graphics_report", description=__doc__)
    parser.parse_known_args(arguments)  # ros2 run may add its own
    try:
        with ensure_display():
            say("\n".join(report(Renderer())))
    except RuntimeError as error:
        print(f"graphics_report: {error}", file=sys.stderr)
        return 1
    return 0


def report(renderer: Renderer) -> list[str]:
    """Lines on the machine, on OpenGL, and on pictures of a small scene by each rasteriser."""
    lines = [
        f"system: {platform.platform()}, {len(os.sched_getaffinity(0))} cores",
        f"session: {os.environ.get('XDG_SESSION_TYPE', 'unknown')}",
        *_opengl(),
    ]
    splats = load_scene(f"{PROCEDURAL}20000", lambda _: None, lambda _: None)
    rendering.insert_all(renderer, splats)
    bounds = np.stack([splats.positions.min(axis=0), splats.positions.max(axis=0)]) + splats.origin
    camera = orbit(bounds, 8, width=SIZE[0], height=SIZE[1])[0]
    renderer.set_camera(VIEW, 1, *rendering.pose(camera))
    lines += ["", "pictures, against the processor's:"]
    truth = rendering.render(splats, camera)
    for name in rendering.Rasterizer.__members__:
        settings = type(renderer.settings)()
        settings.rasterizer = rendering.Rasterizer.__members__[name]
        renderer.settings = settings
        lines.append(f"  {name.lower()}: {_drawn(renderer, truth)}")
    return lines


def _opengl() -> list[str]:
    """What the driver says of the current context."""
    library = ctypes.CDLL("libGL.so.1")
    library.glGetString.restype = library.glGetStringi.restype = ctypes.c_char_p

    def number(name: int) -> str:
        value = ctypes.c_int64(-1)
        library.glGetInteger64v(name, ctypes.byref(value))
        return str(value.value) if library.glGetError() == 0 else "unknown"

    lines = [f"{what}: {(library.glGetString(n) or b'').decode()}" for what, n in STRINGS.items()]
    lines += [f"most {what}: {number(name)}" for what, name in LIMITS.items()]
    count = number(EXTENSION_COUNT)
    names = sorted(
        (library.glGetStringi(EXTENSIONS, index) or b"").decode()
        for index in range(int(count) if count.isdecimal() else 0)
    )
    if "GL_KHR_shader_subgroup" in names:
        lines += [f"subgroups, {what}: {number(name)}" for what, name in SUBGROUPS.items()]
    else:
        lines.append("subgroups: none")
    return [*lines, f"extensions: {' '.join(names)}"]


def _drawn(renderer: Renderer, truth: NDArray[np.float32]) -> str:
    """Which way a picture was drawn, and how far it is off."""
    try:
        drawn = renderer.draw(VIEW, sort_now=True)
    except RuntimeError as error:
        return str(error)
    off = float(np.mean((renderer.read_color() - truth) ** 2))
    accuracy = "equal" if off == 0 else f"{-10 * np.log10(off):.0f} dB"
    way = f"{drawn['rasterizer']}, order of {drawn['order_source']}, {accuracy}"
    return "; ".join(text for text in (way, renderer.error, renderer.warning) if text)
