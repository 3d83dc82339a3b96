"""What --help says of a node's parameters."""

from __future__ import annotations

import rclpy
from rclpy.node import Node

from rosplat_core.splats import InputError
from rosplat_ros.program.parameter_help import declared_by, described
from rosplat_ros.program.parameters import declare
from rosplat_ros.program.running import spinning


class Wheel(Node):
    def __init__(self) -> None:
        super().__init__("wheel")
        declare(self, "radius", 0.25, "How large it is. [m]", 0.1, 2)
        declare(self, "spokes", 8, "How many spokes it has.", 3, 64)
        declare(self, "frame_id", "hub", "Frame of its axis.")
        declare(self, "turns", True, "Whether it turns.")


def test_all_that_a_node_declares_is_described() -> None:
    reached = []

    def body() -> None:
        node = Wheel()
        with spinning(node):
            reached.append("its callbacks")

    text = described(declared_by(body))
    assert not reached
    assert not rclpy.ok()
    assert "  radius (number from 0.1 to 2, default 0.25)\n      How large it is. [m]" in text
    assert "  spokes (whole number from 3 to 64, default 8)" in text
    assert "  frame_id (text, default 'hub')" in text
    assert "  turns (true or false, default true)" in text


def test_a_node_that_its_defaults_end_is_described_up_to_there() -> None:
    def body() -> None:
        Wheel()
        raise InputError("no road is named")

    declared = declared_by(body)
    assert list(declared)[-4:] == ["radius", "spokes", "frame_id", "turns"]
    assert "use_sim_time" not in described(declared)
