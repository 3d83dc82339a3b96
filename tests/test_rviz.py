"""The Display in a real rviz2: beside other displays, in its frame, with and without a sidecar."""

from __future__ import annotations

import itertools
import math
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from rosplat_testing import PATIENCE
from rviz_harness import (
    Rviz,
    World,
    blue,
    centre,
    configuration,
    disc,
    far_disc,
    green,
    map_display,
    needs_rviz,
    red,
)

pytestmark = needs_rviz


def test_splats_and_markers_hide_each_other(rviz: Rviz, world: World) -> None:
    world.place(0)
    world.cube(z=1.0)  # seen from above: before the splat
    world.map.replace(disc((1, 0, 0)))
    screen = rviz.until(lambda s: red(s).sum() > 3000 and green(s).sum() > 3000)
    cube = centre(green(screen)).astype(int)
    assert green(screen)[cube[0], cube[1]]
    world.cube(z=-1.0)  # behind it
    rviz.until(lambda s: red(s)[cube[0], cube[1]])


def test_the_map_follows_its_frame(rviz: Rviz, world: World) -> None:
    world.map.replace(disc((1, 0, 0), x=1.0, sigma=0.2))
    time.sleep(3)
    assert not red(rviz.picture()).any(), "drawn although nobody knows where its frame is"
    world.place(0)
    before = centre(red(rviz.until(lambda s: red(s).sum() > 300)))
    world.place(1.0)
    moved = centre(red(rviz.until(lambda s: np.abs(centre(red(s)) - before).max() > 50))) - before
    assert np.abs(moved).max() == pytest.approx(100, abs=3)  # 1 m at 100 px/m
    world.place(0, yaw=math.pi)
    turned = centre(red(rviz.until(lambda s: np.abs(centre(red(s)) - before).max() > 150)))
    assert np.abs(turned - before).max() == pytest.approx(200, abs=3)


def test_a_map_far_from_its_origin_is_where_tf_puts_it(rviz: Rviz, world: World) -> None:
    """A map in the earth's frame and a robot's Fixed Frame: what cancels out is 4,500 km."""
    world.place(0.37)
    world.map.replace(disc((1, 0, 0), sigma=0.3))
    near = centre(red(rviz.until(lambda s: red(s).any())))
    world.map.replace(far_disc(world, 1.37, sigma=0.3))  # pixels are centimetres
    far = centre(red(rviz.until(lambda s: abs(centre(red(s)) - near).max() > 80)))
    assert far - near == pytest.approx([0, 100], abs=1)
    far_disc(world, 1.47)
    moved = centre(red(rviz.until(lambda s: abs(centre(red(s)) - far).max() > 5)))
    assert moved - far == pytest.approx([0, 10], abs=1)


def test_the_picture_outlives_its_sidecar(rviz: Rviz, world: World) -> None:
    """A near blue over a far red disc, whatever sorts and although the slots say otherwise."""
    from rosplat_core.splats import concatenate

    sorter = rviz.processes.node("rosplat_sorter", "sorter")
    world.place(0)
    world.map.replace(concatenate([disc((0, 0, 1), z=1.0, sigma=0.5), disc((1, 0, 0), sigma=0.8)]))
    spot = centre(blue(rviz.until(lambda s: blue(s).sum() > 3000))).astype(int)
    sorter.kill()
    sorter.wait()
    rviz.processes.forget(sorter)
    time.sleep(1)
    # An edit that no sidecar will ever sort: green in between.
    world.map.upsert(range(2, 3), disc((0, 1, 0), z=0.5, sigma=1.5))
    screen = rviz.until(lambda s: green(s).any())
    assert blue(screen)[spot[0], spot[1]]


def test_remapping_the_map_takes_the_others_along(tmp_path: Path) -> None:
    """A configuration of /gaussians shows a robot's map, sorted by the robot's sidecar."""
    import rclpy

    remap = ["--ros-args", "-r", "gaussians:=/robot/map"]
    rclpy.init()
    world = World(namespace="robot")
    rviz = Rviz(tmp_path, *remap, config=configuration(map_display(**{"Publish Camera": True})))
    try:
        rviz.processes.node("rosplat_sorter", "sorter", *remap)
        rviz.processes.node("rosplat_tools", "ply_publisher", *remap, "-p", "path:=procedural:100")
        rviz.until_status("Map", "Order", "Ok", "sidecar")
        world.spin_until(lambda: world.node.count_publishers("/robot/map/camera/pose"))
        assert "/robot/map/render" in dict(world.node.get_service_names_and_types())
    finally:
        rviz.close()
        world.close()
        rclpy.shutdown()


def test_orders_reach_the_display_through_shared_memory(rviz: Rviz, world: World) -> None:
    """So do those of the next sorter, when the first one is killed."""
    import rclpy

    from rosplat_msgs.msg import SplatOrder
    from rosplat_ros.qos import ORDER
    from rosplat_sorter.shared_orders import FOLDER

    shared: list[str] = []

    def on_order(order: SplatOrder) -> None:
        if order.encoding == SplatOrder.SHARED:
            shared.append(order.segment)

    world.node.create_subscription(SplatOrder, "gaussians/order", on_order, ORDER)
    world.place(0)
    world.map.replace(disc((1, 0, 0)))
    for _ in range(2):
        shared.clear()
        sorter = rviz.processes.node("rosplat_sorter", "sorter")
        deadline = time.monotonic() + PATIENCE
        while not shared:
            assert time.monotonic() < deadline, "all orders travel in messages"
            rclpy.spin_once(world.node, timeout_sec=0.1)
        rviz.until(lambda s: red(s).sum() > 3000)
        segment = FOLDER / shared[-1]
        assert segment.exists()
        sorter.kill()
        sorter.wait()
        rviz.processes.forget(sorter)
        assert segment.exists()
    rviz.processes.node("rosplat_sorter", "sorter")
    while segment.exists():
        assert time.monotonic() < deadline + 30, "a killed sorter's memory stays"
        time.sleep(0.1)
    assert "an order is dropped" not in rviz.processes.said("rviz2")


def test_a_growing_and_shrinking_map(rviz: Rviz, world: World) -> None:
    world.place(0)
    world.map.replace(disc((1, 0, 0), x=-1.0, sigma=0.2))
    rviz.until(lambda s: red(s).sum() > 300)
    world.map.upsert(range(1, 2), disc((0, 0, 1), x=1.0, sigma=0.2))
    rviz.until(lambda s: red(s).sum() > 300 and blue(s).sum() > 300)
    world.map.delete(range(1))
    rviz.until(lambda s: not red(s).any() and blue(s).sum() > 300)
    world.map.upsert(range(1), disc((0, 1, 0), x=-1.0, sigma=0.2))
    rviz.until(lambda s: green(s).sum() > 300 and blue(s).sum() > 300)


def test_garbage_does_not_end_rviz(rviz: Rviz, world: World) -> None:
    import rclpy

    from rosplat_msgs.msg import GaussianArray, SplatOrder, ViewCamera
    from rosplat_ros.qos import MAP, ORDER, VIEW

    garbage = world.node.create_publisher(GaussianArray, "gaussians", MAP)
    orders = world.node.create_publisher(SplatOrder, "gaussians/order", ORDER)
    world.place(0)
    for revision, message in enumerate(
        [
            GaussianArray(count=5),
            GaussianArray(count=5, positions=[math.nan] * 15, sh_degree=7),
            GaussianArray(operation=9),
            GaussianArray(operation=1, first_slot=2**32 - 1, count=2**32 - 1),
            GaussianArray(operation=2, count=2**32 - 1),
        ]
    ):
        message.map_id, message.revision = "garbage", revision + 1
        garbage.publish(message)
    views: list[ViewCamera] = []
    world.node.create_subscription(ViewCamera, "gaussians/view", views.append, VIEW)
    orders.publish(SplatOrder(view_id="nobody", map_id="?", slots=[2**32 - 1]))
    time.sleep(2)
    world.node.destroy_publisher(garbage)
    world.map.replace(disc((1, 0, 0)))
    rviz.until(lambda s: red(s).sum() > 3000)
    while not views:
        rclpy.spin_once(world.node, timeout_sec=0.1)
    for fields in (
        {"slots": [2**32 - 1]},
        {"encoding": 9},
        {"encoding": SplatOrder.PACKED, "count": 2**32 - 1, "slot_bits": 32},
        {"encoding": SplatOrder.PACKED, "count": 3, "slot_bits": 0, "packed": [1] * 3},
        {"encoding": SplatOrder.PACKED, "count": 1, "slot_bits": 8, "packed": [255]},
        {"encoding": SplatOrder.SHARED, "count": 2**32 - 1, "segment": "rosplat_order_x"},
        {"encoding": SplatOrder.SHARED, "count": 1, "segment": "../../etc/passwd"},
        {"encoding": SplatOrder.SHARED, "count": 1, "segment": "x" * 1_000_000},
    ):
        orders.publish(
            SplatOrder(
                view_id=views[-1].view_id, sequence=views[-1].sequence, map_id=world.map.map_id,
                revision=world.map.revision, backend="garbage", **fields,
            )
        )  # fmt: skip
        time.sleep(0.2)  # or the next would displace it
    world.map.replace(disc((0, 0, 1)))
    rviz.until(lambda s: blue(s).sum() > 3000)
    assert "an order is dropped" in rviz.processes.said("rviz2")


@pytest.mark.skipif(not shutil.which("xdotool"), reason="no xdotool to click with")
def test_mouse_tools_touch_the_splats(rviz: Rviz, world: World) -> None:
    """Publish Point lands on the disc, 0.7 m above the ground, not in the void behind it."""
    import rclpy
    from geometry_msgs.msg import PointStamped

    tool = "{Class: rviz_default_plugins/PublishPoint, Topic: {Value: /clicked_point}}"
    rviz.load(configuration(map_display(), tools=tool))
    points: list[PointStamped] = []
    world.node.create_subscription(PointStamped, "/clicked_point", points.append, 10)
    world.place(0)
    world.map.replace(disc((1, 0, 0), x=0.5, z=0.7, sigma=0.3))
    screen = rviz.until(lambda s: red(s).sum() > 1000)
    row, column = centre(red(screen)).astype(int)
    deadline = time.monotonic() + PATIENCE
    while not points and time.monotonic() < deadline:
        rviz.click(row, column)
        for _ in range(20):
            rclpy.spin_once(world.node, timeout_sec=0.05)
    assert points, "nothing was touched"
    assert points[-1].header.frame_id == "map"
    assert points[-1].point.x == pytest.approx(0.5, abs=0.03)
    assert points[-1].point.y == pytest.approx(0.0, abs=0.03)
    assert points[-1].point.z == pytest.approx(0.7, abs=0.02)


def test_the_quality_of_service_of_the_topic_can_be_edited(rviz: Rviz, world: World) -> None:
    """A best effort publisher beside another is heard once the properties say so."""
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Header

    from rosplat_msgs.msg import GaussianArray
    from rosplat_testing.messages import encode

    assert rviz.properties("Map", "Topic") == {
        "Depth": 1000,
        "History Policy": "Keep Last",
        "Reliability Policy": "Reliable",
        "Durability Policy": "Transient Local",
    }
    world.place(0)
    qos = QoSProfile(
        depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE
    )
    publisher = world.node.create_publisher(GaussianArray, "gaussians", qos)
    splat = disc((1, 0, 0))

    def publish(revision: int) -> None:
        header = Header(frame_id=world.frame)
        operation = GaussianArray.REPLACE
        publisher.publish(
            encode(
                splat, range(1), header=header, map_id="m", revision=revision, operation=operation
            )
        )

    rviz.until_status("Map", "Topic", "Warn", "best effort", "Reliability Policy")
    publish(1)
    time.sleep(1)
    assert not red(rviz.picture()).any()
    rviz.set("Map", "Topic", "Reliability Policy", value="Best Effort")
    rviz.set("Map", "Topic", "Durability Policy", value="Volatile")
    revisions = itertools.count(2)
    rviz.until(lambda s: publish(next(revisions)) or red(s).sum() > 3000)
    world.node.destroy_publisher(publisher)
