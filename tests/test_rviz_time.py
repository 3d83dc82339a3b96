"""Frames and time in a real rviz2: as its other displays, the map is where TF has it now."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rviz_harness import (
    Rviz,
    World,
    blue,
    centre,
    configuration,
    disc,
    map_display,
    needs_rviz,
    red,
)

pytestmark = needs_rviz


def red_at(picture: np.ndarray, x: float) -> bool:
    """The disc is x metres right of the middle."""
    mask = red(picture)
    return mask.sum() > 300 and abs(centre(mask)[1] - picture.shape[1] / 2 - 100 * x) < 5


def test_a_moving_frame(rviz: Rviz, world: World) -> None:
    world.map.replace(disc((1, 0, 0), sigma=0.2))

    def there(picture: np.ndarray, x: float) -> bool:
        world.place(x=x, stamp=world.node.get_clock().now().to_msg())
        return red_at(picture, x)

    for x in [-1.0, -0.5, 0.0, 0.5, 1.0]:
        rviz.until(functools.partial(there, x=x))
    # In a frame that is as the map is, the map stands still and the fixed frame moves.
    rviz.set("Global Options", "Fixed Frame", value=world.frame)
    rviz.until(lambda s: red_at(s, 0))
    rviz.set("Global Options", "Fixed Frame", value="nowhere")
    rviz.until(lambda s: not red(s).any())
    rviz.until_status("Map", "Transform", "Error", "nowhere")
    rviz.set("Global Options", "Fixed Frame", value="map")
    rviz.until(lambda s: red_at(s, 1))
    rviz.until_status("Map", "Transform", "Ok")


def test_a_stamp_that_tf_does_not_have(rviz: Rviz, world: World) -> None:
    """A map is no measurement of a moment: it is drawn where its frame is now, however old."""
    from builtin_interfaces.msg import Time
    from std_msgs.msg import Header

    from rosplat_msgs.msg import GaussianArray
    from rosplat_ros.qos import MAP
    from rosplat_testing.messages import encode

    now = world.node.get_clock().now().to_msg()

    def there(picture: np.ndarray, seen: Callable[[np.ndarray], np.ndarray]) -> bool:
        world.place(x=1.0, stamp=now)
        return seen(picture).sum() > 300

    publisher = world.node.create_publisher(GaussianArray, "/stamped", MAP)
    rviz.load(configuration(map_display(topic="/stamped")))
    for revision, (stamp, colour) in enumerate(
        [(Time(sec=1), (1, 0, 0)), (Time(sec=now.sec + 10_000), (0, 0, 1))], start=1
    ):
        batch = encode(
            disc(colour, x=0.5, sigma=0.2),
            range(1),
            header=Header(frame_id=world.frame, stamp=stamp),
            map_id="stamped",
            revision=revision,
            operation=GaussianArray.REPLACE,
        )
        publisher.publish(batch)
        seen = red if colour[0] else blue
        picture = rviz.until(functools.partial(there, seen=seen))
        assert centre(seen(picture))[1] - picture.shape[1] / 2 == pytest.approx(150, abs=5)
        rviz.until_status("Map", "Transform", "Ok")


class Bag:
    """/clock and the map's frame, which moves 0.5 m a second: what playing a bag publishes."""

    def __init__(self, world: World) -> None:
        from rosgraph_msgs.msg import Clock

        self._world, self._message = world, Clock()
        self._clock = world.node.create_publisher(Clock, "/clock", 10)
        self.time, self.rate = 0.0, 1.0
        self._timer = world.node.create_timer(0.02, self._tick)

    def _tick(self) -> None:
        from builtin_interfaces.msg import Time

        self.time += 0.02 * self.rate
        stamp = Time(sec=1000 + int(self.time), nanosec=int(self.time % 1 * 1e9))
        self._message.clock = stamp
        self._clock.publish(self._message)
        if self.rate:
            self._world.place(x=self.x, stamp=stamp)

    @property
    def x(self) -> float:
        return 0.5 * self.time - 2


def test_time_that_stops_and_loops(tmp_path: Path, world: World) -> None:
    """use_sim_time, and a bag that is paused and starts over."""
    sim_time = ["--ros-args", "-p", "use_sim_time:=true"]
    rviz = Rviz(tmp_path, *sim_time, config=configuration(map_display()))
    try:
        bag = Bag(world)
        world.map.replace(disc((1, 0, 0), sigma=0.2))

        def shown(x: float) -> bool:
            mask = red(picture := rviz.picture())
            if mask.sum() < 300:
                return False
            return abs(centre(mask)[1] - picture.shape[1] / 2 - 100 * x) < 30

        world.spin_until(lambda: bag.time > 2 and shown(bag.x))
        bag.rate = 0.0
        paused = time.monotonic()
        world.spin_until(lambda: time.monotonic() - paused > 3)
        world.spin_until(lambda: shown(bag.x))
        for _ in range(3):
            bag.rate = 1.0
            reached = bag.time + 1
            world.spin_until(lambda: bag.time > reached and shown(bag.x))  # noqa: B023
            bag.time = 0.0
            world.spin_until(lambda: bag.time > 1 and shown(bag.x))
        rviz.until_status("Map", "Transform", "Ok")
        rviz.until_status("Map", "Topic", "Ok")
    finally:
        rviz.close()


def test_several_maps(rviz: Rviz, world: World) -> None:
    """Two displays of one map, a third of another: each with its own settings and Status."""
    other = World(frame=world.frame, namespace="other")
    world.place()
    rviz.load(
        configuration(
            map_display("A", Alpha=1),
            map_display("B", **{"Draw Mode": "Flat Ball"}),
            map_display("C", topic="/other/gaussians"),
        )
    )
    world.map.replace(disc((1, 0, 0), x=-1, sigma=0.2))
    other.map.replace(disc((0, 0, 1), x=1, sigma=0.2))
    rviz.until(lambda s: red(s).sum() > 300 and blue(s).sum() > 300)
    both = red(rviz.picture()).sum()
    for name in "ABC":
        rviz.until_status(name, "Map", "Ok", "1 splats")
    rviz.set("B", value=False)
    rviz.until(lambda s: 300 < red(s).sum() < both)
    rviz.set("A", value=False)
    rviz.until(lambda s: not red(s).any() and blue(s).sum() > 300)
    rviz.set("A", value=True)
    rviz.set("C", value=False)
    rviz.until(lambda s: red(s).sum() > 300 and not blue(s).any())
    other.close()
