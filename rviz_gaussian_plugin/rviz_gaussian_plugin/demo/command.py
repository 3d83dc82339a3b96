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
from rosplat_core.scenes import NAMES
from rosplat_core.splats import InputError
from rosplat_ros.program.processes import ProcessError, Processes, quoted

PROCEDURAL = "procedural:200000"
NEXT = """next:
  make demo SCENE=path/to/your/scene.ply
  . ./env.sh                      # the programs, in this shell
  ros2 run rosplat_tools inspect path/to/your/scene.ply
  ros2 run rosplat_tools ply_publisher --help
docs/guides/show.md tells more, docs/guides/publish.md how SLAM publishes a map"""


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
        help="the scene's vertical (default: the file's, or else by its ground)",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    screen = bool(os.environ.get("DISPLAY"))
    rviz = bool(shutil.which("rviz2")) and screen and not options.host
    # The viewer has a namespace for each demo; rviz2 also sees the user's other nodes and TF.
    namespace = "/" if rviz else f"/demo_{uuid.uuid4().hex[:8]}"
    remap = ["--ros-args", "-r", f"__ns:={namespace}"]
    try:
        with Processes(options.out / "log") as processes:
            scene = ["-p", f"path:={quoted(options.scene)}"]
            if options.up:
                scene += ["-p", f"up:={quoted(' '.join(map(str, options.up)))}"]
            if rviz:
                scene += ["-p", "frame_id:=scene", "-p", "upright_frame:=map"]
            processes.node("rosplat_tools", "ply_publisher", *remap, *scene)
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
                output = [] if screen else ["-p", f"output:={quoted(options.out)}"]
                viewer = processes.node("rviz_gaussian_plugin", "viewer", *remap, *output)
            while viewer.poll() is None:
                processes.check(but=viewer)
                time.sleep(0.1)
            if viewer.returncode:
                raise ProcessError(
                    f"{name} ended with code {viewer.returncode}: {processes.last_line(name)}"
                )
            if not rviz:
                say(processes.said(name).rstrip())
            say(NEXT)
            for warning in processes.warnings("ply_publisher"):
                print(f"demo: {warning}", file=sys.stderr)
    except (ProcessError, InputError) as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1
    return 0
