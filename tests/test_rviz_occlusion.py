"""Splats among the other displays of rviz2: what is nearer hides what is farther."""

from __future__ import annotations

import numpy as np
import pytest

from rosplat_core.splats import concatenate
from rviz_harness import (
    MARKERS,
    TOP,
    Rviz,
    World,
    configuration,
    disc,
    display,
    latched,
    map_display,
    needs_rviz,
    red,
)

pytestmark = needs_rviz

URDF = """<robot name="cube"><link name="cube"><visual><geometry><box size="1 1 1"/></geometry>
<material name="m"><color rgba="0 1 0 1"/></material></visual></link></robot>"""


def middle(picture: np.ndarray) -> np.ndarray:
    """What is seen in the middle of the view, where everything is put."""
    row, column = picture.shape[0] // 2, picture.shape[1] // 2
    return picture[row - 3 : row + 4, column - 3 : column + 4]


def cloud(world: World, z: float):
    """Green points, dense enough to hide what is below."""
    from sensor_msgs.msg import PointCloud2, PointField

    x, y = np.meshgrid(np.linspace(-0.3, 0.3, 61), np.linspace(-0.3, 0.3, 61))
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1).astype(np.float32)
    message = PointCloud2(height=1, width=x.size, point_step=12, row_step=12 * x.size)
    message.header.frame_id = "map"
    message.fields = [
        PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
        for i, name in enumerate("xyz")
    ]
    message.data = points.tobytes()
    publisher = world.node.create_publisher(PointCloud2, "/cloud", world.latched)
    publisher.publish(message)


def robot(world: World) -> None:
    from std_msgs.msg import String

    publisher = world.node.create_publisher(String, "/robot_description", world.latched)
    publisher.publish(String(data=URDF))


DISPLAYS = {
    "points": display(
        "PointCloud2",
        "Points",
        **{
            "Topic": latched("/cloud"),
            "Style": "Flat Squares",
            "Size (m)": 0.03,
            "Color Transformer": "FlatColor",
            "Color": "0; 255; 0",
        },
    ),
    "robot": display("RobotModel", "Robot", **{"Description Topic": latched("/robot_description")}),
    "marker": MARKERS,
    "grid": display(
        "Grid",
        "Grid",
        **{
            "Color": "0; 255; 0",
            "Alpha": 1,
            "Line Style": {"Value": "Billboards", "Line Width": 0.2},
            "Plane Cell Count": 2,
        },
    ),
    "axes": display("Axes", "Axes", Length=1.0, Radius=0.2),
}


@pytest.mark.parametrize("what", list(DISPLAYS))
def test_opaque_things(rviz: Rviz, world: World, what: str) -> None:
    """At z = 0: a red splat above hides it, one below is hidden by it."""
    if what == "points":
        cloud(world, 0.0)
    elif what == "robot":
        robot(world)
        world.place(frame="cube")
    elif what == "marker":
        world.cube(z=0.0)
    rviz.load(configuration(DISPLAYS[what], map_display()))

    def theirs(picture: np.ndarray) -> bool:
        seen = middle(picture)
        return bool((seen.max(axis=2) > 90).all() and not red(seen).any())

    world.place(z=2.0)
    world.map.replace(disc((1, 0, 0)))
    rviz.until(lambda s: red(middle(s)).all())
    world.place(z=-2.0)
    rviz.until(theirs)
    world.place(z=2.0)
    rviz.until(lambda s: red(middle(s)).all())


VIEWS = {
    "orthographic": TOP,
    "perspective": "{Class: rviz_default_plugins/Orbit, Distance: 8, Pitch: 1.57, Yaw: 0}",
}


@pytest.mark.parametrize("rasterizer", ["Processor", "Tiles"])
@pytest.mark.parametrize("view", list(VIEWS))
def test_translucent_markers(rviz: Rviz, world: World, view: str, rasterizer: str) -> None:
    """They colour what is behind them, and are coloured by what is before them."""
    rviz.load(configuration(MARKERS, map_display(Rasterizer=rasterizer), view=VIEWS[view]))
    world.place()

    def seen(*colour: int) -> None:
        rviz.until(lambda s: (np.abs(middle(s) - colour) < 12).all())

    world.map.replace(disc((1, 0, 0), opacity=0.5))
    world.cube(z=-2.0, alpha=0.5)
    seen(128, 64, 0)
    world.cube(z=2.0, alpha=0.5)
    seen(64, 128, 0)
    world.map.replace(disc((1, 0, 0)))
    seen(128, 128, 0)
    world.cube(z=-2.0, alpha=0.5)
    seen(255, 0, 0)
    world.cube(z=2.0, alpha=0.5, colour=(0, 0, 1), id=1)  # the other one stays hidden
    seen(128, 0, 128)
    world.cube(z=0.0, alpha=0.5)
    world.cube(z=0.0, alpha=0, id=1)
    world.map.replace(concatenate([disc((1, 0, 0), z=2.0, opacity=0.5), disc((0, 0, 1), z=-2.0)]))
    seen(128, 64, 64)


@pytest.mark.parametrize("rasterizer", ["Processor", "Tiles"])
def test_a_fine_grid_is_as_fine_before_splats(rviz: Rviz, world: World, rasterizer: str) -> None:
    """Its lines are as bright as before nothing, to the last sample of a pixel."""
    lines = {"Color": "0; 255; 0", "Alpha": 0.5, "Cell Size": 0.5}
    splats = map_display(Rasterizer=rasterizer)
    rviz.load(configuration(display("Grid", "Grid", **lines), splats))

    def inner(picture: np.ndarray) -> np.ndarray:
        row, column = picture.shape[0] // 2, picture.shape[1] // 2
        return picture[row - 80 : row + 80, column - 80 : column + 80]

    alone = inner(rviz.until(lambda s: s[..., 1].max() > 50))
    world.place(z=-2.0)
    world.map.replace(disc((1, 0, 0), sigma=9.0))
    before = inner(rviz.until(lambda s: red(inner(s)).mean() > 0.9))
    np.testing.assert_allclose(before[..., 1], alone[..., 1], atol=6)
    world.place(z=2.0)
    rviz.until(lambda s: red(inner(s)).all())
