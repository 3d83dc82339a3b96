"""The SLAM back end of soak.py: a map that grows, closes loops and prunes, for ever.

What it publishes follows from seed and size alone, so that its observers know each step's map.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Header

from rosplat_core.generated import generate
from rosplat_core.view import frame_at
from rosplat_msgs.msg import GaussianArray
from rosplat_ros.map_publisher import MapPublisher
from rosplat_ros.poses import to_pose
from rosplat_ros.program.running import run, spinning, wait_for_end
from rosplat_tools.emulation.mapping import Edit, Move, edits

sys.path.insert(0, str(Path(__file__).parents[1] / "rosplat_ros/test"))
from rosplat_testing.messages import encode, encode_deletion, encode_move
from rosplat_testing.slot_map import SlotMap, apply

RATE = 10.0  # messages a second
BATCH = 1000  # splats of a message
MOST_SUBMAPS = 50
PRUNINGS = 15  # and mapping again what was pruned, from one loop closure to the next
SHIFT = 0.02  # by which it moves a submap [m], and turns it [rad]


def steps(size: int) -> Iterator[Edit | Move]:
    """Every edit there will ever be, one a message."""
    scene = generate(size, seed=0, sh_degree=0)
    submaps = min(MOST_SUBMAPS, max(2, size // (20 * BATCH)))
    grown = SlotMap()
    for step in edits(
        scene, batch_size=BATCH, refine_fraction=0.1, prune_fraction=0.02, seed=0, submaps=submaps
    ):
        apply(as_message(step), grown)
        yield step
    groups = grown.groups()
    del scene, grown
    rng = np.random.default_rng(0)
    while True:
        moved = rng.permutation(submaps)[: submaps // 2].tolist()
        yield Move({group: _somewhere_near(rng) for group in moved})
        for _ in range(PRUNINGS):
            part = groups[rng.integers(submaps)]
            pruned = np.sort(rng.permutation(len(part.slots))[:BATCH])
            slots = part.slots[pruned]
            yield Edit(slots, None, part.group)
            yield Edit(slots, part.splats[pruned], part.group)


def _somewhere_near(rng: np.random.Generator) -> NDArray[np.float64]:
    return frame_at(rng.normal(0, SHIFT, 3), (*rng.normal(0, SHIFT / 2, 3), 1.0))


def as_message(step: Edit | Move, revision: int = 1) -> GaussianArray:
    """What tells of a step."""
    of = {"header": Header(), "map_id": "steps", "revision": revision}
    if isinstance(step, Move):
        return encode_move({group: to_pose(pose) for group, pose in step.poses.items()}, **of)
    if step.splats is None:
        return encode_deletion(step.slots, **of)
    of |= {"operation": GaussianArray.UPSERT, "group": step.group}
    return encode(step.splats, step.slots, **of)


class Slam(Node):
    """Publishes a step a tick, and writes to a file which revision of which map it was."""

    def __init__(self, size: int, trace: Path) -> None:
        super().__init__("slam")
        self._steps = steps(size)
        self._map = MapPublisher(self)
        self._map.expect(size)
        self._trace = trace.open("a", buffering=1)
        self._step = 0
        done = last_step(trace)
        if done:  # as a back end that was killed goes on from its checkpoint
            held = SlotMap()
            for _ in range(done):
                apply(as_message(next(self._steps)), held)
            self._map.move(held.poses)
            for part in held.groups():
                self._map.upsert(part.slots, part.splats, group=part.group)
            self._step = done
        self._tell()
        # Simulated time may jump.
        self.create_timer(1 / RATE, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _tick(self) -> None:
        step = next(self._steps)
        if isinstance(step, Move):
            self._map.move(step.poses)
        elif step.splats is None:
            self._map.delete(step.slots)
        else:
            self._map.upsert(step.slots, step.splats, group=step.group)
        self._step += 1
        self._tell()

    def _tell(self) -> None:
        self._trace.write(f"{self._map.map_id} {self._map.revision} {self._step}\n")


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
