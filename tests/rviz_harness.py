"""rviz2 on a screen of its own, with a remote control: what the tests of the Display share.

It draws in software on every machine. Maps take a sidecar's orders where there are any.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rosplat_lab.driven_rviz import DrivenRviz, is_here
from rosplat_ros.program.processes import Processes
from rosplat_testing import PATIENCE

SCREEN = (1000, 800)
LOOK = 0.03  # between two looks [s]

needs_rviz = [
    pytest.mark.rviz,
    pytest.mark.skipif(not is_here(), reason="no rviz2: the Display is not tested"),
]

# 100 px/m, x to the right, y up; the point in view is the middle of the picture.
TOP = "{Class: rviz_default_plugins/TopDownOrtho, Scale: 100, X: 0, Y: 0, Angle: 0}"


def map_display(name: str = "Map", topic: str = "/gaussians", **properties: object) -> str:
    """A GaussianMap in an rviz configuration, which draws pictures for others, too."""
    serves = {"Render Service": True, "Order Source": "Sidecar"}
    return _display("rviz_gaussian_plugin/GaussianMap", name, Topic=topic, **(serves | properties))


def display(kind: str, name: str, **properties: object) -> str:
    """One of rviz's own displays in an rviz configuration."""
    return _display(f"rviz_default_plugins/{kind}", name, **properties)


def _display(class_id: str, name: str, **properties: object) -> str:
    entries = {"Class": class_id, "Name": name, "Enabled": True, "Value": True} | properties
    return f"    - {json.dumps(entries)}\n"


def latched(topic: str) -> dict[str, object]:
    """A Topic property that receives what was published before."""
    return {"Value": topic, "Durability Policy": "Transient Local", "Depth": 5}


MARKERS = display("Marker", "Marker", Topic=latched("/marker"))


def configuration(
    *displays: str, view: str = TOP, fixed_frame: str = "map", panels: str = "[]", tools: str = ""
) -> str:
    """The text of an .rviz file."""
    return f"""\
Panels: {panels}
Visualization Manager:
  Displays:
{"".join(displays)}
  Global Options: {{Fixed Frame: {fixed_frame}, Background Color: 0; 0; 0, Frame Rate: 30}}
  Tools: [{tools}]
  Views:
    Current: {view}
Window Geometry: {{Width: {SCREEN[0]}, Height: {SCREEN[1]}}}
"""


@contextlib.contextmanager
def own_screen() -> Iterator[str]:
    """A screen that no other program draws on, as a value of DISPLAY."""
    from rviz_gaussian_plugin.offscreen import ensure_display

    def leave(name: str | None) -> None:
        os.environ.pop("DISPLAY", None)
        if name:
            os.environ["DISPLAY"] = name

    before = os.environ.pop("DISPLAY", None)
    with ensure_display(*SCREEN) as name:
        leave(before)
        yield name
        before = os.environ.get("DISPLAY")
    leave(before)


class Rviz(DrivenRviz):
    """A running rviz2 on its screen, with a mouse."""

    def __init__(
        self, folder: Path, *arguments: str, config: str | None = None, **environment: str
    ) -> None:
        """Starts rviz2, with its logs in a folder, and waits until it can be driven."""
        self._screen = own_screen()
        self.screen_name = self._screen.__enter__()
        super().__init__(
            Processes(folder).__enter__(),
            config or configuration(),
            *arguments,
            DISPLAY=self.screen_name,
            **{"LIBGL_ALWAYS_SOFTWARE": "1"} | environment,
        )

    def close(self) -> None:
        """Ends rviz2 and its screen."""
        self.processes.end()
        self._screen.__exit__(None, None, None)

    def until_status(self, display: str, entry: str, level: str, *words: str) -> str:
        """Waits for an entry of a display's Status with a level and all of some words."""
        deadline = time.monotonic() + PATIENCE
        while True:
            status = self.status(display)
            found, text = status.get(entry, ("", ""))
            if found == level and all(word in text for word in words):
                return text
            assert time.monotonic() < deadline, f"{entry} is not {level} {words}: {status}"
            time.sleep(LOOK)

    # --- The screen -------------------------------------------------------------------------------

    def screen(self) -> np.ndarray:
        """(height, width, 3) the whole screen, as bytes."""
        from PIL import ImageGrab

        return np.asarray(ImageGrab.grab(xdisplay=self.screen_name).convert("RGB"))

    def picture(self, of: str = "view") -> np.ndarray:
        """(height, width, 3) what rviz's view shows, or a panel by its title, 0 to 255."""
        x, y, width, height = self.ask("places")[of]
        return self.screen()[y : y + height, x : x + width].astype(np.int32)

    def until(self, found: Callable[[np.ndarray], object], of: str = "view") -> np.ndarray:
        """The first picture in which something is found."""
        deadline = time.monotonic() + PATIENCE
        while True:
            self.processes.check()
            picture = self.picture(of)
            if found(picture):
                return picture
            if time.monotonic() > deadline:
                self.keep("not_seen.png")
                raise AssertionError(
                    f"not seen, {self.folder / 'not_seen.png'} was: "
                    + self.processes.said("rviz2")[-500:]
                )
            time.sleep(LOOK)

    def until_still(self, seconds: float = 1.5) -> np.ndarray:
        """The picture, once it has not changed for some seconds."""
        since, before = time.monotonic(), self.picture()

        def still(picture: np.ndarray) -> bool:
            nonlocal since, before
            if not np.array_equal(picture, before):
                since, before = time.monotonic(), picture
            return time.monotonic() - since > seconds

        return self.until(still)

    def keep(self, name: str) -> None:
        """Writes the screen into the folder of the logs, to look at."""
        from PIL import Image

        Image.fromarray(self.screen()).save(self.folder / name)

    def click(self, row: int, column: int) -> None:
        """Clicks into rviz's view."""
        self._mouse(*self._move_to(row, column), "click", "1")

    def point_at(self, row: int, column: int) -> None:
        """Moves the mouse over rviz's view."""
        self._mouse(*self._move_to(row, column))

    def drag(self, start: tuple[int, int], end: tuple[int, int], hold: str = "") -> None:
        """Drags from a row and column of rviz's view to others, a key held."""
        held = ["keydown", hold] if hold else []
        self._mouse(*held, *self._move_to(*start), "mousedown", "1")
        for part in (0.5, 1.0):  # rviz looks at moves, not at where a press began
            row, column = (round(a + part * (b - a)) for a, b in zip(start, end, strict=True))
            self._mouse(*self._move_to(row, column))
        self._mouse("mouseup", "1", *(["keyup", hold] if hold else []))

    @contextlib.contextmanager
    def held(self, key: str) -> Iterator[None]:
        """A key of the keyboard is down."""
        self._mouse("keydown", key)
        try:
            yield
        finally:
            self._mouse("keyup", key)

    def _move_to(self, row: int, column: int) -> list[str]:
        x, y, _, _ = self.ask("places")["view"]
        return ["mousemove", str(x + column), str(y + row)]

    def _mouse(self, *commands: str) -> None:
        subprocess.run(
            ["xdotool", *commands], env=os.environ | {"DISPLAY": self.screen_name}, check=True
        )


class World:
    """What rviz2 is fed with: a map in a frame of its own, transforms, markers."""

    def __init__(self, frame: str = "scene", namespace: str = "") -> None:
        """Nothing is published yet; the map's topic is <namespace>/gaussians."""
        from geometry_msgs.msg import TransformStamped
        from rclpy.node import Node
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from tf2_msgs.msg import TFMessage
        from visualization_msgs.msg import Marker

        from rosplat_ros.map_publisher import MapPublisher

        self.node = Node("world", namespace=namespace or None)
        self.frame = frame
        self.latched = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._tf = self.node.create_publisher(TFMessage, "/tf", 100)
        self._tf_static = self.node.create_publisher(TFMessage, "/tf_static", self.latched)
        self._marker = self.node.create_publisher(Marker, "/marker", self.latched)
        self._transform, self._marker_type, self._transforms = TransformStamped, Marker, TFMessage
        self.map = MapPublisher(self.node, frame_id=frame)

    def close(self) -> None:
        """Takes all of it away."""
        self.map.close()
        self.node.destroy_node()

    def place(
        self,
        x: float = 0.0,
        yaw: float = 0.0,
        *,
        z: float = 0.0,
        frame: str | None = None,
        parent: str = "map",
        stamp: Any = None,
    ) -> None:
        """Puts a frame (the map's) into another: for all time, or from a stamp on."""
        transform = self._transform()
        transform.header.frame_id, transform.child_frame_id = parent, frame or self.frame
        transform.transform.translation.x = x
        transform.transform.translation.z = z
        transform.transform.rotation.z = math.sin(yaw / 2)
        transform.transform.rotation.w = math.cos(yaw / 2)
        if stamp is not None:
            transform.header.stamp = stamp
        publisher = self._tf_static if stamp is None else self._tf
        publisher.publish(self._transforms(transforms=[transform]))

    def cube(
        self,
        z: float,
        x: float = 0.0,
        colour: tuple[float, float, float] = (0, 1, 0),
        alpha: float = 1.0,
        size: float = 1.0,
        id: int = 0,
    ) -> None:
        """A marker at y = 0."""
        cube = self._marker_type(type=self._marker_type.CUBE, id=id)
        cube.header.frame_id = "map"
        cube.pose.position.x, cube.pose.position.z = float(x), float(z)
        cube.pose.orientation.w = 1.0
        cube.scale.x = cube.scale.y = cube.scale.z = float(size)
        cube.color.r, cube.color.g, cube.color.b = map(float, colour)
        cube.color.a = float(alpha)
        self._marker.publish(cube)

    def spin_until(self, reached: Callable[[], object]) -> None:
        """Handles what arrives until something is reached."""
        import rclpy

        deadline = time.monotonic() + PATIENCE
        while not reached():
            assert time.monotonic() < deadline, "nothing arrived"
            rclpy.spin_once(self.node, timeout_sec=LOOK)


def disc(
    colour: tuple[float, float, float],
    x: float = 0.0,
    y: float = 0.0,
    z: float = 0.0,
    sigma: float = 1.0,
    opacity: float = 1.0,
) -> Any:
    """A splat, wide in x and y."""
    from rosplat_core.splats import Splats

    return Splats(
        positions=np.array([[x, y, z]], np.float32),
        orientations=np.array([[0, 0, 0, 1]], np.float32),
        scales=np.array([[sigma, sigma, 0.01]], np.float32),
        opacities=np.full(1, opacity, np.float32),
        sh=((np.array([[colour]], np.float32) - 0.5) / 0.28209479).astype(np.float32),
    )


def far_disc(world: World, x: float, yaw: float = 0.7, **of: Any) -> Any:
    """A disc 4,500 km from its frame's origin, the frame so that it lies at x of rviz2's."""
    distance = 4.5e6
    world.place(x - distance, yaw=yaw)
    origin = distance * np.array([math.cos(yaw), -math.sin(yaw), 0.0])
    return replace(disc((1, 0, 0), **of), origin=origin)


def red(picture: np.ndarray) -> np.ndarray:
    return (picture[..., 0] > 150) & (picture[..., 1] < 60) & (picture[..., 2] < 60)


def green(picture: np.ndarray) -> np.ndarray:
    return (picture[..., 1] > 100) & (picture[..., 0] < 60) & (picture[..., 2] < 60)


def blue(picture: np.ndarray) -> np.ndarray:
    return (picture[..., 2] > 150) & (picture[..., 0] < 60) & (picture[..., 1] < 60)


def centre(mask: np.ndarray) -> np.ndarray:
    """(row, column) of what is in a mask, NaN where nothing is."""
    return np.argwhere(mask).mean(axis=0) if mask.any() else np.full(2, np.nan)
