"""A viewer without rviz2: a node around the renderer that the rviz Display draws with.

With a display it opens a window to orbit in; without one it draws a still and a short orbit. With
`serve` it draws what others ask for at `gaussians/render` (RenderView) instead, as the rviz Display
does if told to.
"""

from __future__ import annotations

import math
import os
import time
from pathlib import Path

from PIL import Image as Picture
from rclpy.executors import ExternalShutdownException

from rosplat_core.program.files import replacing
from rosplat_core.program.output import say, told
from rosplat_core.splats import InputError
from rosplat_ros.program.running import run, spinning
from rosplat_ros.view_cameras import view_camera
from rviz_gaussian_plugin.offscreen import ensure_display
from rviz_gaussian_plugin.viewer.node import QUIET, Viewer, described
from rviz_gaussian_plugin.viewer.window import BACKGROUND, framed, show_window

STILL = (1280, 720)
ORBIT = (480, 270)
ORBIT_FRAMES = 36
ORDER_TIMEOUT = 2.0  # how long a still waits for a sorter's order [s]


def _wait_for_map(viewer: Viewer) -> None:
    topic = viewer.resolve_topic_name("gaussians")
    discovered = time.monotonic() + QUIET
    while not viewer.complete():
        if not viewer.context.ok():
            raise ExternalShutdownException
        if time.monotonic() > discovered and not viewer.count_publishers(topic):
            viewer.get_logger().info(f"waiting for a map on {topic}", once=True)
        viewer.renderer.upload()
        time.sleep(0.05)
    # The first view is offered before the map, but may be received after it.
    received = time.monotonic() + QUIET
    while viewer.first_view is None and time.monotonic() < received:
        if not viewer.count_publishers(f"{topic}/first_view"):
            break
        time.sleep(0.05)


def show_stills(viewer: Viewer, folder: Path) -> None:
    """Writes demo.png and demo.webp, a turn around the map, and prints the figures of the still."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"parameter output: {folder}: {error.strerror}") from error
    _wait_for_map(viewer)
    orbit = framed(viewer, *STILL)
    report = viewer.draw_still(view_camera(orbit.camera(*STILL)), "still", ORDER_TIMEOUT)
    figures = described(viewer.renderer.splats, report)
    still = Picture.fromarray(viewer.renderer.read_color8(BACKGROUND))
    with replacing(folder / "demo.png") as partial:
        still.save(partial, "PNG")
    frames = []
    for _ in range(ORBIT_FRAMES):
        viewer.draw_still(view_camera(orbit.camera(*ORBIT)), "orbit", ORDER_TIMEOUT)
        frames.append(Picture.fromarray(viewer.renderer.read_color8(BACKGROUND)))
        orbit.turn(2 * math.pi / ORBIT_FRAMES, 0)
    turn = {"save_all": True, "append_images": frames[1:], "duration": 80, "loop": 0, "quality": 60}
    with replacing(folder / "demo.webp") as partial:
        frames[0].save(partial, "WEBP", **turn)
    say(figures)
    say(f"wrote {folder / 'demo.png'} and {folder / 'demo.webp'}")


def serve(viewer: Viewer) -> None:
    """Draws pictures for others until it is told to end."""
    while viewer.context.ok():
        try:
            viewer.renderer.upload()
        except (RuntimeError, MemoryError) as error:  # each request is answered with the reason
            viewer.get_logger().error(told(error), throttle_duration_sec=5.0)
        viewer.serve_request(wait=0.1)


def main(_arguments: list[str] | None = None) -> int:
    """Runs the node with ROS's arguments; the exit code is 1 where it can't draw."""
    run("viewer", _view)
    return 0


def _view() -> None:
    has_screen = bool(os.environ.get("DISPLAY"))
    with ensure_display():
        viewer = Viewer()
        try:
            with spinning(viewer, threads=4):
                if viewer.serves:
                    serve(viewer)
                elif viewer.output or not has_screen:
                    show_stills(viewer, Path(viewer.output or "out"))
                else:
                    show_window(viewer)
        finally:
            del viewer.renderer  # while its display is there
