"""Opening a scene from rviz: the Scene File property, files dropped on the window, cancelling."""

from __future__ import annotations

import itertools
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rosplat_core import formats
from rosplat_core.generated import generate
from rosplat_core.splats import Splats
from rosplat_ros.program.processes import Processes
from rosplat_testing import PATIENCE
from rviz_harness import (
    Rviz,
    World,
    blue,
    configuration,
    disc,
    green,
    map_display,
    needs_rviz,
    red,
)

pytestmark = needs_rviz

TOPIC = "/scene_file/gaussians"  # where nobody publishes


@pytest.fixture
def rviz_alone(rviz: Rviz, world: World) -> Iterator[Rviz]:
    """A display of a topic that has no publisher; whom it starts ends with it."""
    rviz.load(configuration(map_display(topic=TOPIC)))
    yield rviz
    rviz.load(configuration())
    world.spin_until(lambda: publishers(world) == 0)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A red disc, whose name is not a plain one to YAML."""
    return save(tmp_path / "disc #2: it's.ply", disc((1, 0, 0)))


def save(path: Path, splats: Splats) -> Path:
    """Writes a scene that stands upright as it is, in the place of another."""
    formats.save(path, replace(splats, up=(0.0, 0.0, 1.0)), overwrite=True)
    return path


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene that takes some seconds to read and send."""
    path = tmp_path_factory.mktemp("scenes") / "large.ply"
    formats.save(path, generate(10_000)[np.arange(1_000_000) % 10_000])
    return path


def publishers(world: World) -> int:
    return world.node.count_publishers(TOPIC)


def test_a_scene_file_is_published_and_its_publisher_ends_with_the_property(
    rviz_alone: Rviz, world: World, scene: Path
) -> None:
    rviz_alone.set("Map", "Scene File", value=str(scene))
    rviz_alone.until(lambda s: red(s).sum() > 3000)
    text = rviz_alone.until_status("Map", "Scene File", "Ok", f"{scene}: 1 splats", "loaded")
    assert "reading" not in text
    rviz_alone.set("Map", "Scene File", value="")
    rviz_alone.until_status("Map", "Scene File", "Ok", "cancelled")
    world.spin_until(lambda: publishers(world) == 0)


def test_a_scene_that_lies_on_its_side_is_stood_upright(rviz_alone: Rviz, tmp_path: Path) -> None:
    """From above, its disc is seen from the edge as long as it lies."""
    turned = np.eye(4)
    turned[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    scene = replace(disc((1, 0, 0)).moved(turned), up=(0.0, -1.0, 0.0))
    formats.save(tmp_path / "lying.ply", scene)
    rviz_alone.set("Map", "Scene File", value=str(tmp_path / "lying.ply"))
    rviz_alone.until(lambda s: red(s).any(axis=1).sum() > 100 and red(s).any(axis=0).sum() > 100)


def test_another_topic_gets_no_scene_that_was_chosen_for_the_last(
    rviz_alone: Rviz, world: World, scene: Path
) -> None:
    rviz_alone.set("Map", "Scene File", value=str(scene))
    rviz_alone.until_status("Map", "Scene File", "Ok", f"{scene}: 1 splats", "loaded")
    rviz_alone.set("Map", "Topic", value="/another/gaussians")
    world.spin_until(lambda: publishers(world) == 0)
    assert rviz_alone.properties("Map")["Scene File"] == ""
    assert world.node.count_publishers("/another/gaussians") == 0


def test_a_choice_that_is_made_while_the_display_is_off_counts_when_it_is_on(
    rviz_alone: Rviz, world: World, scene: Path
) -> None:
    rviz_alone.set("Map", value=False)
    rviz_alone.set("Map", "Scene File", value=str(scene))
    rviz_alone.set("Map", value=True)
    rviz_alone.until_status("Map", "Scene File", "Ok", f"{scene}: 1 splats", "loaded")
    rviz_alone.set("Map", value=False)
    rviz_alone.set("Map", "Scene File", value="")
    rviz_alone.set("Map", value=True)
    world.spin_until(lambda: publishers(world) == 0)


def test_displays_of_one_topic_share_the_publisher_that_one_of_them_starts(
    rviz_alone: Rviz, world: World, scene: Path
) -> None:
    names = ("First", "Second")
    of_scene = {"Scene File": str(scene)}
    rviz_alone.load(configuration(*(map_display(n, topic=TOPIC, **of_scene) for n in names)))
    for name in names:
        rviz_alone.until_status(name, "Scene File", "Ok", f"{scene}: 1 splats", "loaded")
    world.spin_until(lambda: publishers(world) > 0)
    infos = world.node.get_publishers_info_by_topic(TOPIC)
    assert len({info.node_name for info in infos}) == 1


def test_a_scene_that_is_chosen_without_a_topic_keeps_its_name(
    rviz_alone: Rviz, scene: Path
) -> None:
    rviz_alone.set("Map", "Topic", value="")
    rviz_alone.set("Map", "Scene File", value=str(scene))
    rviz_alone.until_status("Map", "Scene File", "Error", "the publisher of /gaussians")  # a test's
    properties = rviz_alone.properties("Map")
    assert (properties["Topic"], properties["Scene File"]) == ("/gaussians", str(scene))


def test_a_dropped_scene_is_opened_and_nothing_else(
    rviz_alone: Rviz, world: World, scene: Path, tmp_path: Path
) -> None:
    note = tmp_path / "note.txt"
    note.write_text("no scene")
    assert not rviz_alone.ask("drop", file=str(note))
    assert rviz_alone.ask("drop", file=str(scene))
    assert rviz_alone.properties("Map")["Scene File"] == str(scene)
    rviz_alone.until(lambda s: red(s).sum() > 3000)
    # Once more, changed: by the publisher that is there.
    save(scene, disc((0, 1, 0)))
    assert rviz_alone.ask("drop", file=str(scene))
    rviz_alone.until(lambda s: not red(s).any())
    world.spin_until(lambda: publishers(world) == 1)  # each map has a writer of its own
    rviz_alone.set("Map", value=False)
    assert not rviz_alone.ask("drop", file=str(scene))


def test_scenes_of_all_kinds_can_be_dropped(rviz_alone: Rviz, tmp_path: Path) -> None:
    for suffix in ("ply", "spz", "sog", "splat", "ksplat", "npz", "glb", "usdz"):
        dropped = tmp_path / f"scene.{suffix.upper()}"
        dropped.touch()
        assert rviz_alone.ask("drop", file=str(dropped)), suffix
    for meta in ("meta.json", "lod-meta.json"):
        folder = tmp_path / f"folder of {meta}"
        folder.mkdir()
        (folder / meta).touch()
        assert rviz_alone.ask("drop", file=str(folder)), meta
        assert rviz_alone.ask("drop", file=str(folder / meta)), meta
    assert not rviz_alone.ask("drop", file=str(tmp_path))


def test_the_status_counts_what_has_arrived(rviz_alone: Rviz, large: Path) -> None:
    rviz_alone.set("Map", "Scene File", value=str(large))
    texts = []
    deadline = time.monotonic() + PATIENCE
    while not texts or "loaded" not in texts[-1]:
        assert time.monotonic() < deadline, texts
        texts.append(rviz_alone.status("Map").get("Scene File", ("", ""))[1])
        time.sleep(0.1)
    assert any(re.search(r"reading .*: \d+%", text) for text in texts)
    assert texts[-1].startswith(f"{large}: 1,000,000 splats")


def test_cancelling_holds_nothing_up(rviz_alone: Rviz, world: World) -> None:
    """The window answers at once, the publisher ends, and another scene can follow."""
    rviz_alone.set("Map", "Scene File", value="procedural:2000000")  # takes longer than a file
    rviz_alone.until_status("Map", "Scene File", "Ok", "loading")
    rviz_alone.set("Map", "Scene File", value="")
    rviz_alone.until_status("Map", "Scene File", "Ok", "cancelled")
    world.spin_until(lambda: publishers(world) == 0)


def test_a_publisher_that_ends_while_it_loads_is_replaced(
    rviz_alone: Rviz, world: World, tmp_path: Path
) -> None:
    slow = "procedural:500000"  # takes longer than a file of that size
    with Processes(tmp_path) as processes:
        remap = ("--ros-args", "-r", f"gaussians:={TOPIC}")
        publisher = processes.node("rosplat_tools", "ply_publisher", *remap)
        world.spin_until(lambda: publishers(world) == 1)
        rviz_alone.set("Map", "Scene File", value=slow)
        rviz_alone.until_status("Map", "Scene File", "Ok", "loading")
        publisher.terminate()
        rviz_alone.until_status("Map", "Scene File", "Ok", f"{slow}: 500,000 splats")


def test_what_cannot_be_loaded_is_said_in_the_status(rviz_alone: Rviz, tmp_path: Path) -> None:
    missing = tmp_path / "missing.ply"
    rviz_alone.set("Map", "Scene File", value=str(missing))
    rviz_alone.until_status("Map", "Scene File", "Error", str(missing))


def test_a_publisher_that_starts_with_rviz_is_asked(tmp_path: Path, world: World) -> None:
    """A saved configuration with a Scene File, and a publisher from the same launch file."""
    scene = save(tmp_path / "disc.ply", disc((1, 0, 0)))
    remap = ("--ros-args", "-r", f"gaussians:={TOPIC}")
    config = configuration(map_display(topic=TOPIC, **{"Scene File": str(scene)}))
    with Processes(tmp_path / "publisher") as processes:
        processes.node("rosplat_tools", "ply_publisher", *remap)
        rviz = Rviz(tmp_path, config=config)
        try:
            rviz.until(lambda s: red(s).sum() > 3000)
            rviz.until_status("Map", "Scene File", "Ok", f"{scene}: 1 splats", "loaded")
            world.spin_until(lambda: publishers(world) == 1)
        finally:
            rviz.close()


def test_each_display_of_a_namespaced_rviz_has_a_publisher_of_its_own(
    tmp_path: Path, world: World
) -> None:
    scenes = {name: tmp_path / f"{name}.ply" for name in ("red", "green", "blue")}
    for i, path in enumerate(scenes.values()):
        save(path, disc(tuple(float(i == k) for k in range(3)), x=1 - i, sigma=0.2))
    left = map_display("Left", topic="left", **{"Scene File": str(scenes["red"])})
    right = map_display("Right", topic="right", **{"Scene File": str(scenes["blue"])})

    def publishers() -> set[str]:
        """Names of those that have been heard of."""
        infos = map(world.node.get_publishers_info_by_topic, ("/robot/left", "/robot/right"))
        return {publisher.node_name for info in infos for publisher in info}

    rviz = Rviz(tmp_path, "--ros-args", "-r", "__ns:=/robot", config=configuration(left, right))
    try:
        rviz.until(lambda s: red(s).any() and blue(s).any())
        world.spin_until(lambda: len(publishers()) == 2)
        rviz.set("Left", "Scene File", value=str(scenes["green"]))
        rviz.until(lambda s: green(s).any() and not red(s).any())
        rviz.until_status("Left", "Scene File", "Ok", str(scenes["green"]), "loaded")
        assert blue(rviz.picture()).any()
    finally:
        rviz.close()


def test_publishers_that_clear_each_others_map_are_named(rviz: Rviz, world: World) -> None:
    from rosplat_ros.map_publisher import MapPublisher

    world.place()
    others = [MapPublisher(world.node, frame_id=world.frame) for _ in range(2)]
    topic = world.node.resolve_topic_name("gaussians")
    senders = [sender for sender in world.node.publishers if sender.topic_name == topic]
    world.spin_until(lambda: all(sender.get_subscription_count() for sender in senders))
    turns = itertools.cycle(others)

    def named() -> bool:
        next(turns).upsert(range(1), disc((1, 0, 0)))
        return "clear each other's map" in rviz.status("Map").get("Topic", ("", ""))[1]

    world.spin_until(named)
    rviz.until_status("Map", "Topic", "Warn", "clear each other's map", "world, world")


def test_a_publisher_without_the_service_is_named(rviz: Rviz, world: World, scene: Path) -> None:
    world.place(0)
    world.map.replace(disc((1, 0, 0)))
    rviz.until(lambda s: red(s).sum() > 3000)
    rviz.set("Map", "Scene File", value=str(scene))
    rviz.until_status("Map", "Scene File", "Error", "no service", "another topic")
