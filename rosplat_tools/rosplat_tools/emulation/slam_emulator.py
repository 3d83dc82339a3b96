"""Sends a scene as a SLAM back end would: grown by batches, refined, pruned and regrown.

With several `submaps`, each drifts until a loop closure puts all of them right.
"""

from __future__ import annotations

import time

from rclpy.node import Node
from tqdm import tqdm

from rosplat_core.log_text import shown
from rosplat_core.scenes import NAMES, PROCEDURAL, load_scene
from rosplat_core.splats import InputError
from rosplat_ros.map_publisher import MapPublisher
from rosplat_ros.program.parameter_help import stop_if_asked
from rosplat_ros.program.parameters import declare, declare_compression, declare_path
from rosplat_ros.program.running import run_node
from rosplat_tools.emulation.mapping import Move, around, edits, with_keyframes


class SlamEmulator(Node):
    """Publishes one edit of `gaussians` a tick; keeps the finished map for latecomers."""

    def __init__(self) -> None:
        """Loads the scene and starts the timer. Raises InputError."""
        self._bar = tqdm(disable=True)  # first: since Kilted, half-made nodes are destroyed, too
        super().__init__("slam_emulator")
        path = declare_path(self, "path", f"{PROCEDURAL}500000", f"Scene to arrive at: {NAMES}.")
        frame_id = declare(self, "frame_id", "map", "Frame that the scene's coordinates are in.")
        rate = declare(self, "rate", 10.0, "Messages per second. [Hz]", 0.01, 1000.0)
        self._loop = declare(self, "loop", False, "Start over when the scene is complete.")
        self._plan = {
            "batch_size": declare(
                self, "batch_size", 1000, "Most splats in a message.", 1, 1_000_000
            ),
            "refine_fraction": declare(
                self, "refine_fraction", 0.1, "Share of the splats that begin misplaced.", 0.0, 1.0
            ),
            "prune_fraction": declare(
                self,
                "prune_fraction",
                0.02,
                "Share of the splats that are deleted for a while.",
                0.0,
                1.0,
            ),
            "submaps": declare(
                self, "submaps", 1, "Parts that drift until a loop closure moves them.", 1, 400
            ),
            "seed": 0,
        }
        compression = declare_compression(self)
        stop_if_asked()  # the scene takes its time
        try:
            scene = around(load_scene(path, lambda _: None, self.get_logger().warning))
            self._scene = with_keyframes(scene, self._plan["batch_size"])
            self._edits = edits(self._scene, **self._plan)
        except ValueError as error:
            raise InputError(str(error)) from error
        self._map = MapPublisher(self, frame_id=frame_id, compression=compression)
        self.get_logger().info(f"mapping {shown(path)}: {len(self._scene):,} splats")
        self._bar = tqdm(
            total=len(self._scene), desc="mapping", unit="splats", unit_scale=True, disable=None
        )
        self._begin()
        self._timer = self.create_timer(1 / rate, self._step)

    def destroy_node(self) -> None:
        self._bar.close()
        super().destroy_node()

    def _begin(self) -> None:
        self._began = time.monotonic()
        self._map.replace(self._scene[:0], expected_slots=len(self._scene))

    def _step(self) -> None:
        edit = next(self._edits, None)
        if edit is None:
            self._finish()
            return
        if isinstance(edit, Move):
            self._map.move(edit.poses)
        elif edit.splats is None:
            self._map.delete(edit.slots)
        else:
            self._map.upsert(edit.slots, edit.splats, group=edit.group)
        self._bar.update(len(self._map) - self._bar.n)

    def _finish(self) -> None:
        self.get_logger().info(
            f"{len(self._map):,} splats mapped in {time.monotonic() - self._began:.1f} s"
        )
        if self._loop:
            self._edits = edits(self._scene, **self._plan)
            self._begin()
        else:
            self._bar.close()
            self._timer.cancel()


def main() -> None:
    run_node("slam_emulator", SlamEmulator)
