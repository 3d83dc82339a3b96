"""The README's Python is what it says: it runs, block after block, as a newcomer would paste it."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

README = Path(__file__).resolve().parents[1] / "README.md"

# What its text leaves to the reader.
OF_THE_READER = """
import numpy as np
ids = slots = labels = confidences = np.arange(1000)
pose = np.eye(4)
corrected = {submap: pose for submap in (1, 2, 3)}
"""
SAYS = """
slots, splats = publisher.snapshot()
print(len(publisher), slots[-1], *splats.channels)
"""


def test_its_python_runs() -> None:
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert "rclpy.spin(node)" in blocks[0]
    script = OF_THE_READER + "\n".join(blocks).replace("rclpy.spin(node)", "pass") + SAYS
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert run.stderr == ""
    assert run.stdout == "2000 4071 label confidence\n"
