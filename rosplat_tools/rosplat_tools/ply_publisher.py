"""Publishes a scene file as a map. Services load another scene, and save the map."""

from __future__ import annotations

import contextlib
import threading
import time
from concurrent.futures import CancelledError, Future, InvalidStateError, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.node import Node

from rosplat_core import formats
from rosplat_core.log_text import shown
from rosplat_core.program.output import told
from rosplat_core.program.progress import bar
from rosplat_core.scenes import NAMES, is_generated, load_scene_into, model_of
from rosplat_core.splats import LONGEST_ERROR, InputError, PackedSplats
from rosplat_msgs.srv import LoadScene, SaveMap
from rosplat_ros.map_publisher import MapPublisher
from rosplat_ros.program.files_below import check_below
from rosplat_ros.program.parameters import (
    declare,
    declare_compression,
    declare_model,
    declare_path,
)
from rosplat_ros.program.running import Cancelled, run_node, wait_for_end
from rosplat_tools.first_views import FirstViews

# Of callbacks: ~/load that sends, one that reads, one that cancels; ~/save, repeat, parameters.
THREADS = 6


class PlyPublisher(Node):
    """Publishes the scene of its parameter `path` on `gaussians`; serves `~/load` and `~/save`.

    Splats are held packed, as exact as displays hold them.
    """

    def __init__(self) -> None:
        # First: since Kilted, half-made nodes are destroyed, too. One scene is read at a time.
        self._reader = ThreadPoolExecutor(1, "reader")
        self._asking = threading.Lock()
        self._answer: Future[str] = (
            Future()
        )  # to the newest request; can be cancelled while it reads
        self._up: tuple[float, float, float] | None = None  # of the map, where it is known
        super().__init__("ply_publisher")
        self.path = declare_path(
            self, "path", "", f"Scene to publish: {NAMES}; empty: wait for ~/load."
        )
        frame_id = declare(self, "frame_id", "map", "Frame that the scene's coordinates are in.")
        self._scene_root = declare_path(
            self, "scene_root", "/", "Folder below which ~/load may read; empty: nowhere."
        )
        self._save_root = declare_path(
            self, "save_root", "", "Folder below which ~/save may write; empty: nowhere."
        )
        self._model = declare_model(self)
        self._views = FirstViews(self, frame_id)
        self._map = MapPublisher(
            self,
            frame_id=frame_id,
            compression=declare_compression(self),
        )
        self.create_service(
            LoadScene, "~/load", self._on_load, callback_group=ReentrantCallbackGroup()
        )
        self.create_service(
            SaveMap, "~/save", self._on_save, callback_group=MutuallyExclusiveCallbackGroup()
        )

    def load(self, path: str, root: str = "/") -> str:
        """Makes a scene below the folder root, at any depth, the map; returns a line about it.

        A later call cancels one that is still reading, at once. Raises InputError or Cancelled:
        the map stays.
        """
        if root != "/" and not is_generated(path):
            check_below("scene_root", root, path)
        answer = self._ask()
        self._reader.submit(self._serve, answer, path)
        try:
            return answer.result()
        except CancelledError:
            raise Cancelled from None

    def end_reading(self) -> None:
        """Cancels reading, and waits for its present step, which may take its time."""
        self._answer.cancel()
        self._reader.shutdown()

    def destroy_node(self) -> None:
        self.end_reading()
        super().destroy_node()

    def _ask(self) -> Future[str]:
        """The answer to a new request. Cancels an older request that is still reading."""
        with self._asking:
            self._answer.cancel()
            answer: Future[str] = Future()
            self._answer = answer
        return answer

    def _serve(self, answer: Future[str], path: str) -> None:
        try:
            answer.set_result(self._load(answer, path))
        except BaseException as error:
            with contextlib.suppress(InvalidStateError):  # nobody waits for it any more
                answer.set_exception(error)

    def _load(self, answer: Future[str], path: str) -> str:
        start = time.monotonic()
        self._raise_if_cancelled(answer)  # cancelled, maybe, while it waited
        splats = self._read(answer, path)
        view = self._views.find(path, splats)
        if not answer.set_running_or_notify_cancel():
            raise Cancelled
        self._views.offer(view)
        with bar("publishing", len(splats)) as drawn:

            def published(count: int) -> None:
                self._raise_if_cancelled(answer)
                drawn.update(count)

            before, self._up = self._up, splats.up  # a save may come while the map is sent
            try:
                self._map.replace(splats, progress=published)
            except MemoryError as error:
                self._up = before
                raise InputError(f"{path}: too large for this machine's memory") from error
            except BaseException:  # the map stays as it was
                self._up = before
                raise
        text = (
            f"{path}: {len(splats):,} splats, SH degree {splats.sh_degree}, "
            f"model {splats.model if self._model is not None else model_of(path, splats.model)}, "
            f"loaded and sent in {time.monotonic() - start:.1f} s"
        )
        self.get_logger().info(shown(text, 500))
        return text

    def _read(self, answer: Future[str], path: str) -> PackedSplats:
        with bar("loading") as drawn:

            def loaded(part: float) -> None:
                self._raise_if_cancelled(answer)
                drawn.update(part - drawn.n)
                if drawn.disable:
                    self.get_logger().info(
                        f"reading {shown(path)}: {part:.0%}", throttle_duration_sec=0.5
                    )

            warn = self.get_logger().warning
            splats = load_scene_into(formats.IntoPacked(), path, loaded, warn)
            return splats if self._model is None else replace(splats, model=self._model)

    def _raise_if_cancelled(self, answer: Future[str]) -> None:
        if answer.cancelled() or not self.context.ok():
            raise Cancelled

    def _on_load(
        self, request: LoadScene.Request, response: LoadScene.Response
    ) -> LoadScene.Response:
        try:
            if request.path:
                response.message = self.load(request.path, self._scene_root)
            else:
                self._ask()
                response.message = "loading was cancelled"
            response.success = True
        except Cancelled:
            response.message = (
                f"{request.path}: cancelled" if self.context.ok() else "the publisher ended"
            )
        except Exception as error:  # no file may end the node
            response.message = str(error) if isinstance(error, InputError) else f"{error!r}"
            self.get_logger().error(f"not loaded, the map stays: {shown(response.message, 500)}")
        response.message = shown(response.message, LONGEST_ERROR)
        response.splats = len(self._map)
        return response

    def _on_save(self, request: SaveMap.Request, response: SaveMap.Response) -> SaveMap.Response:
        try:
            check_below("save_root", self._save_root, request.path)
            _, splats = self._map.snapshot()
            Path(request.path).parent.mkdir(exist_ok=True)
            splats = replace(splats, up=self._up)
            formats.save(request.path, splats, overwrite=request.overwrite)
            response.splats = len(splats)
            response.message = f"{request.path}: {len(splats):,} splats"
            response.success = True
        except Exception as error:  # no request may end the node
            response.message = told(error)
        response.message = shown(response.message, LONGEST_ERROR)
        return response


def main() -> None:
    run_node("ply_publisher", PlyPublisher, _publish, THREADS)


def _publish(node: PlyPublisher) -> None:
    try:
        if not node.path:
            service = node.resolve_service_name("~/load")
            node.get_logger().info(f"no path is given: waiting for a call of {service}")
        else:
            with contextlib.suppress(Cancelled):  # by ~/load, or by the end of ROS
                node.load(node.path)
        wait_for_end(node)
    finally:
        node.end_reading()  # here, since a node may take no such time to be destroyed
