"""rviz's Select tool on splats: what a click or a box selects, shows and publishes."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rosplat_core.splats import Splats, concatenate
from rviz_harness import (
    MARKERS,
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

pytestmark = [
    *needs_rviz,
    pytest.mark.skipif(not shutil.which("xdotool"), reason="no xdotool to click with"),
]

SELECT = "{Class: rviz_default_plugins/Select}"
ORBIT = (
    "{Class: rviz_default_plugins/Orbit, Distance: 5, Pitch: 0.6, Yaw: 0.3,"
    " Focal Point: {X: 0, Y: 0, Z: 0}}"
)


@pytest.fixture
def picked(rviz: Rviz, world: World) -> list[Any]:
    """The view from above with the Select tool; what /gaussians/picked says."""
    from rosplat_msgs.msg import Gaussian

    rviz.load(configuration(MARKERS, map_display(), tools=SELECT))
    messages: list[Any] = []
    world.node.create_subscription(Gaussian, "/gaussians/picked", messages.append, 100)
    world.place(0)
    return messages


def selection(rviz: Rviz) -> dict[str, dict[str, str]]:
    """What the Selection panel lists."""
    tree = rviz.ask("tree", path=[], root="selection")
    return {
        splat["name"]: {entry["name"]: entry["value"] for entry in splat["children"]}
        for splat in tree["children"]
    }


def until_selected(rviz: Rviz, world: World, expected: set[str]) -> None:
    world.spin_until(lambda: set(selection(rviz)) == expected)


def cyan(picture: np.ndarray) -> np.ndarray:
    return (picture[..., 0] < 80) & (picture[..., 1] > 200) & (picture[..., 2] > 200)


def spot(rviz: Rviz, colour: Callable[[np.ndarray], np.ndarray]) -> tuple[int, int]:
    """Row and column of the middle of what has a colour."""
    row, column = centre(colour(rviz.until(lambda s: colour(s).sum() > 300)))
    return int(row), int(column)


def test_a_click_selects_shows_and_publishes_the_splat(
    rviz: Rviz, world: World, picked: list[Any]
) -> None:
    splats = concatenate([disc((1, 0, 0), x=-1, sigma=0.2), disc((0, 0, 1), x=1, sigma=0.3)])
    world.map.replace(splats)
    rviz.click(*spot(rviz, blue))
    world.spin_until(lambda: picked)
    (message,) = picked
    assert message.header.frame_id == world.frame
    assert (message.slot, message.revision, message.map_id) == (1, 1, world.map.map_id)
    assert (message.pose.position.x, message.pose.position.y) == (1.0, 0.0)
    assert message.pose.orientation.w == 1.0
    np.testing.assert_allclose([message.scale.x, message.scale.z], [0.3, 0.01], rtol=4e-4)
    assert message.opacity == 1.0
    np.testing.assert_allclose(message.sh, splats.sh[1].ravel(), rtol=1e-3, atol=1e-6)
    entry = selection(rviz)["Slot 1"]
    assert entry["Position"] == "1; 0; 0"
    assert entry["Opacity"] == "1"
    assert entry["Base Color"] == "0; 0; 255"
    # Outlined: a circle of two standard deviations, 60 px about where the splat is.
    outline = cyan(rviz.until(lambda s: cyan(s).sum() > 100))
    rows, columns = np.nonzero(outline)
    assert columns.max() - columns.min() == pytest.approx(120, abs=4)
    assert rows.max() - rows.min() == pytest.approx(120, abs=4)


def test_the_outline_of_a_splat_far_from_the_origin_is_around_it(
    rviz: Rviz, world: World, picked: list[Any]
) -> None:
    world.map.replace(far_disc(world, 0.37, sigma=0.3))
    splat = spot(rviz, red)
    rviz.click(*splat)
    outline = centre(cyan(rviz.until(lambda s: cyan(s).sum() > 100)))
    assert outline == pytest.approx(splat, abs=2)


def test_a_box_selects_more_keys_add_and_remove(
    rviz: Rviz, world: World, picked: list[Any]
) -> None:
    colours = {-1: (1, 0, 0), 0: (0, 1, 0), 1: (0, 0, 1)}
    world.map.replace(concatenate([disc(colour, x=x, sigma=0.1) for x, colour in colours.items()]))
    left, middle, right = spot(rviz, red), spot(rviz, green), spot(rviz, blue)
    rviz.drag((left[0] - 30, left[1] - 30), (middle[0] + 30, middle[1] + 30))
    until_selected(rviz, world, {"Slot 0", "Slot 1"})
    world.spin_until(lambda: {message.slot for message in picked} == {0, 1})
    rviz.drag(right, (right[0] + 1, right[1] + 1), hold="shift")
    until_selected(rviz, world, {f"Slot {slot}" for slot in (0, 1, 2)})
    world.spin_until(lambda: [message.slot for message in picked] == [0, 1, 2])
    rviz.drag(middle, (middle[0] + 1, middle[1] + 1), hold="ctrl")
    until_selected(rviz, world, {"Slot 0", "Slot 2"})
    rviz.click(left[0] - 150, left[1])  # the void
    until_selected(rviz, world, set())
    rviz.until(lambda s: not cyan(s).any())


def test_what_is_selected_before_the_last_is_found_counts(
    rviz: Rviz, world: World, picked: list[Any]
) -> None:
    """Among many splats that are too faint to be picked, but are to be looked at for it."""
    colours = {-1: (1, 0, 0), 0: (0, 1, 0), 1: (0, 0, 1)}
    faint = disc((0, 0, 0), z=-1, sigma=0.1, opacity=0.01)
    for _ in range(18):
        faint = concatenate([faint, faint])
    faint.positions[:, :2] = np.random.default_rng(0).uniform(-1.5, 1.5, (len(faint), 2))
    discs = [disc(colour, x=x, sigma=0.1) for x, colour in colours.items()]
    world.map.replace(concatenate([*discs, faint]))
    left, middle, right = spot(rviz, red), spot(rviz, green), spot(rviz, blue)
    rviz.drag((left[0] - 30, left[1] - 30), (middle[0] + 30, middle[1] + 30))
    rviz.drag(right, (right[0] + 1, right[1] + 1), hold="shift")
    rviz.drag(middle, (middle[0] + 1, middle[1] + 1), hold="ctrl")
    until_selected(rviz, world, {"Slot 0", "Slot 2"})
    world.spin_until(lambda: [message.slot for message in picked] == [0, 1, 2])
    rviz.drag((left[0] - 140, left[1] - 30), (right[0] + 140, right[1] + 30))
    rviz.click(left[0] - 200, left[1])  # the void
    rviz.click(*middle)
    until_selected(rviz, world, {"Slot 1"})
    world.spin_until(lambda: picked[-1].slot == 1)


def test_what_hides_a_splat_keeps_it_from_being_selected(
    rviz: Rviz, world: World, picked: list[Any]
) -> None:
    """A marker above a splat, and a splat above another."""
    world.map.replace(
        concatenate([disc((1, 0, 0), sigma=0.5), disc((0, 0, 1), x=0.6, z=0.5, sigma=0.2)])
    )
    top = spot(rviz, blue)
    world.cube(z=1.0, x=-0.6, size=0.6)
    hidden = spot(rviz, green)
    rviz.click(*top)
    until_selected(rviz, world, {"Slot 1"})
    world.spin_until(lambda: picked)
    rviz.click(*hidden)
    world.spin_until(lambda: not any("Slot" in name for name in selection(rviz)))
    assert [message.slot for message in picked] == [1]


def test_a_perspective_view_picks_the_same(rviz: Rviz, world: World, picked: list[Any]) -> None:
    """And with the map's frame elsewhere than the fixed one."""
    rviz.load(configuration(map_display(), tools=SELECT, view=ORBIT))
    world.place(0.5, yaw=1.0)
    world.map.replace(
        concatenate([disc((1, 0, 0), x=-0.7, sigma=0.2), disc((0, 0, 1), x=0.7, sigma=0.2)])
    )
    for colour, slot in ((red, 0), (blue, 1)):
        row, column = spot(rviz, colour)
        rviz.click(row, column)
        until_selected(rviz, world, {f"Slot {slot}"})
        outline = centre(cyan(rviz.until(lambda s: cyan(s).sum() > 50)))
        np.testing.assert_allclose(outline, (row, column), atol=6)
        rviz.click(5, 5)
        until_selected(rviz, world, set())
        rviz.until(lambda s: not cyan(s).any())


def test_the_selection_follows_the_map(rviz: Rviz, world: World, picked: list[Any]) -> None:
    world.map.replace(disc((0, 0, 1), sigma=0.2))
    rviz.click(*spot(rviz, blue))
    until_selected(rviz, world, {"Slot 0"})
    moved: Splats = disc((1, 0, 0), x=1.0, sigma=0.1)
    world.map.upsert(range(1), moved)
    world.spin_until(lambda: selection(rviz)["Slot 0"].get("Position") == "1; 0; 0")
    world.map.delete(range(1))
    world.spin_until(lambda: selection(rviz)["Slot 0"] == {})
    rviz.until(lambda s: not cyan(s).any())
    rviz.set("Map", value=False)  # the handler goes with what is selected
    until_selected(rviz, world, set())
    rviz.set("Map", value=True)
    world.map.upsert(range(1), moved)
    rviz.click(*spot(rviz, red))
    until_selected(rviz, world, {"Slot 0"})
    world.map.replace(disc((0, 0, 1), sigma=0.2))  # a new map's slots are other splats
    until_selected(rviz, world, set())


def test_the_camera_looks_at_selected_splats_that_are_still_there(
    rviz: Rviz, world: World, picked: list[Any]
) -> None:
    """By the key F. A splat that was emptied is nowhere, not at the map's origin."""
    rviz.load(configuration(map_display(), tools=SELECT, view=ORBIT))
    world.map.replace(
        concatenate([disc((1, 0, 0), x=1.0, sigma=0.1), disc((0, 0, 1), x=2.0, sigma=0.1)])
    )
    ends = spot(rviz, red), spot(rviz, blue)
    top, left = np.min(ends, axis=0) - 40
    bottom, right = np.max(ends, axis=0) + 40
    rviz.drag((int(top), int(left)), (int(bottom), int(right)))
    until_selected(rviz, world, {"Slot 0", "Slot 1"})
    world.map.delete(range(1))
    world.spin_until(lambda: selection(rviz)["Slot 0"] == {})
    with rviz.held("f"):
        pass
    world.spin_until(lambda: focal_point(rviz)[0] > 1.0)
    np.testing.assert_allclose(focal_point(rviz), (2, 0, 0), atol=0.1)


def focal_point(rviz: Rviz) -> list[float]:
    """Of an orbiting view. [m]"""
    return [float(value) for value in rviz.properties(root="view")["Focal Point"].split("; ")]


def test_hundreds_are_counted_not_listed(rviz: Rviz, world: World, picked: list[Any]) -> None:
    grid = [
        disc((0, 0, 1), x=x, y=y, sigma=0.02)
        for x in np.arange(-1, 1, 0.1)
        for y in np.arange(-1, 1, 0.1)
    ]
    world.map.replace(concatenate(grid))
    rviz.until(lambda s: blue(s).sum() > 2000)
    height, width = rviz.picture().shape[:2]
    rviz.drag((height // 2 - 120, width // 2 - 120), (height // 2 + 120, width // 2 + 120))
    world.spin_until(lambda: len(picked) == 100)
    world.spin_until(lambda: len(selection(rviz)) == 101)  # which follows what is published
    assert "... and 300 more" in selection(rviz)


def test_a_group_that_moves_takes_its_splats_and_their_outline_along(
    rviz: Rviz, world: World, picked: list[Any]
) -> None:
    def at(x: float, y: float) -> np.ndarray:
        frame = np.eye(4)
        frame[:2, 3] = x, y
        return frame

    world.map.replace(disc((1, 0, 0), x=-1, sigma=0.2))
    world.map.upsert([1024], disc((0, 0, 1), sigma=0.3), group=3)
    world.map.move({3: at(1, 0)})
    rviz.until_status("Map", "Map", "Ok", "2 splats in 2 groups")
    still, row_and_column = spot(rviz, red), spot(rviz, blue)
    rviz.click(*row_and_column)
    world.spin_until(lambda: picked)
    (message,) = picked
    assert (message.slot, message.group) == (1024, 3)
    assert (message.pose.position.x, message.pose.position.y) == (1.0, 0.0)
    world.map.move({3: at(0.2, 0.7)})
    expected = np.add(row_and_column, (-70, -80))  # [px]
    rviz.until(lambda s: blue(s).any() and np.abs(centre(blue(s)) - expected).max() < 2)
    rviz.until(lambda s: cyan(s).any() and np.abs(centre(cyan(s)) - expected).max() < 3)
    assert spot(rviz, red) == still
    rviz.keep("groups.png")
