"""Publishes and shows a scene: in rviz2 if it is installed, else in a viewer of its own."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
import uuid
from pathlib import Path

from rosplat_core.program.output import say
from rosplat_core.scenes import NAMES, vertical
from rosplat_core.splats import SceneError
from rosplat_ros.program.processes import ProcessError, Processes, quoted

PROCEDURAL = "procedural:200000"


def main(arguments: list[str] | None = None) -> int:
    """Runs publisher and viewer until the viewer ends; then ends both."""
    parser = argparse.ArgumentParser(prog="demo", description=__doc__)
    parser.add_argument(
        "scene", nargs="?", default=PROCEDURAL,
        help=f"scene: {NAMES} (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out"),
        help="folder for pictures and logs (default: %(default)s)",
    )
    parser.add_argument(
        "--host", action="store_true", help="use the viewer even if rviz2 is installed"
    )
    parser.add_argument(
        "--up", type=float, nargs=3, metavar=("X", "Y", "Z"),
        help="the scene's vertical, for the viewer without rviz2 (default: the format's, or z)",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    screen = bool(os.environ.get("DISPLAY"))
    rviz = bool(shutil.which("rviz2")) and screen and not options.host
    # The viewer has a namespace for each demo; rviz2 also sees the user's other nodes and TF.
    namespace = "/" if rviz else f"/demo_{uuid.uuid4().hex[:8]}"
    remap = ["--ros-args", "-r", f"__ns:={namespace}"]
    try:
        with Processes(options.out / "log") as processes:
            scene = f"path:={quoted(options.scene)}"
            processes.node("rosplat_tools", "ply_publisher", *remap, "-p", scene)
            if rviz:
                from ament_index_python.packages import get_package_share_directory

                processes.node("rosplat_tools", "demo_sensors", *remap)
                share = Path(get_package_share_directory("rviz_gaussian_plugin"))
                viewer = processes.start(
                    "rviz2", ["rviz2", "-d", str(share / "config/sensors.rviz")]
                )
                name = "rviz2"
                say("rviz2 is opening; close it to end the demo")
            else:
                name = "viewer"
                if screen:
                    say("the viewer is opening; close it or press Q to end the demo")
                up = [float(value) for value in options.up or vertical(options.scene) or (0, 0, 1)]
                output = [] if screen else ["-p", f"output:={quoted(options.out)}"]
                viewer = processes.node(
                    "rviz_gaussian_plugin", "viewer", *remap, "-p", f"up:={up}", *output
                )
            while viewer.poll() is None:
                processes.check(but=viewer)
                time.sleep(0.1)
            if viewer.returncode:
                raise ProcessError(
                    f"{name} ended with code {viewer.returncode}: {processes.last_line(name)}"
                )
            if not rviz:
                say(processes.said(name).rstrip())
            for warning in processes.warnings("ply_publisher"):
                print(f"demo: {warning}", file=sys.stderr)
    except (ProcessError, SceneError) as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1
    return 0
