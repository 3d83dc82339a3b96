"""Configurations of rviz2: what is set is saved, and what is saved is set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from rosplat_lab.driven_rviz import Refused
from rviz_harness import Rviz, World, configuration, disc, map_display, needs_rviz

pytestmark = needs_rviz

# All that the Display has, and none as it comes.
MAP: dict[str, Any] = {
    "Topic": "/other",
    "Topic/Depth": 7,
    "Topic/History Policy": "Keep All",
    "Topic/Reliability Policy": "Best Effort",
    "Topic/Durability Policy": "Volatile",
    "Scene File": "/nowhere/scene.ply",
    "Draw Mode": "Depth",
    "Draw Mode/Auto Range": False,
    "Draw Mode/Nearest": 0.5,
    "Draw Mode/Farthest": 20.5,
    "Draw Mode/Age Range": 3.5,
    "Draw Mode/Channel": "label",
    "Draw Mode/Colors": "Gradient",
    "Draw Mode/Autocompute Value Bounds": False,
    "Draw Mode/Min Value": -0.5,
    "Draw Mode/Max Value": 2.5,
    "Alpha": 0.5,
    "Scale": 1.5,
    "SH Degree": "2",
    "SH Degree/SH Band": "1",
    "Order Source": "Off",
    "Model": "EWA Antialiased",
    "Detail": "2 px",
    "Near Fade": 0.25,
    "Clip Box": True,
    "Clip Box/Center/X": 1.5,
    "Clip Box/Center/Y": 2.5,
    "Clip Box/Center/Z": 3.5,
    "Clip Box/Size/X": 4.5,
    "Clip Box/Size/Y": 5.5,
    "Clip Box/Size/Z": 6.5,
    "Clip Box/Handles": False,
    "Sidecar Backend": "native",
    "Publish Camera": True,
    "Render Service": False,
    "Rasterizer": "Tiles",
    "Rasterizer/Profile": True,
}
SUMS = {"Clip Box/Center", "Clip Box/Size"}  # of their parts
ACTIONS = {"Fit View"}  # uncheck themselves
FLY: dict[str, Any] = {
    "Near Clip Distance": 0.5,
    "Target Frame": "map",
    "Position/X": 1.5,
    "Position/Y": 2.5,
    "Position/Z": 3.5,
    "Yaw": 1.25,
    "Pitch": 0.75,
    "Speed": 4.5,
    "Smoothing": 0.5,
}
IMU = {
    "Topic": "/other/imu",
    "Window": 25,
    "Acceleration Unit": "g",
    "Angular Velocity Unit": "deg/s",
}


def test_properties_survive_saving_and_loading(rviz: Rviz, world: World, tmp_path: Path) -> None:
    panel = {"Class": "rviz_gaussian_plugin/ImuPanel", "Name": "IMU"} | IMU
    fly = "{Class: rviz_gaussian_plugin/Fly}"
    rviz.load(configuration(map_display(), view=fly, panels=f"[{panel}]"))
    fresh = rviz.properties("Map")
    assert set(fresh) - SUMS - ACTIONS == set(MAP), "the test lists other properties"
    for name, value in MAP.items():
        assert fresh[name] != value
        rviz.set("Map", *name.split("/"), value=value)
    for name, value in FLY.items():
        assert rviz.properties(root="view")[name] != value
        rviz.set(*name.split("/"), value=value, root="view")
    before = rviz.properties("Map"), rviz.properties(root="view")
    for set_to, found in [(MAP, before[0]), (FLY, before[1])]:
        assert {name: found[name] for name in set_to} == set_to

    rviz.save(tmp_path / "saved.rviz")
    rviz.load(configuration())
    rviz.load((tmp_path / "saved.rviz").read_text())
    assert (rviz.properties("Map"), rviz.properties(root="view")) == before
    rviz.save(tmp_path / "again.rviz")
    panels = yaml.safe_load((tmp_path / "again.rviz").read_text())["Panels"]
    assert IMU.items() <= panels[0].items()


def test_add_by_topic(rviz: Rviz, world: World) -> None:
    """rviz's Add dialog offers the Display for the map's topic, its Topic property only maps."""
    from std_msgs.msg import String

    strings = world.node.create_publisher(String, "/strings", 1)
    displays = "[{Class: rviz_common/Displays, Name: Displays}]"
    rviz.load(configuration(map_display(), panels=displays))
    world.map.replace(disc((1, 0, 0)))
    # The dialog lists what rviz2 has discovered when it opens.
    rviz.until_status("Map", "Map", "Ok", "1 splats")
    rviz.ask("open add dialog")
    world.spin_until(lambda: "GaussianMap" in str(offered(rviz)))
    rviz.ask("add topic", path=["/gaussians", "GaussianMap"])
    world.spin_until(lambda: rviz.properties("GaussianMap").get("Topic") == "/gaussians")
    options = rviz.ask("options", root="displays", path=["GaussianMap", "Topic"])
    assert "/gaussians" in options and "/strings" not in options
    world.node.destroy_publisher(strings)


def offered(rviz: Rviz) -> Any:
    try:
        return rviz.ask("topics")
    except Refused:
        return None
