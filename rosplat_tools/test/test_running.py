"""How nodes begin and end."""

import subprocess
import sys

INTERRUPTED_AS_IT_BEGINS = """
import time
from concurrent.futures import ThreadPoolExecutor
import rclpy
from rosplat_tools.running import spinning
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
    run = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert run.stdout == "ended False\n"
