"""Memory of programs that live for hours."""

import subprocess
import sys

import pytest

# Messages of megabytes come and go, and a little of each stays.
MESSAGES = """
import sys
from pathlib import Path
from rosplat_sorter.memory import give_back_large_blocks

def held():
    return 4096 * int(Path("/proc/self/statm").read_text().split()[1])

if sys.argv[1] == "given back":
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


@pytest.mark.parametrize("given_back", [True, False])
def test_large_blocks_are_given_back(given_back: bool) -> None:
    command = [sys.executable, "-c", MESSAGES, "given back" if given_back else "kept"]
    grown = int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert (grown < 20e6) == given_back
