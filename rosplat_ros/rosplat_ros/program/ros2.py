"""A stand-in for the command ros2, for machines whose ROS 2 comes from PyPI, which has none."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile, qos_profile_sensor_data

from rosplat_core.program.output import say
from rosplat_core.splats import InputError
from rosplat_ros.messages import message_class
from rosplat_ros.program.processes import ProcessError, node_command

COMMANDS = ("run", "topic", "node", "param")
ELSEWHERE = "come with an installed ROS 2; `make demo SCENE=path` shows a scene without"
SETTLED = 1.5  # the graph is known once it stayed the same for so long [s]
PATIENCE = 5.0  # for the first other node, and for a node's answer [s]


class CommandError(RuntimeError):
    """What a user asked for that there isn't; the text says what."""


def discover(node: Node) -> None:
    """Waits until there are other nodes and the graph stays the same, for PATIENCE at most."""
    known: set[str] = set()
    since = time.monotonic()
    end = since + PATIENCE
    while time.monotonic() < min(end, since + SETTLED):
        time.sleep(0.1)
        others = _nodes(node)
        found = others | {name for name, _ in node.get_topic_names_and_types()}
        if found != known or not others:
            known, since = found, time.monotonic()


def _nodes(node: Node) -> set[str]:
    """The full names of all other nodes."""
    found = {f"{space.rstrip('/')}/{name}" for name, space in node.get_node_names_and_namespaces()}
    return found - {node.get_fully_qualified_name()}


def run_program(options: argparse.Namespace) -> None:
    """Becomes a package's program."""
    try:
        command = node_command(options.package, options.program, *options.arguments)
    except ProcessError as error:
        raise CommandError(str(error)) from error
    program = Path(command[0])
    if not program.is_file():
        there = ", ".join(sorted(path.name for path in program.parent.glob("*"))) or "none"
        raise CommandError(f"{options.package} has no program {options.program}, it has {there}")
    os.execv(program, command)


def list_topics(node: Node, options: argparse.Namespace) -> None:
    """Prints the names of topics, or their types as well."""
    for name, types in sorted(node.get_topic_names_and_types()):
        say(f"{name} [{', '.join(types)}]" if options.show_types else name)


def list_nodes(node: Node, options: argparse.Namespace) -> None:
    """Prints the full names of nodes."""
    for name in sorted(_nodes(node)):
        if options.all or not name.rpartition("/")[2].startswith("_"):
            say(name)


def echo_topic(node: Node, options: argparse.Namespace) -> None:
    """Prints messages of a topic; of long arrays, how many elements there are."""
    topic = _full(options.topic)
    types = dict(node.get_topic_names_and_types()).get(topic)
    if not types:
        raise CommandError(f"nobody publishes {topic}")
    publishers = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]
    offered = publishers[0] if len(publishers) == 1 else qos_profile_sensor_data
    profile = QoSProfile(depth=10, reliability=offered.reliability, durability=offered.durability)
    heard = []

    def show(message: object) -> None:
        say(f"{text_of(message)}\n---")
        heard.append(message)

    kind = message_class(types[0])
    node.create_subscription(kind, topic, show, profile)
    while not (options.once and heard):
        rclpy.spin_once(node, timeout_sec=0.1)


def text_of(value: object, indent: str = "") -> str:
    """A message as lines of names and values."""
    lines = []
    for name in value.get_fields_and_field_types():  # type: ignore[attr-defined]
        part = getattr(value, name)
        if hasattr(part, "get_fields_and_field_types"):
            lines.append(f"{indent}{name}:\n{text_of(part, indent + '  ')}")
        elif isinstance(part, (str, bytes)) or not hasattr(part, "__len__"):
            lines.append(f"{indent}{name}: {part}")
        elif len(part) > 16:
            lines.append(f"{indent}{name}: <{len(part):,} elements>")
        elif len(part) and hasattr(part[0], "get_fields_and_field_types"):
            inner = indent + "  "
            items = (f"{indent}- {text_of(each, inner).removeprefix(inner)}" for each in part)
            lines.append("\n".join([f"{indent}{name}:", *items]))
        else:  # NumPy's numbers among them
            lines.append(f"{indent}{name}: {np.asarray(part).tolist()}")
    return "\n".join(lines)


def _ask(node: Node, options: argparse.Namespace, method: str, *arguments: object) -> Any:
    """What a node's parameter services answer to a method of AsyncParameterClient."""
    name = _full(options.node)
    client = AsyncParameterClient(node, name)
    if not client.wait_for_services(PATIENCE):
        raise CommandError(f"nobody serves the parameters of {name}")
    answer = getattr(client, method)(*arguments)
    rclpy.spin_until_future_complete(node, answer, timeout_sec=PATIENCE)
    if not answer.done():
        raise CommandError(f"{name} gives no answer")
    return answer.result()


def _full(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


def list_parameters(node: Node, options: argparse.Namespace) -> None:
    """Prints the names of a node's parameters."""
    say("\n".join(_ask(node, options, "list_parameters").result.names))


def get_parameter(node: Node, options: argparse.Namespace) -> None:
    """Prints the value of a node's parameter."""
    values = _ask(node, options, "get_parameters", [options.parameter]).values
    value = parameter_value_to_python(values[0]) if values else None
    if value is None:
        raise CommandError(f"{options.node} has no parameter {options.parameter}")
    say(f"{value}")


def describe_parameter(node: Node, options: argparse.Namespace) -> None:
    """Prints what a node's parameter is for."""
    descriptors = _ask(node, options, "describe_parameters", [options.parameter]).descriptors
    if not descriptors:
        raise CommandError(f"{options.node} has no parameter {options.parameter}")
    say(f"{options.parameter}: {descriptors[0].description}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ros2",
        description=__doc__,
        epilog=f"launch, bag, service and the rest {ELSEWHERE}",
    )
    verbs = parser.add_subparsers(required=True, metavar="COMMAND")
    run = verbs.add_parser("run", help="run a package's program", prefix_chars="\0", add_help=False)
    run.add_argument("package")
    run.add_argument("program")
    run.add_argument("arguments", nargs=argparse.REMAINDER)
    run.set_defaults(work=run_program)

    def group(name: str, what: str) -> Callable[..., argparse.ArgumentParser]:
        parts = verbs.add_parser(name, help=what).add_subparsers(required=True, metavar="COMMAND")

        def verb(
            part: str, work: Callable[[Node, argparse.Namespace], None], *names: str
        ) -> argparse.ArgumentParser:
            made = parts.add_parser(part, help=work.__doc__, description=work.__doc__)
            for argument in names:
                made.add_argument(argument)
            made.set_defaults(work=work)
            return made

        return verb

    topic, node, param = (
        group("topic", "topics"),
        group("node", "nodes"),
        group("param", "parameters"),
    )
    topic("list", list_topics).add_argument("-t", "--show-types", action="store_true")
    topic("echo", echo_topic, "topic").add_argument("--once", action="store_true")
    node("list", list_nodes).add_argument(
        "-a", "--all", action="store_true", help="hidden ones, too"
    )
    param("list", list_parameters, "node")
    param("get", get_parameter, "node", "parameter")
    param("describe", describe_parameter, "node", "parameter")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 1 where there isn't what it asks for."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] and arguments[0].isalpha() and arguments[0] not in COMMANDS:
        print(f"ros2: {arguments[0]}: it and others {ELSEWHERE}", file=sys.stderr)
        return 2
    options = _parser().parse_args(arguments)
    try:
        if options.work is run_program:
            run_program(options)
        rclpy.init(args=[])
        node = rclpy.create_node(f"_ros2_{os.getpid()}")
        discover(node)
        options.work(node, options)
    except (CommandError, InputError) as error:
        print(f"ros2: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    finally:
        rclpy.try_shutdown()
    return 0
