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

import numpy as np
from PIL import Image as Picture
from rclpy.executors import ExternalShutdownException

from rosplat_core.program.files import replacing
from rosplat_core.program.output import say, told
from rosplat_core.splats import SceneError
from rosplat_msgs.msg import ViewCamera
from rosplat_ros.program.running import run, spinning
from rosplat_ros.view_cameras import view_camera
from rviz_gaussian_plugin.offscreen import ensure_display
from rviz_gaussian_plugin.viewer.node import QUIET, Viewer, described
from rviz_gaussian_plugin.viewer.orbit import OrbitCamera

STILL = (1280, 720)
ORBIT = (480, 270)
ORBIT_FRAMES = 36
ORDER_TIMEOUT = 2.0  # how long a still waits for a sorter's order [s]
MOVING, RESTING = 2, 33  # longest between two looks at what a window shows: it changes or not [ms]
CAPTION = 0.5  # between two captions of the window [s]
AGES = {"order_age", "picture_age", "camera_off", "draw_time"}  # differ though the picture doesn't
BACKGROUND = (0.125, 0.133, 0.149)  # as in the shipped rviz configuration


def _framed(viewer: Viewer) -> OrbitCamera:
    centre, radius = viewer.bounds()
    up = np.array(viewer.up, np.float64)
    return OrbitCamera(target=centre, distance=2.5 * radius, up=up)


def _wait_for_map(viewer: Viewer) -> None:
    discovered = time.monotonic() + QUIET
    while not viewer.complete():
        if not viewer.context.ok():
            raise ExternalShutdownException
        topic = viewer.resolve_topic_name("gaussians")
        if time.monotonic() > discovered and not viewer.count_publishers(topic):
            viewer.get_logger().info(f"waiting for a map on {topic}", once=True)
        viewer.renderer.upload()
        time.sleep(0.05)


def show_stills(viewer: Viewer, folder: Path) -> None:
    """Writes demo.png and demo.webp, a turn around the map, and prints the figures of the still."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SceneError(f"parameter output: {folder}: {error.strerror}") from error
    _wait_for_map(viewer)
    orbit = _framed(viewer)
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


def show_window(viewer: Viewer) -> None:
    """A window: drag orbits, right or middle drag pans, the wheel zooms, R resets, Q ends."""
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    # SDL would show its window through OpenGL, and leave the renderer without its context.
    os.environ["SDL_FRAMEBUFFER_ACCELERATION"] = "0"
    try:
        import pygame
    except ImportError as error:
        raise RuntimeError("the window needs pygame: pip install pygame") from error

    pygame.display.init()
    window = pygame.display.set_mode(viewer.window_size, pygame.RESIZABLE)
    pygame.display.set_caption(
        "ROSplat: waiting for a map on " + viewer.resolve_topic_name("gaussians")
    )
    orbit, said = _framed(viewer), 0.0
    framed = False  # until the map is whole, or the user has moved the camera
    shown: tuple[object, ...] = ()
    seen: dict[str, object] = {}  # what the report says of the picture in the window
    pause = MOVING
    camera, view_id, figures, closed = ViewCamera(), "", "", False
    try:
        while viewer.context.ok() and not closed:
            if not framed and viewer.renderer.splats:
                orbit, framed = _framed(viewer), viewer.complete()
            events = [pygame.event.wait(pause), *pygame.event.get()]
            for event in events:
                if event.type == pygame.QUIT or (
                    event.type == pygame.KEYDOWN and event.key in (pygame.K_q, pygame.K_ESCAPE)
                ):
                    closed = True
                elif event.type == pygame.KEYDOWN and event.key == pygame.K_r:
                    orbit, framed = _framed(viewer), False
                elif event.type == pygame.MOUSEWHEEL:
                    framed = viewer.renderer.splats > 0
                    orbit.zoom(0.9**event.y)
                elif event.type == pygame.MOUSEMOTION and any(event.buttons):
                    framed = viewer.renderer.splats > 0
                    right, down = (part / window.get_height() for part in event.rel)
                    if event.buttons[0]:
                        orbit.turn(4 * right, 4 * down)
                    else:
                        orbit.pan(right, down)
            width, height = window.get_size()
            state = (*orbit.target, orbit.distance, orbit.yaw, orbit.pitch, width, height)
            moved = state != shown
            if moved:
                shown = state
                camera = view_camera(orbit.camera(width, height))
                view_id = viewer.look(camera, "window")
            report = viewer.draw_frame(view_id, camera)
            figures = described(viewer.renderer.splats, report)
            picture = {name: value for name, value in report.items() if name not in AGES}
            changed = moved or picture != seen
            waits = report["splats"] and not report["order_fresh"]  # a better picture is on its way
            pause = MOVING if changed or waits else RESTING
            captioned = time.monotonic() - said > CAPTION
            # Any event: a part of the window may have come into sight. With each caption: a report
            # doesn't tell all changes, such as a further part of a batch.
            if changed or captioned or any(event.type != pygame.NOEVENT for event in events):
                seen = picture
                pixels = viewer.renderer.read_color8(BACKGROUND)
                image = pygame.image.frombuffer(pixels.tobytes(), (width, height), "RGB")
                window.blit(image, (0, 0))
                pygame.display.flip()
            if captioned:
                said = time.monotonic()
                pygame.display.set_caption(f"ROSplat: {figures}")
    finally:
        pygame.display.quit()
    if figures:
        say(figures)


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
