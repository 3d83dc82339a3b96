"""Memory of programs that live for hours."""

import os
import subprocess
import sys
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

# Messages of megabytes come and go, and a little of each stays.
MESSAGES = """
from pathlib import Path
from rosplat_sorter.memory import give_back_large_blocks

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
from rosplat_sorter.memory import take_little_shared_memory

if sys.argv[1:]:
    take_little_shared_memory()
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
