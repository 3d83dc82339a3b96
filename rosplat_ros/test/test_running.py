"""How nodes begin and end."""

import os
import subprocess
import sys

import pytest

from rosplat_testing import PATIENCE

INTERRUPTED_AS_IT_BEGINS = """
import time
from concurrent.futures import ThreadPoolExecutor
import rclpy
from rosplat_ros.program.running import spinning
submit = ThreadPoolExecutor.submit
def interrupted(pool, work):
    submit(pool, work)
    time.sleep(0.5)
    raise KeyboardInterrupt
ThreadPoolExecutor.submit = interrupted
rclpy.init()
try:
    with spinning(rclpy.create_node("test")):
        raise AssertionError("the block began")
except KeyboardInterrupt:
    print("ended", rclpy.ok())
"""


def test_an_interrupt_as_callbacks_begin_ends_them() -> None:
    command = [sys.executable, "-c", INTERRUPTED_AS_IT_BEGINS]
    run = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True)
    assert run.stdout == "ended False\n"


INTERRUPTED_AS_IT_MAKES_AN_EXECUTOR = """
import os
import signal
import rclpy
from rclpy import executors
from rosplat_ros.program.running import run, spinning, wait_for_end
class Interrupting(executors.SignalHandlerGuardCondition):
    def __init__(self, context):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(1000):
            pass
        super().__init__(context)
def body():
    node = rclpy.create_node("test")
    executors.SignalHandlerGuardCondition = Interrupting
    with spinning(node):
        print("begun")
        wait_for_end(node)
run("test", body)
"""


def test_an_interrupt_that_comes_as_an_executor_is_made_waits_for_it() -> None:
    command = [sys.executable, "-c", INTERRUPTED_AS_IT_MAKES_AN_EXECUTOR]
    run = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert (run.stdout, run.stderr) == ("", "")


LOSES_AN_INTERRUPT = """
import os
import signal
import rclpy
from rosplat_ros.program.running import run, spinning, wait_for_end
class Dropped:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(1000):
            pass
def body():
    Dropped()
    node = rclpy.create_node("test")
    with spinning(node):
        wait_for_end(node)
    print("ended", rclpy.ok())
run("test", body)
"""


def test_an_interrupt_that_python_drops_ends_a_node_all_the_same() -> None:
    command = [sys.executable, "-c", LOSES_AN_INTERRUPT]
    run = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True)
    assert "Exception ignored" in run.stderr
    assert run.stdout == "ended False\n"


def test_an_argument_that_ros_can_t_hold_is_a_matter_of_usage() -> None:
    code = "from rosplat_tools.commands import follow; follow()"
    command = [sys.executable, "-c", code, "--ros-args", "-p", b"path:=\xff.ply"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert run.returncode == 2
    assert run.stderr.splitlines()[-1].endswith(r"--ros-args: 'path:=\udcff.ply' is not UTF-8")


def test_where_ros_can_t_begin_a_line_says_why() -> None:
    code = "from rosplat_tools.commands import follow; follow()"
    command, environment = [sys.executable, "-c", code], os.environ | {"ROS_DOMAIN_ID": "abc"}
    run = subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE, check=False, env=environment
    )
    assert run.returncode == 1
    (line,) = run.stderr.splitlines()
    assert line.startswith("follow: ") and "ROS_DOMAIN_ID is not an integral number" in line


HANGS_AS_IT_ENDS = """
import ctypes
import rclpy
from rosplat_ros.program import running
running.LAST = 0.5
rclpy.init()
node = rclpy.create_node("test")
def hangs():
    ctypes.PyDLL(None).pause()  # with Python's lock, as rclpy does
node.destroy_node = hangs
with running.spinning(node):
    pass
"""


HALF_MADE = """
import ctypes
from rosplat_core.splats import InputError
from rosplat_ros.program import running
running.LAST = 0.5
class Half:
    def __init__(self):
        raise InputError("no such file")
    def __del__(self):
        hangs()
def hangs():
    ctypes.PyDLL(None).pause()
running.run_node("half", Half)
"""


@pytest.mark.parametrize("code", [HANGS_AS_IT_ENDS, HALF_MADE])
def test_a_node_that_hangs_as_it_ends_is_ended(code: str) -> None:
    command = [sys.executable, "-c", code]
    run = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert run.returncode == 1
    assert "in hangs" in run.stderr
