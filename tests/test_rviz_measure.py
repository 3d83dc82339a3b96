"""What rviz2 measures on the surface of splats: against the rooms that they were generated on."""

from __future__ import annotations

import re
import shutil
from typing import TYPE_CHECKING

import numpy as np
import pytest

from rosplat_core.generated import generate
from rosplat_core.generated.rooms import Rooms
from rviz_harness import Rviz, World, configuration, map_display, needs_rviz

if TYPE_CHECKING:
    from rosplat_msgs.msg import ViewCamera

pytestmark = [
    *needs_rviz,
    pytest.mark.skipif(not shutil.which("xdotool"), reason="no xdotool to click with"),
]

SPLATS, SEED = 500_000, 3
ACCURATE = 0.01  # share of the depth
PIXELS = 8  # that are looked at
AROUND = 12  # no edge is nearer [px]
INSIDE = """{Class: rviz_gaussian_plugin/Fly, Yaw: 0.7, Pitch: 0.35,
  Position: {X: -1.5, Y: -1.3, Z: 1.7}}"""


class Seen:
    """The surfaces of the rooms behind the pixels of rviz2's view, exactly."""

    def __init__(self, rviz: Rviz, world: World) -> None:
        from rosplat_msgs.msg import ViewCamera
        from rosplat_ros.poses import to_matrix

        height, width = rviz.picture().shape[:2]
        cameras: list[ViewCamera] = []
        hearing = world.node.create_subscription(ViewCamera, "gaussians/view", cameras.append, 100)
        world.spin_until(
            lambda: cameras and (cameras[-1].width, cameras[-1].height) == (width, height)
        )
        world.node.destroy_subscription(hearing)
        self.camera = cameras[-1]
        self.pose = to_matrix(self.camera.pose)
        self._low, self._high = Rooms(np.random.default_rng(SEED)).sides()

    def surface(self, row: float, column: float) -> tuple[int, float]:
        """Which rectangle a pixel shows, and its depth. [m]"""
        eye = self.pose[:3, 3]
        along = self.at(row, column, 1.0) - eye
        axis = (self._high - self._low).argmin(axis=1)  # across the rectangle
        one = np.arange(len(axis))
        with np.errstate(divide="ignore"):
            depths = (self._low[one, axis] - eye[axis]) / along[axis]
        points = eye + depths[:, None] * along
        points[one, axis] = self._low[one, axis]
        hit = ((points >= self._low) & (points <= self._high)).all(axis=1) & (depths > 0)
        depths[~hit] = np.inf
        return int(depths.argmin()), float(depths.min())

    def at(self, row: float, column: float, depth: float) -> np.ndarray:
        """Where in the map a pixel sees what is so deep. [m]"""
        camera = self.camera
        ray = [(column + 0.5 - camera.cx) / camera.fx, (row + 0.5 - camera.cy) / camera.fy, 1.0]
        return self.pose[:3, 3] + self.pose[:3, :3] @ (depth * np.array(ray))

    def seen_at(self, place: list[float]) -> tuple[float, float, float]:
        """Column and row of a place in the picture, and its depth. [px, m]"""
        camera = self.camera
        x, y, depth = self.pose[:3, :3].T @ (place - self.pose[:3, 3])
        column = camera.fx * x / depth + camera.cx - 0.5
        return column, camera.fy * y / depth + camera.cy - 0.5, depth

    def within_surfaces(self) -> list[tuple[int, int]]:
        """Rows and columns of pixels that are far from all edges."""
        random = np.random.default_rng(0)
        found: list[tuple[int, int]] = []
        while len(found) < PIXELS:
            row = int(random.integers(AROUND, self.camera.height - AROUND))
            column = int(random.integers(AROUND, self.camera.width - AROUND))
            around = {
                self.surface(row + down, column + across)[0]
                for down in (-AROUND, 0, AROUND)
                for across in (-AROUND, 0, AROUND)
            }
            if len(around) == 1 and np.isfinite(self.surface(row, column)[1]):
                found.append((row, column))
        return found


@pytest.fixture
def seen(rviz: Rviz, world: World, request: pytest.FixtureRequest) -> Seen:
    """Inside of the rooms, with a tool in hand."""
    tools = f"{{Class: rviz_default_plugins/{request.param}}}"
    rviz.load(configuration(map_display(), view=INSIDE, tools=tools))
    world.place()
    world.map.replace(generate(SPLATS, SEED, 0, scene="rooms"))
    rviz.until_status("Map", "Map", "Ok", f"{SPLATS} splats")
    rviz.until_still()
    return Seen(rviz, world)


@pytest.mark.parametrize("seen", ["Measure"], indirect=True)
def test_the_measure_tool_measures_between_surfaces(rviz: Rviz, seen: Seen) -> None:
    pixels = seen.within_surfaces()
    for start, end in zip(pixels[::2], pixels[1::2], strict=True):
        rviz.click(*start)
        rviz.click(*end)
        depths = [seen.surface(*pixel)[1] for pixel in (start, end)]
        expected = np.linalg.norm(seen.at(*start, depths[0]) - seen.at(*end, depths[1]))

        def measured(_: object) -> bool:
            length = re.search(r"Length: ([\d.]+)m", rviz.status_line())
            return bool(length and abs(float(length[1]) - expected) < ACCURATE * max(depths))  # noqa: B023

        rviz.until(measured)


@pytest.mark.parametrize("seen", ["Interact"], indirect=True)
def test_flying_says_what_is_under_the_cursor(rviz: Rviz, seen: Seen) -> None:
    for pixel in seen.within_surfaces():
        rviz.point_at(*pixel)

        def said(_: object) -> bool:
            found = re.match(r"\[(.*), (.*), (.*)\], depth ([\d.]+) m", rviz.status_line())
            if not found:
                return False
            *place, far = map(float, found.groups())
            column, row, depth = seen.seen_at(place)
            assert depth == pytest.approx(far, abs=0.003)
            assert abs(far / seen.surface(row, column)[1] - 1) < ACCURATE
            return bool(np.abs(np.subtract(pixel, (row, column))).max() < 2)  # noqa: B023

        rviz.until(said)
