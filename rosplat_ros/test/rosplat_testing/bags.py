"""For tests of what reads bags: bags of a few messages."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest
from rclpy.serialization import serialize_message

HAVE = [name for name in ("rosbag2_py", "rosbags") if importlib.util.find_spec(name)]
needs_bags = pytest.mark.skipif(not HAVE, reason="neither rosbag2_py nor rosbags is installed")


def record(path: Path, messages: list[tuple[str, Any]]) -> None:
    """Writes a bag, by the library that is here."""
    kinds = {topic: type(message) for topic, message in messages}
    names = {topic: _type_name(kind) for topic, kind in kinds.items()}
    if "rosbag2_py" in HAVE:
        import rosbag2_py

        writer = rosbag2_py.SequentialWriter()
        writer.open(
            rosbag2_py.StorageOptions(str(path), "mcap"), rosbag2_py.ConverterOptions("", "")
        )
        for number, (topic, name) in enumerate(names.items()):
            writer.create_topic(rosbag2_py.TopicMetadata(number, topic, name, "cdr"))
        for time, (topic, message) in enumerate(messages):
            writer.write(topic, serialize_message(message), time)
        return
    from rosbags.rosbag2 import Writer

    with Writer(path, version=9) as bag:
        connections = {
            topic: bag.add_connection(topic, name, msgdef="", rihs01="RIHS01_0")
            for topic, name in names.items()
        }
        for time, (topic, message) in enumerate(messages):
            bag.write(connections[topic], time, serialize_message(message))


def _type_name(kind: type) -> str:
    package, sub = kind.__module__.split(".")[:2]
    return f"{package}/{sub}/{kind.__name__}"
