"""Channels: values of splats beside what is drawn of them, coloured and read back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import coloured_channels
import numpy as np
import pytest
from numpy.typing import NDArray

from drawing import CAMERAS, Target, cloud, decibels
from rosplat_core import rendering
from rosplat_core.rendering import ChannelColours, CpuRenderer, DrawMode, Instructions, Rasterizer
from rosplat_core.splats import Splats
from rosplat_lab import reference

Array = NDArray[Any]

CAMERA = CAMERAS["outside"]
SH_C0 = 0.28209479177387814


SCENES = {
    "scene by the processor": Rasterizer.PROCESSOR,
    "tiles": Rasterizer.TILES,
}


@pytest.fixture(params=[*Instructions.__members__, *SCENES])
def target(request: pytest.FixtureRequest) -> Target:
    """The ways on which a map comes into a picture."""
    if request.param in SCENES:
        target: Target = request.getfixturevalue("opengl")
        target.renderer.settings = rendering.RenderSettings()
        target.set(rasterizer=SCENES[request.param])
    else:
        target = Target(
            CpuRenderer(threads=2, instructions=Instructions.__members__[request.param])
        )
        if request.param != "BEST" and target.renderer.instructions != request.param.lower():
            pytest.skip(f"this machine has no {request.param}")
    return target


def painted(splats: Splats, colours: Array) -> Array:
    """What splats in these colours look like."""
    sh = ((colours - 0.5) / SH_C0)[:, None]
    return reference.render(replace(splats, sh=sh), CAMERA).rgba


def with_channels(splats: Splats, **channels: Array) -> Splats:
    return replace(splats, channels=channels)


def begin(target: Target, splats: Splats, **settings: Any) -> None:
    """A new map, drawn by channels."""
    target.begin(splats)
    target.set(mode=DrawMode.CHANNEL, **settings)


def labels(count: int) -> Array:
    """Integers of all sizes, and where there is none."""
    random = np.random.default_rng(7)
    some = random.integers(-3, 30, count).astype(np.float32)
    some[random.integers(count, size=40)] = [-(2.0**24), 2.0**24, 3e38, -3e38] * 10
    some[random.integers(count, size=60)] = [np.nan, np.inf, -np.inf] * 20
    return some


def test_categories_are_coloured_as_their_twin_has_them(target: Target) -> None:
    splats = cloud()
    values = labels(len(splats))
    begin(target, with_channels(splats, label=values), channel="label")
    expected = painted(splats, coloured_channels.categories(values))
    assert decibels(target.draw(), expected) > 60
    # Between integers there are no categories, unless they are asked for.
    values += np.float32(0.25)
    begin(target, with_channels(splats, label=values))
    assert decibels(target.draw(), expected) < 30
    target.set(channel_colours=ChannelColours.CATEGORIES)
    assert decibels(target.draw(), painted(splats, coloured_channels.categories(values))) > 60


def test_gradients_are_coloured_as_their_twin_has_them(target: Target) -> None:
    splats = cloud()
    values = np.random.default_rng(3).normal(10, 3, len(splats)).astype(np.float32)
    values[::7] = np.nan
    begin(target, with_channels(splats, seen=values))
    least, most = np.nanmin(values), np.nanmax(values)
    assert (
        decibels(target.draw(), painted(splats, coloured_channels.gradient(values, least, most)))
        > 60
    )
    target.set(channel_range=(9.0, 12.0))
    assert decibels(target.draw(), painted(splats, coloured_channels.gradient(values, 9, 12))) > 60


def test_extremes_are_colours_too(target: Target) -> None:
    splats = cloud()
    values = np.full(len(splats), 0.5, np.float32)
    begin(target, with_channels(splats, flat=values))
    assert (
        decibels(target.draw(), painted(splats, coloured_channels.gradient(values, 0.5, 0.5))) > 60
    )
    values[::2], values[1::2] = 3e38, -3e38
    begin(target, with_channels(splats, wide=values), channel_colours=ChannelColours.GRADIENT)
    assert np.isfinite(target.draw()).all()


def test_edits_write_channels_and_slots_without_are_grey(target: Target) -> None:
    splats = cloud()
    count = len(splats)
    begin(target, splats)  # without any
    grey = np.full((count, 3), coloured_channels.NO_VALUE)
    assert decibels(target.draw(), painted(splats, grey)) > 60
    values = np.arange(count) % 5.0
    target.write(range(count), with_channels(splats, label=values, seen=values / 8))
    target.write(range(100), splats[:100])
    target.write(np.arange(200, 300), with_channels(splats[200:300], label=np.full(100, 7.0)))
    values[:100], values[200:300] = np.nan, 7
    target.set(channel="label")
    assert decibels(target.draw(), painted(splats, coloured_channels.categories(values))) > 60
    target.set(channel="seen")
    seen = values / 8
    seen[200:300] = np.nan
    assert decibels(target.draw(), painted(splats, coloured_channels.gradient(seen, 0, 0.5))) > 60
    target.set(channel="nobody's")
    assert decibels(target.draw(), painted(splats, grey)) > 60


def test_channels_are_drawn_in_full(target: Target) -> None:
    splats = cloud()
    values = labels(len(splats))
    begin(target, with_channels(splats, label=values), detail="20px")
    assert decibels(target.draw(), painted(splats, coloured_channels.categories(values))) > 60


def test_values_are_read_back_whoever_draws(opengl: Target) -> None:
    splats = cloud()
    count = len(splats)
    values = np.arange(count) / 2.0
    opengl.renderer.settings = rendering.RenderSettings()
    opengl.set(rasterizer=Rasterizer.TILES)
    begin(opengl, with_channels(splats, half=values))
    opengl.write(range(5000, 5000 + count), with_channels(splats, label=values * 2))
    for rasterizer in (Rasterizer.TILES, Rasterizer.PROCESSOR, Rasterizer.TILES):
        opengl.set(rasterizer=rasterizer)  # the map moves over to it
        opengl.draw()
        read = opengl.renderer.read_slots([3, 5003])
        np.testing.assert_array_equal(
            [splat["channels"] for splat in read], [[1.5, np.nan], [np.nan, 3]]
        )
