"""Each property of the Display acts on the picture of a real rviz2."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from rviz_harness import Rviz, World, configuration, disc, map_display, needs_rviz

pytestmark = needs_rviz

TILTED = """{Class: rviz_default_plugins/Orbit, Distance: 5, Yaw: 0.3, Pitch: 1.2,
  Near Clip Distance: 0.01}"""
INTERACT = "{Class: rviz_default_plugins/Interact}"
CHANGES = [
    ("Draw Mode", "Depth"),
    ("Draw Mode", "Billboard"),
    ("Draw Mode", "Flat Ball"),
    ("Draw Mode", "Gaussian Ball"),
    ("Draw Mode", "Normals"),
    ("Draw Mode", "Opacity"),
    ("Draw Mode", "Age"),
    ("Draw Mode", "Channel"),
    ("Alpha", 0.5),
    ("Scale", 0.5),
    ("SH Degree", "0"),
    ("SH Degree", "1"),
    ("SH Degree", "2"),
    ("SH Degree/SH Band", "0"),
    ("SH Degree/SH Band", "3"),
    ("Order Source", "Off"),
    ("Model", "EWA Antialiased"),
    ("Near Fade", 6.0),
    ("Clip Box", True),
]


def test_each_property_acts(rviz: Rviz, world: World) -> None:
    """From the picture as it comes, every change is seen, and its undoing brings that back."""
    from rosplat_core.splats import Splats, concatenate

    rng = np.random.default_rng(1)
    far = disc((0.9, 0.2, 0.1), x=-0.5, z=-1.0, sigma=0.8)
    near = disc((0.1, 0.3, 0.9), x=0.5, z=0.5, sigma=0.6, opacity=0.8)
    # Drawn by slot, the near one would be below.
    both = concatenate([near, far])
    sh = np.zeros((2, 16, 3), np.float32)
    sh[:, :1] = both.sh
    sh[:, 1:] = rng.uniform(-0.4, 0.4, (2, 15, 3))
    small = Splats(both.positions, both.orientations, both.scales, both.opacities, sh)
    dust = disc((1, 1, 1), y=1.5, sigma=0.004)  # smaller than a pixel
    faint = disc((1, 1, 1), y=-1.5, sigma=0.002, opacity=0.12)  # its alphas add up to less than one
    world.place()
    rviz.load(configuration(map_display(), view=TILTED))
    world.map.replace(concatenate([small, dust, faint]))
    rviz.until(lambda s: s.max() > 150)
    rviz.until_status("Map", "Order", "Ok", "4 splats")

    plain = rviz.until_still()

    def differs(picture: np.ndarray) -> bool:
        return bool((np.abs(picture - plain).max(axis=2) > 8).sum() >= 1)

    for name, value in CHANGES:
        path = ("Map", *name.split("/"))
        before = rviz.properties("Map")[name]
        rviz.set(*path, value=value)
        rviz.until(differs)
        rviz.set(*path, value=before)
        rviz.until(lambda s: not differs(s))


def test_a_saved_backend_is_told_to_each_sidecar_that_comes(rviz: Rviz, world: World) -> None:
    world.place()
    world.map.replace(disc((1, 0, 0)))
    rviz.load(configuration(map_display(**{"Sidecar Backend": "numpy"})))
    for _ in range(2):
        rviz.until_status("Map", "Sidecar", "Warn", "no sidecar", "numpy")
        sorter = rviz.processes.node("rosplat_sorter", "sorter")
        rviz.until_status("Map", "Sidecar", "Ok", "asked for backend numpy")
        rviz.until_status("Map", "Order", "Ok", "sidecar (numpy")
        sorter.terminate()
        sorter.wait()
        rviz.processes.forget(sorter)


def test_the_sidecar_changes_its_backend(rviz: Rviz, world: World) -> None:
    world.place()
    world.map.replace(disc((1, 0, 0)))
    rviz.set("Map", "Sidecar Backend", value="numpy")
    rviz.until_status("Map", "Sidecar", "Warn", "no sidecar")
    rviz.set("Map", "Sidecar Backend", value="As Started")
    rviz.until_status("Map", "Sidecar", "Warn", "No sorter publishes")  # as Order Source is Sidecar
    sorter = rviz.processes.node("rosplat_sorter", "sorter")
    try:
        for backend in ["native", "numpy"]:
            rviz.until_status("Map", "Order", "Ok", "sidecar")
            rviz.set("Map", "Sidecar Backend", value=backend)
            rviz.until_status("Map", "Sidecar", "Ok", backend)
            rviz.until_status("Map", "Order", "Ok", f"sidecar ({backend})")
        rviz.set("Map", "Sidecar Backend", value="cupy")
        if not importlib.util.find_spec("cupy"):
            rviz.until_status("Map", "Sidecar", "Warn", "cupy", "but the order is by sidecar (")
    finally:
        sorter.terminate()
        sorter.wait()
        rviz.processes.forget(sorter)


def test_the_clip_box_is_pulled_by_its_handles(rviz: Rviz, world: World) -> None:
    """From above, 100 px/m: the face of +x is half a metre right of the middle."""

    def outlined(picture: np.ndarray) -> bool:
        return (picture.min(axis=-1) > 60).sum() > 300

    world.place()
    world.map.replace(disc((1, 0, 0), sigma=0.01))
    rviz.load(configuration(map_display(**{"Clip Box": {"Value": True}}), tools=INTERACT))
    rviz.until(outlined)
    rviz.keep("clip_box.png")
    height, width, _ = rviz.picture().shape
    rviz.drag((height // 2, width // 2 + 50), (height // 2, width // 2 + 150))
    rviz.until(lambda s: rviz.properties("Map", "Clip Box")["Size/X"] > 1.5)
    box = rviz.properties("Map", "Clip Box")
    assert box["Size/X"] == pytest.approx(2, abs=0.1)
    assert box["Center/X"] == pytest.approx(0.5, abs=0.05)
    assert (box["Size/Y"], box["Center/Y"]) == (1, 0)
    rviz.set("Map", "Clip Box", "Handles", value=False)
    rviz.until(lambda s: not outlined(s))
