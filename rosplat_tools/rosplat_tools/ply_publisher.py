"""Publishes a scene file as a map: latched, in chunks, replaced and saved by services."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from pathlib import Path

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.node import Node

from rosplat_msgs.srv import LoadScene, SaveMap
from rosplat_sorter.log_text import shown
from rosplat_tools import formats
from rosplat_tools.map_publisher import CHUNK_BYTES, MapPublisher
from rosplat_tools.program.parameters import declare, declare_compression
from rosplat_tools.program.progress import bar
from rosplat_tools.program.running import Cancelled, run, spinning, wait_for_end
from rosplat_tools.scenes import NAMES, is_generated, load_scene
from rosplat_tools.slot_order import put_in_slot_order
from rosplat_tools.splats import SceneError


class PlyPublisher(Node):
    """Publishes the scene of its parameter `path` on `gaussians`; serves `~/load` and `~/save`."""

    def __init__(self) -> None:
        super().__init__("ply_publisher")
        self.path: str = declare(
            self, "path", "", f"Scene to publish: {NAMES}; empty to wait for ~/load."
        )
        frame_id = declare(self, "frame_id", "map", "Frame that the scene's coordinates are in.")
        chunk_bytes = declare(
            self, "chunk_bytes", CHUNK_BYTES, "Size of a message at most. [bytes]", 100_000, 10**9
        )
        self._scene_root: str = declare(
            self, "scene_root", "/", "Folder below which ~/load may read; empty: nowhere."
        )
        self._save_root: str = declare(
            self, "save_root", "", "Folder below which ~/save may write; empty: nowhere."
        )
        self._map = MapPublisher(
            self,
            frame_id=frame_id,
            chunk_bytes=chunk_bytes,
            compression=declare_compression(self),
        )
        self._busy = threading.Lock()
        self._requests = itertools.count(1)
        self._newest = 0  # request
        # Each of its own: what is being loaded can be ended.
        self.create_service(
            LoadScene, "~/load", self._on_load, callback_group=ReentrantCallbackGroup()
        )
        self.create_service(
            SaveMap, "~/save", self._on_save, callback_group=MutuallyExclusiveCallbackGroup()
        )

    def load(self, path: str, root: str = "/") -> str:
        """Makes a scene, a file of a folder at any depth, the map; returns what was loaded.

        A later call ends one that is still reading. Raises SceneError or Cancelled: the map stays.
        """
        start = time.monotonic()
        self._newest = mine = next(self._requests)
        if root != "/" and not is_generated(path):
            _check_below("scene_root", root, path)
        with self._busy:
            with bar("loading") as drawn:

                def loaded(part: float) -> None:
                    self._go_on()
                    if self._newest != mine:
                        raise Cancelled
                    drawn.update(part - drawn.n)
                    if drawn.disable:
                        self.get_logger().info(
                            f"reading {shown(path)}: {part:.0%}", throttle_duration_sec=0.5
                        )

                splats = load_scene(path, loaded, self.get_logger().warning)
                put_in_slot_order(splats)
                loaded(1.0)
            with bar("publishing", len(splats)) as drawn:

                def published(count: int) -> None:
                    self._go_on()
                    drawn.update(count)

                try:
                    self._map.replace(splats, progress=published)
                except MemoryError as error:
                    raise SceneError(f"{path}: too large for this machine's memory") from error
        text = (
            f"{path}: {len(splats):,} splats, SH degree {splats.without_empty_bands().sh_degree}, "
            f"loaded and sent in {time.monotonic() - start:.1f} s"
        )
        self.get_logger().info(shown(text, 500))
        return text

    def _go_on(self) -> None:
        if not self.context.ok():
            raise Cancelled

    def _on_load(
        self, request: LoadScene.Request, response: LoadScene.Response
    ) -> LoadScene.Response:
        try:
            if request.path:
                response.message = self.load(request.path, self._scene_root)
            else:
                self._newest = next(self._requests)
                response.message = "what was being loaded is not read any further"
            response.success = True
        except Cancelled:
            response.message = (
                f"{request.path}: cancelled" if self.context.ok() else "the publisher ended"
            )
        except Exception as error:  # no file may end the node
            response.message = str(error) if isinstance(error, SceneError) else f"{error!r}"
            self.get_logger().error(f"not loaded, the map stays: {shown(response.message, 500)}")
        response.splats = len(self._map)
        return response

    def _on_save(self, request: SaveMap.Request, response: SaveMap.Response) -> SaveMap.Response:
        try:
            _check_below("save_root", self._save_root, request.path)
            if Path(request.path).exists() and not request.overwrite:
                raise SceneError(f"{request.path}: exists already; set overwrite to replace it")
            _, splats = self._map.snapshot()
            formats.save(request.path, splats)
            response.splats = len(splats)
            response.message = f"{request.path}: {len(splats):,} splats"
            response.success = True
        except Exception as error:  # no request may end the node
            response.message = str(error) or "not enough memory"
        return response


def _check_below(parameter: str, root: str, path: str) -> None:
    """Raises SceneError for a path that leads out of a folder, by links or otherwise."""
    try:
        if root and Path(path).resolve().is_relative_to(Path(root).resolve()):
            return
    except (OSError, RuntimeError, ValueError):  # a circle of links, or no name of a file
        pass
    why = f"not below {root}, its" if root else "none is allowed by its"
    raise SceneError(f"{path}: refused by the publisher: {why} parameter {parameter}")


def main() -> None:
    """Runs the node until it is told to end; exit code 1 where the scene of `path` is none."""
    run("ply_publisher", _publish)


def _publish() -> None:
    node = PlyPublisher()
    with spinning(node, threads=2):
        if node.path:
            with contextlib.suppress(Cancelled):  # by ~/load, or by the end of ROS
                node.load(node.path)
        wait_for_end(node)


if __name__ == "__main__":
    main()
