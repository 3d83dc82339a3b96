"""What the cross-package tests share: scenes, pictures, a display, the renderer."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from drawing import Target
from rosplat_lab.bench.renderers import NumberedView
from rviz_harness import MARKERS, Rviz, World, configuration, map_display

pytest_plugins = ["core_fixtures", "ros_fixtures"]

REPOSITORY = Path(__file__).resolve().parents[1]


def _shared_folder(variable: str, name: str) -> Path:
    folder = Path(os.environ.get(variable, REPOSITORY.parent / "shared" / name))
    if not folder.is_dir():
        pytest.skip(f"no {name}: set {variable} to the folder of the trained scenes' {name}")
    return folder


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The trained scenes, $ROSPLAT_DATA or ../shared/data."""
    return _shared_folder("ROSPLAT_DATA", "data")


@pytest.fixture(scope="session")
def reference_folder() -> Path:
    """Pictures of them by another renderer, $ROSPLAT_REFERENCE or ../shared/reference."""
    return _shared_folder("ROSPLAT_REFERENCE", "reference")


@pytest.fixture(scope="session")
def display() -> Iterator[str]:
    """An X display, made by Xvfb where there is none."""
    from rviz_gaussian_plugin.offscreen import ensure_display

    with ensure_display() as name:
        yield name


@pytest.fixture(scope="module")
def opengl(display: str) -> Iterator[Target]:
    """What draws by OpenGL, one for the tests of a file."""
    from rviz_gaussian_plugin.offscreen import Renderer

    renderer = Renderer()
    target = Target(renderer, NumberedView(renderer))
    yield target
    del renderer, target.renderer, target.view  # before the display


@pytest.fixture(scope="module")
def running_rviz(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rviz]:
    """One rviz2 for the tests of a file."""
    rviz = Rviz(tmp_path_factory.mktemp("rviz"))
    yield rviz
    rviz.close()


@pytest.fixture
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    """A map in a frame that rviz2 has not heard of yet."""
    import rclpy

    rclpy.init()
    world = World(frame=request.node.name)
    yield world
    world.close()
    rclpy.shutdown()


@pytest.fixture
def rviz(running_rviz: Rviz, world: World) -> Rviz:
    """A view from above on the map of the world, and its markers."""
    running_rviz.load(configuration(MARKERS, map_display()))
    return running_rviz
