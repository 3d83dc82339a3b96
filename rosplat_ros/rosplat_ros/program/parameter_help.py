"""What --help says of a node's parameters: by what the node itself declares.

The node is made as if it were run, alone and with its defaults, up to where its callbacks would
begin.
"""

from __future__ import annotations

import os
import textwrap
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

asked = False
"""Whether --help wants to know parameters: then no callback may begin (`stop_if_asked`)."""

TYPES = {bool: "true or false", int: "whole number", float: "number", str: "text", list: "list"}
WIDTH = 100
OF_RCLPY = ("use_sim_time", "start_type_description_service")  # which every node has

Declared = dict[str, tuple[Any, ParameterDescriptor]]
"""Defaults and descriptors by name."""


class _Stop(BaseException):
    pass


def stop_if_asked() -> None:
    """Ends a node that only --help made. Called when it has declared its parameters."""
    if asked:
        raise _Stop


def declared_by(body: Callable[[], None]) -> Declared:
    """The parameters that a program's body declares until it runs callbacks, or fails."""
    global asked
    declared: Declared = {}
    declare = Node.declare_parameter

    def record(node: Node, name: str, *arguments: Any, **named: Any) -> Any:
        given = dict(zip(("value", "descriptor"), arguments, strict=False)) | named
        descriptor = given.get("descriptor") or ParameterDescriptor()
        declared[name] = (given.get("value"), descriptor)
        return declare(node, name, *arguments, **named)

    environment = dict(os.environ)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"  # nobody is to meet this node
    Node.declare_parameter = record  # type: ignore[method-assign, assignment]
    asked = True
    try:
        rclpy.init(args=["--ros-args", "--log-level", "FATAL"])
        with suppress(_Stop, Exception):  # some nodes need a path, for example
            body()
    finally:
        asked = False
        Node.declare_parameter = declare  # type: ignore[method-assign]
        rclpy.try_shutdown()
        os.environ.clear()
        os.environ.update(environment)
    return declared


def described(declared: Declared) -> str:
    """A text about parameters, one after the other."""
    lines = ["parameters:"]
    for name, (default, descriptor) in declared.items():
        if name in OF_RCLPY or name.startswith("qos_overrides."):
            continue
        kind = TYPES.get(type(default), type(default).__name__)
        ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
        if ranges:
            kind += f" from {ranges[0].from_value:.10g} to {ranges[0].to_value:.10g}"
        shown = str(default).lower() if isinstance(default, bool) else repr(default)
        lines.append(f"  {name} ({kind}, default {shown})")
        lines += textwrap.wrap(
            descriptor.description, WIDTH, initial_indent=6 * " ", subsequent_indent=6 * " "
        )
    return "\n".join(lines)
