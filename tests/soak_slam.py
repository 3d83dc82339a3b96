"""The SLAM back end of soak.py: a map that grows, closes loops and prunes, for ever.

What it publishes follows from seed and size alone, so that its observers know each step's map.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from rosplat_tools.emulation.mapping import Edit, edits
from rosplat_tools.generate import generate
from rosplat_tools.map_publisher import MapPublisher
from rosplat_tools.program.running import run, spinning, wait_for_end
from rosplat_tools.slot_map import SlotMap

RATE = 10.0  # messages a second
BATCH = 1000  # splats of a message
CLOSURE = 20 * BATCH  # splats that a loop closure moves
PRUNINGS = 15  # and mapping again what was pruned, from one to the next
SHIFT = 0.02  # by which it does [m]


def steps(size: int) -> Iterator[Edit]:
    """Every edit there will ever be, one a message."""
    scene = generate(size, seed=0, sh_degree=0)
    yield from edits(scene, batch_size=BATCH, refine_fraction=0.1, prune_fraction=0.02, seed=0)
    rng = np.random.default_rng(0)
    while True:
        first = int(rng.integers(max(1, size - CLOSURE)))
        moved = range(first, min(first + CLOSURE, size))
        scene.positions[moved.start : moved.stop] += rng.normal(0, SHIFT, 3).astype(np.float32)
        yield Edit(moved, scene[moved.start : moved.stop])
        for _ in range(PRUNINGS):
            pruned = np.sort(rng.choice(size, min(BATCH, size), replace=False))
            yield Edit(pruned, None)
            yield Edit(pruned, scene[pruned])


class Slam(Node):
    """Publishes a step a tick, and writes to a file which revision of which map it was."""

    def __init__(self, size: int, trace: Path) -> None:
        super().__init__("slam")
        self._steps = steps(size)
        self._map = MapPublisher(self)
        self._trace = trace.open("a", buffering=1)
        self._step = 0
        done = last_step(trace)
        if done:  # as a back end that was killed goes on from its checkpoint
            held = SlotMap()
            for _ in range(done):
                apply(held, next(self._steps))
            slots, splats = held.snapshot()
            self._map.replace(splats[:0], expected_slots=size)
            self._map.upsert(slots, splats)
            self._step = done
        else:
            self._map.replace(generate(1, sh_degree=0)[:0], expected_slots=size)
        self._tell()
        # Simulated time may jump.
        self.create_timer(1 / RATE, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _tick(self) -> None:
        edit = next(self._steps)
        if edit.splats is None:
            self._map.delete(edit.slots)
        else:
            self._map.upsert(edit.slots, edit.splats)
        self._step += 1
        self._tell()

    def _tell(self) -> None:
        self._trace.write(f"{self._map.map_id} {self._map.revision} {self._step}\n")


def apply(held: SlotMap, edit: Edit) -> None:
    """Does an edit to a map."""
    if edit.splats is None:
        held.clear(edit.slots)
    else:
        held.write(edit.slots, edit.splats)


def last_step(trace: Path) -> int:
    """What the file says was published last, 0 where nothing was."""
    if not trace.exists():
        return 0
    with trace.open("rb") as file:
        file.seek(max(0, trace.stat().st_size - 200))
        _, *lines, _ = [b"", *file.read().split(b"\n")]  # but for one that is being written
    return int(lines[-1].split()[2]) if lines else 0


def main() -> None:
    """soak_slam.py SIZE TRACE"""
    size, trace = int(sys.argv[1]), Path(sys.argv[2])
    del sys.argv[1:3]

    def publish() -> None:
        node = Slam(size, trace)
        with spinning(node):
            wait_for_end(node)

    run("soak_slam", publish)


if __name__ == "__main__":
    main()
