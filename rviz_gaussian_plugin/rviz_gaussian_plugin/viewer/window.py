"""The viewer's window: a map to orbit around, and what the user should know of it meanwhile."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.program.output import say, told
from rosplat_msgs.msg import ViewCamera
from rosplat_ros.view_cameras import view_camera
from rviz_gaussian_plugin.viewer.node import Viewer, described
from rviz_gaussian_plugin.viewer.orbit import OrbitCamera

BACKGROUND = (0.125, 0.133, 0.149)  # as in the shipped rviz configuration
TEXT = (220, 220, 220)
FONT = 26  # height [px]
MOVING, RESTING = 2, 33  # longest between two looks at what a window shows: it changes or not [ms]
CAPTION = 0.5  # between two captions of the window [s]
MOST_PIXELS = 8_300_000  # of a picture, 4K; a larger window shows it enlarged
AGES = {"order_age", "picture_age", "camera_off", "draw_time"}  # differ though the picture doesn't
# That the key U stands the map upright by, besides what its publisher tells.
VERTICALS = ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (0.0, 1.0, 0.0))


def framed(viewer: Viewer, width: int, height: int) -> OrbitCamera:
    """The camera to begin with, in a window of width x height.

    It is the publisher's offer, or sees the bulk of the map.
    """
    if viewer.first_view is not None:
        return OrbitCamera.of(viewer.first_view, width, height)
    return OrbitCamera.around(*viewer.bounds(), np.array(viewer.up, np.float64), width, height)


def picture_size(width: int, height: int) -> tuple[int, int]:
    """The size of the picture for a window: of one pixel at least, and of MOST_PIXELS. [px]"""
    width, height = max(width, 1), max(height, 1)
    shrunk = min(1.0, (MOST_PIXELS / (width * height)) ** 0.5)
    return max(int(width * shrunk), 1), max(int(height * shrunk), 1)


def show_window(viewer: Viewer) -> None:
    """A window: drag orbits, right or middle drag pans, the wheel zooms; R, U and Q are keys.

    R shows the first view again, U stands the map upright in another way, Q ends.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    # SDL would show its window through OpenGL, and leave the renderer without its context.
    os.environ["SDL_FRAMEBUFFER_ACCELERATION"] = "0"
    try:
        import pygame
    except ImportError as error:
        raise RuntimeError("the window needs pygame: pip install pygame") from error
    window = _Window(viewer, pygame)
    try:
        while viewer.context.ok() and not window.closed:
            window.step()
    finally:
        pygame.display.quit()
    if window.figures:
        say(window.figures)


class _Window:
    """What is on the screen, and where its camera is."""

    def __init__(self, viewer: Viewer, pygame: Any) -> None:
        self._viewer, self._pygame = viewer, pygame
        pygame.display.init()
        pygame.font.init()
        pygame.display.set_mode(viewer.window_size, pygame.RESIZABLE)
        self._font = pygame.font.Font(None, FONT)
        self.closed, self.figures = False, ""
        self._orbit = framed(viewer, *self._size())
        self._framed_by: object = None  # the first view, or True: the map is whole, or the user
        self._verticals = 0  # how many were tried
        self._shown: tuple[object, ...] = ()  # camera and size of the picture
        self._seen: tuple[object, ...] = ()  # what else is in the window
        self._camera, self._view_id = ViewCamera(), ""
        self._said = 0.0
        self._pause = MOVING

    def step(self) -> None:
        """Waits a moment for events, and shows what has changed."""
        events = [self._pygame.event.wait(self._pause), *self._pygame.event.get()]
        self._fit()
        for event in events:
            self._handle(event)
        try:
            self._show(any(event.type != self._pygame.NOEVENT for event in events))
        except (RuntimeError, MemoryError, self._pygame.error) as error:
            # A window that the driver or the X server can't fill now; the next may be another one.
            self._viewer.get_logger().error(told(error), throttle_duration_sec=5.0)
            self._seen, self._pause = (), RESTING

    def _size(self) -> tuple[int, int]:
        return picture_size(*self._pygame.display.get_window_size())

    def _fit(self) -> None:
        """Frames the map until it is whole or the user moves, and when its publisher offers how."""
        view = self._viewer.first_view
        if view is not None and self._framed_by is not view:
            if self._viewer.renderer.splats:
                self._orbit, self._framed_by = framed(self._viewer, *self._size()), view
        elif self._framed_by is None and self._viewer.renderer.splats:
            self._orbit = framed(self._viewer, *self._size())
            self._framed_by = True if self._viewer.complete() else None

    def _handle(self, event: Any) -> None:
        pygame = self._pygame
        if event.type == pygame.QUIT or (
            event.type == pygame.KEYDOWN and event.key in (pygame.K_q, pygame.K_ESCAPE)
        ):
            self.closed = True
        elif event.type == pygame.KEYDOWN and event.key == pygame.K_r:
            self._orbit = framed(self._viewer, *self._size())
            self._framed_by = self._viewer.first_view
        elif event.type == pygame.KEYDOWN and event.key == pygame.K_u:
            self._orbit = OrbitCamera.around(
                *self._viewer.bounds(), self._next_vertical(), *self._size()
            )
            self._moved()
        elif event.type == pygame.MOUSEWHEEL:
            self._moved()
            self._orbit.zoom(0.9**event.y)
        elif event.type == pygame.MOUSEMOTION and any(event.buttons):
            self._moved()
            height = max(pygame.display.get_window_size()[1], 1)
            right, down = (part / height for part in event.rel)
            if event.buttons[0]:
                self._orbit.turn(4 * right, 4 * down)
            else:
                self._orbit.pan(right, down)

    def _moved(self) -> None:
        if self._viewer.renderer.splats and self._framed_by is None:
            self._framed_by = True

    def _next_vertical(self) -> NDArray[np.float64]:
        """Another vertical than the present one."""
        while True:
            up = np.array(VERTICALS[self._verticals % len(VERTICALS)])
            self._verticals += 1
            if up @ self._orbit.up < 0.999 * np.linalg.norm(self._orbit.up):
                return up

    def _show(self, wanted: bool) -> None:
        """Draws, and fills the window where something has changed, or it is wanted."""
        viewer = self._viewer
        width, height = self._size()
        orbit = self._orbit
        state = (*orbit.target, *orbit.up, orbit.distance, orbit.yaw, orbit.pitch, width, height)
        moved = state != self._shown
        if moved:
            self._camera = view_camera(orbit.camera(width, height))
            self._view_id = viewer.set_camera(self._camera, "window")
            self._shown = state
        report = viewer.draw_frame(self._view_id, self._camera)
        self.figures = described(viewer.renderer.splats, report)
        notice = viewer.progress()
        seen = (notice, {name: value for name, value in report.items() if name not in AGES})
        changed = moved or seen != self._seen
        waits = report["splats"] and not report["order_fresh"]  # a better picture is on its way
        self._pause = MOVING if changed or waits else RESTING
        captioned = time.monotonic() - self._said > CAPTION
        # Any event: a part of the window may have come into sight. With each caption: a report
        # doesn't tell all changes, such as a further part of a batch.
        if changed or captioned or wanted:
            self._seen = seen
            self._fill(viewer.renderer.read_color8(BACKGROUND), notice)
        if captioned:
            self._said = time.monotonic()
            self._pygame.display.set_caption(f"ROSplat: {notice or self.figures}")

    def _fill(self, pixels: NDArray[np.uint8], notice: str) -> None:
        """Puts a picture (height, width, 3) into the window, and a notice below its middle."""
        surface = self._pygame.display.get_surface()
        height, width = pixels.shape[:2]
        image = self._pygame.image.frombuffer(pixels.tobytes(), (width, height), "RGB")
        if surface.get_size() != (width, height):
            image = self._pygame.transform.scale(image, surface.get_size())
        surface.blit(image, (0, 0))
        if notice:
            text = self._font.render(notice, True, TEXT)
            middle, low = surface.get_width() // 2, int(0.9 * surface.get_height())
            if not self._viewer.renderer.splats:
                low = surface.get_height() // 2
            surface.blit(text, text.get_rect(center=(middle, low)))
        self._pygame.display.flip()
