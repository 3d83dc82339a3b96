"""Several maps in one rviz2: one order for all of their splats, and each as its display says."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import numpy as np
import pytest

from rosplat_core.generated import generate
from rosplat_core.splats import concatenate
from rosplat_lab.metrics import psnr
from rosplat_msgs.msg import ViewCamera
from rosplat_ros.qos import VIEW
from rviz_harness import (
    Rviz,
    World,
    centre,
    configuration,
    disc,
    green,
    map_display,
    needs_rviz,
    red,
)

pytestmark = needs_rviz

# How displays have that draw which the Status names.
BY: dict[str, dict[str, object]] = {
    "processor": {"Rasterizer": "Processor"},
    "gpu": {"Rasterizer": "Tiles", "Order Source": "Auto"},
}


@pytest.fixture
def other(world: World) -> Iterator[World]:
    """Another robot's map."""
    other = World(frame=f"{world.frame}_other", namespace="other")
    yield other
    other.close()


def both(**properties: object) -> str:
    """Maps as two displays show them."""
    return map_display(**properties) + map_display("Other", "/other/gaussians", **properties)


def red_and_green(rviz: Rviz) -> Iterator[tuple[int, ...]]:
    """Row and column of what is red, and of what is green, once both are seen."""
    picture = rviz.until(lambda s: red(s).sum() > 300 and green(s).sum() > 300)
    return (tuple(map(int, centre(colour(picture)))) for colour in (red, green))


@pytest.mark.parametrize("by", BY)
def test_each_splat_is_where_it_is_whosever_it_is(
    rviz: Rviz, world: World, other: World, by: str
) -> None:
    """Seen from above: red over green over blue, of which the green one is another map's."""
    rviz.load(configuration(both(**BY[by])))

    def seen(red: float, green: float, blue: float) -> None:
        def found(picture: np.ndarray) -> bool:
            row, column = picture.shape[0] // 2, picture.shape[1] // 2
            pixels = picture[row - 3 : row + 4, column - 3 : column + 4]
            return bool((np.abs(pixels - 255 * np.array([red, green, blue])) < 4).all())

        rviz.until(found)

    world.place()
    other.place()
    below = disc((0, 0, 1), opacity=0.6)
    world.map.replace(concatenate([disc((1, 0, 0), z=2.0, opacity=0.6), below]))
    other.map.replace(disc((0, 1, 0), z=1.0, opacity=0.6))
    seen(0.6, 0.24, 0.096)
    rviz.until_status("Other", "Order", "Ok", f"1 splats by {by}", "in one order with 1 other")
    if by == "gpu":  # as everywhere, these tests have no card
        rviz.until_status("Other", "Frame", "Warn", "no graphics card draws")
    other.place(z=2.0)
    seen(0.24, 0.6, 0.096)
    world.place(z=-4.0)
    seen(0.24, 0.6, 0.096)
    other.place(z=-4.0)
    seen(0.6, 0.24, 0.096)

    rviz.set("Other", "Alpha", value=0.5)
    seen(0.6, 0.4 * 0.3, 0.4 * 0.7 * 0.6)
    rviz.set("Map", "Draw Mode", value="Flat Ball")
    seen(1, 0, 0)
    rviz.set("Map", value=False)
    seen(0, 0.3, 0)
    rviz.set("Map", value=True)
    seen(1, 0, 0)


@pytest.mark.parametrize("by", BY)
def test_two_maps_look_like_the_map_of_all_their_splats(
    rviz: Rviz, world: World, other: World, by: str
) -> None:
    view = "{Class: rviz_default_plugins/Orbit, Distance: 3}"
    rviz.load(configuration(both(**BY[by]), view=view))
    splats = generate(20000)
    half = np.arange(len(splats)) % 2 == 0
    world.place()
    other.place()
    world.map.replace(splats)
    rviz.until_status("Map", "Order", "Ok", f"by {by}, fresh")
    rviz.until(lambda s: s.max() > 100)
    whole = rviz.until_still()
    rviz.set("Map", value=False)
    rviz.until(lambda s: s.max() < 20)
    world.map.replace(splats[half])
    other.map.replace(splats[~half])
    rviz.set("Map", value=True)
    rviz.until(lambda s: psnr(s / 255, whole / 255) > 55)


@pytest.mark.skipif(not shutil.which("xdotool"), reason="no xdotool to click with")
@pytest.mark.parametrize("by", BY)
def test_a_click_selects_what_is_seen_whosever_it_is(
    rviz: Rviz, world: World, other: World, by: str
) -> None:
    from rosplat_msgs.msg import Gaussian

    rviz.load(configuration(both(**BY[by]), tools="{Class: rviz_default_plugins/Select}"))
    picked: list[tuple[str, int]] = []
    for topic in ("/gaussians/picked", "/other/gaussians/picked"):
        world.node.create_subscription(
            Gaussian, topic, lambda m: picked.append((m.header.frame_id, m.slot)), 100
        )
    world.place()
    other.place()
    hidden, beside = disc((0, 0, 1), x=1, sigma=0.2), disc((0, 1, 0), x=-1, sigma=0.2)
    world.map.replace(concatenate([hidden, beside]))
    elsewhere = disc((1, 1, 1), x=50)
    other.map.replace(concatenate([elsewhere] * 2 + [disc((1, 0, 0), x=1, z=1, sigma=0.3)]))

    of_red, of_green = red_and_green(rviz)
    rviz.click(*of_red)
    world.spin_until(lambda: picked)
    assert picked == [(other.frame, 2)]
    picked.clear()
    rviz.click(*of_green)
    world.spin_until(lambda: picked)
    assert picked == [(world.frame, 1)]
    picked.clear()
    rviz.drag((of_green[0] - 30, of_green[1] - 30), (of_red[0] + 30, of_red[1] + 30))
    world.spin_until(lambda: len(picked) == 2)
    assert set(picked) == {(other.frame, 2), (world.frame, 1)}


@pytest.mark.skipif(not shutil.which("xdotool"), reason="no xdotool to click with")
@pytest.mark.parametrize("by", BY)
def test_what_is_selected_of_a_map_goes_with_its_display(
    rviz: Rviz, world: World, other: World, by: str
) -> None:
    rviz.load(configuration(both(**BY[by]), tools="{Class: rviz_default_plugins/Select}"))
    world.place()
    other.place()
    world.map.replace(disc((0, 1, 0), x=-1, sigma=0.2))
    elsewhere = disc((1, 1, 1), x=50)
    other.map.replace(concatenate([elsewhere, disc((1, 0, 0), x=1, sigma=0.2)]))

    def selected(*slots: int) -> None:
        def found() -> bool:
            tree = rviz.ask("tree", path=[], root="selection")["children"]
            return sorted(splat["name"] for splat in tree) == [f"Slot {slot}" for slot in slots]

        world.spin_until(found)

    right, left = red_and_green(rviz)
    rviz.drag((left[0] - 30, left[1] - 30), (right[0] + 30, right[1] + 30))
    selected(0, 1)
    rviz.drag(left, (left[0] + 1, left[1] + 1), hold="ctrl")
    selected(1)
    rviz.drag(left, (left[0] + 1, left[1] + 1), hold="shift")
    selected(0, 1)
    rviz.set("Other", value=False)
    selected(0)
    rviz.click(left[0] - 150, left[1])  # the void
    selected()


def test_sorters_are_asked_for_orders_of_a_map_that_is_alone(
    rviz: Rviz, world: World, other: World
) -> None:
    asked: list[int] = []
    world.node.create_subscription(
        ViewCamera, "/gaussians/view", lambda view: asked.append(view.sequence), VIEW
    )
    rviz.load(configuration(both(**{"Order Source": "Sidecar"})))
    for each in (world, other):
        each.place()
        each.map.replace(disc((1, 0, 0)))
    world.spin_until(lambda: bool(asked) and asked[-1] == 0)
    rviz.set("Other", value=False)
    world.spin_until(lambda: asked[-1] > 0)
    rviz.set("Other", value=True)
    world.spin_until(lambda: asked[-1] == 0)
