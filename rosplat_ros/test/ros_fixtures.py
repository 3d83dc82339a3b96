"""What tests of several packages share: a ROS node, the programs beside it, a listener to maps.

A conftest.py names it: `pytest_plugins = ["ros_fixtures"]`.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator

import pytest
import rclpy
from rclpy.node import Node

from rosplat_testing import PATIENCE, Listener


@pytest.fixture
def node() -> Iterator[Node]:
    """A node in a context and a namespace of its own, where no other test is heard."""
    context = rclpy.Context()
    rclpy.init(context=context)
    made = rclpy.create_node("test", namespace=f"/test_{uuid.uuid4().hex}", context=context)
    yield made
    made.destroy_node()
    context.try_shutdown()


@pytest.fixture
def start(node: Node) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts a program of rosplat_tools, or package.module, in the namespace of `node`.

    names: what topics are called instead.
    """
    started: list[subprocess.Popen[str]] = []

    def start(
        program: str, names: dict[str, str] | None = None, **parameters: object
    ) -> subprocess.Popen[str]:
        arguments = ["--ros-args", "-r", f"__ns:={node.get_namespace()}"]
        for name, meant in (names or {}).items():
            arguments += ["-r", f"{name}:={meant}"]
        for name, value in parameters.items():
            arguments += ["-p", f"{name}:={value}"]
        tool = f"from rosplat_tools.commands import {program}; exit({program}())"
        process = subprocess.Popen(
            [sys.executable, *(("-m", program) if "." in program else ("-c", tool)), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            raise


@pytest.fixture
def refusal(start: Callable[..., subprocess.Popen[str]]) -> Callable[..., str]:
    """Starts a program that must end with code 1 and a line that says why; returns the line."""

    def refusal(program: str, **parameters: object) -> str:
        process = start(program, **parameters)
        output, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 1, output
        (line,) = output.strip().splitlines()
        assert line.startswith(f"{program.rpartition('.')[2]}: ")
        return line

    return refusal


@pytest.fixture
def listener(node: Node) -> Listener:
    return Listener(node)
