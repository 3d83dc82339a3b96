"""Records all topics, the map with the QoS that it needs and from its beginning."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import yaml
from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import ExecuteProcess, RegisterEventHandler
from launch.event_handlers import OnProcessIO
from launch.events.process import ProcessIO

from rosplat_ros.program.launching import ENDS_WITH_LAUNCH, description

ARGUMENTS = {
    "topic": ("/gaussians", "Topic of the map, with its namespace"),
    "output": ("", "Folder of the bag; by default named by the date"),
    "repeat": (
        True,
        "Have the map sent again once the recorder hears it; set false if the recorder starts "
        "before the map, or if the map's publisher doesn't answer TOPIC/repeat",
    ),
}


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` reads."""
    return description(ARGUMENTS, _recorder)


def _recorder(given: dict[str, Any]) -> list[ExecuteProcess | RegisterEventHandler]:
    topic = "/" + given["topic"].strip("/")  # rosbag2 uses full names
    exclude = "-x" if os.environ.get("ROS_DISTRO") == "humble" else "--exclude-regex"
    command = ["ros2", "bag", "record", "-a", exclude, f"(/gaussians|{topic})/(view|order)$"]
    command += ["--qos-profile-overrides-path", str(_qos(topic))]
    command += ["--output", given["output"]] if given["output"] else []
    recorder = _command(command)
    actions: list[ExecuteProcess | RegisterEventHandler] = [recorder]
    if given["repeat"]:
        request = ["ros2", "service", "call", f"{topic}/repeat", "rosplat_msgs/srv/RepeatMap"]
        repeats: list[ExecuteProcess] = []  # once

        def on_output(event: ProcessIO) -> list[ExecuteProcess]:
            if repeats or f"Subscribed to topic '{topic}'" not in event.text.decode():
                return []
            repeats.append(_command(request))
            return repeats

        told = OnProcessIO(target_action=recorder, on_stdout=on_output, on_stderr=on_output)
        actions.insert(0, RegisterEventHandler(told))
    return actions


def _command(words: list[str]) -> ExecuteProcess:
    """A call of ros2, which ends with the launch."""
    return ExecuteProcess(cmd=words, prefix=ENDS_WITH_LAUNCH, name="ros2", output="screen")


def _qos(topic: str) -> Path:
    """A file of QoS overrides for the map's topic."""
    shipped = Path(get_package_share_directory("rosplat_msgs"), "config", "rosbag2.yaml")
    if topic == "/gaussians":
        return shipped
    overrides = yaml.safe_load(shipped.read_text())
    path = Path(tempfile.mkdtemp(prefix="rosplat_"), "rosbag2.yaml")
    path.write_text(yaml.safe_dump({topic: overrides["/gaussians"]}))
    return path
