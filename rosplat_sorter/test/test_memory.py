"""Memory of programs that live for hours."""

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

from ament_index_python.packages import get_package_share_directory

# Messages of megabytes come and go, and a little of each stays.
MESSAGES = """
from pathlib import Path
from rosplat_ros.program.memory import give_back_large_blocks

def held():
    return 4096 * int(Path("/proc/self/statm").read_text().split()[1])

give_back_large_blocks()
before = held()
for size in range(1, 9):
    bytes(size << 20)
messages, stays = [], []
for _ in range(20):
    messages.append(b"m" * (7 << 20))
    stays.append(b"s" * 100_000)
messages.clear()
print(held() - before)
"""


def test_large_blocks_are_given_back() -> None:
    """Of 147 MB, which stay without give_back_large_blocks, 2 are still in use."""
    command = [sys.executable, "-c", MESSAGES]
    grown = int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert grown < 20e6


SHARED = """
import sys
from pathlib import Path
import rclpy
from rosplat_ros.program.middleware import prepare_fast_dds

if sys.argv[1:]:
    prepare_fast_dds(sends_maps=False)
rclpy.init()
node = rclpy.create_node("node")
status = Path("/proc/self/status").read_text()
print(status.partition("RssShmem:")[2].split()[0])
"""


def test_who_sends_no_maps_takes_little_shared_memory() -> None:
    profile = Path(get_package_share_directory("rosplat_msgs")) / "config" / "fastdds.xml"
    names = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
    environment = os.environ | dict.fromkeys(names, str(profile))

    def taken(*words: str) -> int:
        command = [sys.executable, "-c", SHARED, *words]
        text = subprocess.run(
            command, capture_output=True, text=True, check=True, env=environment
        ).stdout
        return 1024 * int(text)

    assert taken() > 32 << 20  # as the profile has it
    assert taken("little") < 8 << 20


def test_what_a_cut_line_kept_is_soon_sent_again() -> None:
    """Receivers get nothing that follows before the next heartbeat, 3 s later by default."""
    folder = Path(get_package_share_directory("rosplat_msgs")) / "config"
    for name in ("fastdds.xml", "fastdds_small.xml"):
        writer = ElementTree.parse(folder / name).find(".//{*}data_writer[@is_default_profile]")
        assert writer is not None
        seconds = int(writer.findtext(".//{*}sec") or 0)
        seconds += 1e-9 * int(writer.findtext(".//{*}nanosec") or 0)
        assert 0 < seconds <= 0.5


CALLBACKS = """
import gc
import os
import signal
import threading
import types
import rclpy
from rosplat_msgs.msg import ViewCamera
from rosplat_ros import qos
from rosplat_sorter import node

def functions():
    return sum(isinstance(each, types.FunctionType) for each in gc.get_objects())

seen = threading.Semaphore(0)
node.SorterNode._on_view = lambda self, message: seen.release()

def look():
    while not rclpy.ok():
        pass
    views = rclpy.create_node("peer").create_publisher(ViewCamera, "gaussians/view", qos.VIEW)
    while not views.get_subscription_count():
        pass
    for count in range(1000):
        if count == 100:
            before = functions()
        views.publish(ViewCamera())
        seen.acquire()
    print(functions() - before)
    os.kill(os.getpid(), signal.SIGINT)

threading.Thread(target=look, daemon=True).start()
node.main()
"""


def test_nothing_is_kept_of_a_callback() -> None:
    """rclpy's spin_until_future_complete keeps a function of each: a megabyte a minute."""
    command = [sys.executable, "-c", CALLBACKS, "--ros-args", "-r", f"__ns:=/memory_{os.getpid()}"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert int(done.stdout) < 100
