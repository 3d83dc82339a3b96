"""The package's programs. run_module loads each, which takes a second, with interrupts quiet."""

from __future__ import annotations

from functools import partial

from rosplat_ros.program.processes import run_module

align = partial(run_module, "align", "rosplat_tools.cameras.align")
camera = partial(run_module, "camera", "rosplat_tools.cameras.camera")
compare = partial(run_module, "compare", "rosplat_tools.cameras.compare")
convert = partial(run_module, "convert", "rosplat_tools.convert")
demo_sensors = partial(run_module, "demo_sensors", "rosplat_tools.emulation.demo_sensors")
follow = partial(run_module, "follow", "rosplat_tools.following.follow")
generate = partial(run_module, "generate", "rosplat_tools.generate")
inspect = partial(run_module, "inspect", "rosplat_tools.inspect_scene")
occupancy = partial(run_module, "occupancy", "rosplat_tools.obstacles.occupancy")
lidar = partial(run_module, "lidar", "rosplat_tools.lidars.lidar")
ply_publisher = partial(run_module, "ply_publisher", "rosplat_tools.ply_publisher")
share = partial(run_module, "share", "rosplat_tools.sharing.share")
simplify = partial(run_module, "simplify", "rosplat_tools.simplify.command")
simulate = partial(run_module, "simulate", "rosplat_tools.simulation.simulate")
slam_emulator = partial(run_module, "slam_emulator", "rosplat_tools.emulation.slam_emulator")
stream_publisher = partial(
    run_module, "stream_publisher", "rosplat_tools.streaming.stream_publisher"
)
