"""Draw Mode Channel in a real rviz2: what is coloured, what the Status says, what a click shows."""

from __future__ import annotations

import shutil
from dataclasses import replace

import coloured_channels as channels
import numpy as np
import pytest

from rosplat_core.splats import Splats, concatenate
from rviz_harness import Rviz, World, centre, configuration, disc, map_display, needs_rviz

pytestmark = needs_rviz

SELECT = "{Class: rviz_default_plugins/Select}"


def labelled(x: float, **values: float) -> Splats:
    """An opaque disc at x with values of channels."""
    some = {name: np.array([value]) for name, value in values.items()}
    return replace(disc((1, 1, 1), x=x, sigma=0.3), channels=some)


def shows(colour: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """Where a colour of 0 to 1 is, all but covering."""
    return (np.abs(picture - 255 * colour) < 8).all(axis=2)


def test_values_are_coloured_named_and_picked(rviz: Rviz, world: World) -> None:
    rviz.load(configuration(map_display(), tools=SELECT))
    world.place()
    rviz.set("Map", "Draw Mode", value="Channel")
    world.map.replace(disc((1, 1, 1), sigma=0.3))
    rviz.until_status("Map", "Channel", "Warn", "The map has no channel")
    grey = np.full(3, channels.NO_VALUE)
    rviz.until(lambda s: shows(grey, s).sum() > 100)

    world.map.replace(
        concatenate([
            labelled(-1.5, label=0, seen=0.25), labelled(0, label=4, seen=0.75), labelled(1.5),
        ])
    )  # fmt: skip
    rviz.until_status("Map", "Channel", "Ok", "label, categories")
    for wanted in [*channels.categories([0, 4]), grey]:
        rviz.until(lambda s, wanted=wanted: shows(wanted, s).sum() > 100)
    rviz.keep("categories.png")

    rviz.set("Map", "Draw Mode", "Channel", value="seen")
    rviz.until_status("Map", "Channel", "Ok", "seen, 0.25 (blue) to 0.75 (red)")
    for wanted in channels.gradient([0.25, 0.75], 0.25, 0.75):
        rviz.until(lambda s, wanted=wanted: shows(wanted, s).sum() > 100)
    rviz.set("Map", "Draw Mode", "Autocompute Value Bounds", value=False)
    rviz.until_status("Map", "Channel", "Ok", "seen, 0 (blue) to 1 (red)")
    for wanted in channels.gradient([0.25, 0.75], 0, 1):
        rviz.until(lambda s, wanted=wanted: shows(wanted, s).sum() > 100)
    rviz.keep("gradient.png")
    rviz.set("Map", "Draw Mode", "Colors", value="Categories")
    rviz.until_status("Map", "Channel", "Ok", "seen, categories")

    rviz.set("Map", "Draw Mode", "Channel", value="keyframe")
    rviz.until_status("Map", "Channel", "Warn", "no channel 'keyframe', it has label, seen")
    world.map.upsert(range(1), labelled(-1.5, keyframe=7))
    rviz.until_status("Map", "Channel", "Ok", "keyframe, categories")
    rviz.until(lambda s: shows(channels.categories([7])[0], s).sum() > 100)


@pytest.mark.skipif(not shutil.which("xdotool"), reason="no xdotool to click with")
def test_a_click_shows_all_values_of_a_splat(rviz: Rviz, world: World) -> None:
    from rosplat_msgs.msg import Gaussian

    rviz.load(configuration(map_display(), tools=SELECT))
    picked: list[Gaussian] = []
    world.node.create_subscription(Gaussian, "/gaussians/picked", picked.append, 100)
    world.place()
    world.map.replace(concatenate([labelled(-1, label=3), labelled(1, seen=0.5)]))
    white = rviz.until(lambda s: (s.min(axis=2) > 200).sum() > 100)
    white = white.min(axis=2) > 200
    half = white.shape[1] // 2
    for part in (white[:, :half], white[:, half:]):
        assert part.any()
    row, column = centre(white[:, :half])
    rviz.click(int(row), int(column))
    world.spin_until(lambda: picked)
    assert picked[0].channel_names == ["label", "seen"]
    np.testing.assert_array_equal(picked[0].channels, [3, np.nan])
    tree = rviz.ask("tree", path=[], root="selection")
    (splat,) = tree["children"]
    values = {entry["name"]: entry["value"] for entry in splat["children"]}
    assert (values["label"], values["seen"]) == ("3", "none")
