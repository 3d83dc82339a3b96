"""Displays come and go in a real rviz2, and nothing of them stays behind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rviz_harness import Rviz, World, disc, needs_rviz, red

pytestmark = needs_rviz

CYCLES = 20
MEBIBYTE = 1 << 20


def seen(picture: np.ndarray) -> bool:
    return red(picture).sum() > 1000


def gone(picture: np.ndarray) -> bool:
    return not red(picture).any()


def outlined(picture: np.ndarray) -> bool:
    """The edges of a clip box are there."""
    return (picture.min(axis=-1) > 60).sum() > 300


def turn_off_and_on(rviz: Rviz) -> None:
    rviz.set("Map", value=False)
    rviz.until(gone)
    rviz.set("Map", value=True)
    rviz.until(seen)


def reset(rviz: Rviz) -> None:
    rviz.ask("reset", path=["Map"])
    rviz.until(seen)


def remove_and_add(rviz: Rviz) -> None:
    rviz.ask("remove", path=["Map"])
    rviz.until(gone)
    rviz.ask("add", **{"class": "rviz_gaussian_plugin/GaussianMap", "name": "Map"})
    rviz.set("Map", "Topic", value="/gaussians")
    rviz.until(seen)


def outline_a_box(rviz: Rviz) -> None:
    rviz.set("Map", "Clip Box", value=True)
    rviz.until(outlined)
    rviz.set("Map", "Clip Box", value=False)
    rviz.until(lambda s: not outlined(s))


def endpoints(world: World) -> dict[str, int]:
    """What rviz2 has on each topic and service."""
    node = world.node
    counts = {}
    for what, names in [
        ("publishers", node.get_publisher_names_and_types_by_node("rviz", "/")),
        ("subscriptions", node.get_subscriber_names_and_types_by_node("rviz", "/")),
        ("services", node.get_service_names_and_types_by_node("rviz", "/")),
        ("clients", node.get_client_names_and_types_by_node("rviz", "/")),
    ]:
        counts[what] = len(names)
    for topic in ["/gaussians", "/gaussians/view", "/gaussians/order"]:
        counts[topic] = node.count_publishers(topic) + node.count_subscribers(topic)
    return counts


def threads(process: int) -> int:
    return len(list(Path(f"/proc/{process}/task").iterdir()))


@pytest.mark.parametrize("cycle", [turn_off_and_on, reset, remove_and_add, outline_a_box])
def test_nothing_stays_behind(rviz: Rviz, world: World, cycle: Callable[[Rviz], None]) -> None:
    def counters() -> tuple[object, ...]:
        return rviz.ask("gl"), threads(rviz.process.pid), endpoints(world)

    world.place()
    world.map.replace(disc((1, 0, 0)))
    rviz.until(seen)

    def least(cycles: int) -> float:
        """Memory that is not given back: now and then a picture is on its way. [bytes]"""
        memory = []
        for _ in range(cycles):
            cycle(rviz)
            memory.append(rviz.ask("allocated"))
        rviz.until_status("Map", "Order", "Ok")
        return min(memory)

    for _ in range(5):
        cycle(rviz)
    memory = least(10)  # with what drivers and middleware keep for the next time
    before = counters()
    for _ in range(CYCLES - 10):
        cycle(rviz)
    assert least(10) - memory < CYCLES * MEBIBYTE / 4  # a page of slots alone is 4 MiB
    assert counters() == before


def test_rviz_ends_well_while_a_map_is_drawn(rviz: Rviz, world: World) -> None:
    world.place()
    world.map.replace(disc((1, 0, 0)))
    rviz.until(seen)
    assert rviz.quit() == 0
