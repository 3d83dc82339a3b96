"""The thread that applies edits and sorts, so that the node only passes messages on."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from rosplat_core.log_text import shown
from rosplat_core.posed_camera import CameraError, PosedCamera
from rosplat_core.view import SortView
from rosplat_msgs.msg import GaussianArray, SplatOrder, ViewCamera
from rosplat_ros import view_cameras
from rosplat_ros.held_map import HeldMap
from rosplat_ros.messages import is_frame
from rosplat_ros.program.said_once import Throttled
from rosplat_sorter import backends
from rosplat_sorter.backends import AUTO, Backend, Unavailable
from rosplat_sorter.map import SplatMap
from rosplat_sorter.order_slots import pack
from rosplat_sorter.shared_orders import OrderBuffer, SharedOrders

T = TypeVar("T")

# Viewers send their cameras at least each second; a viewer silent for so long is gone. [s]
FORGET_AFTER = 10.0
MAX_VIEWS = 32

MOST_SHOWN = 300  # characters of an error in a line of the log

# Between two answers to a view while a pull is under way, at least. [s]
PULL_PATIENCE = 1.0

# Of batches: once so much is applied, the next view gets its answer. [bytes]
SLICE = 1 << 22


@dataclass
class _Viewer:
    message: ViewCamera
    camera: PosedCamera
    seen: float
    due_from: float  # time of the next answer while a pull is under way [s]
    order: SplatOrder = field(default_factory=SplatOrder)  # the last one, but for its slots
    slots: NDArray[np.uint32] = field(default_factory=lambda: backends.new_array(0))
    answered: tuple[PosedCamera, int] | None = None  # that order's camera, and number of batches
    buffer: OrderBuffer | None = None  # in shared memory, if the viewer reads that

    def unshare(self) -> None:
        if self.buffer:
            self.buffer.close()
            self.buffer = None


class Worker:
    """Keeps one map and answers each view with an order, for its newest camera only.

    A view is answered when it sends a camera with a new sequence, and when the map changed; an
    unchanged map and camera aren't sorted again. While many batches wait, views are answered
    between them, in turn. While a pull is under way, or batches are missing, the map is of no
    single revision: an order then names revision 0. During a pull, a view gets one order a second.
    """

    def __init__(
        self,
        held: HeldMap,
        publish: Callable[[SplatOrder], object],
        log: Throttled,
        backend: str = AUTO,
        threads: int = 0,
    ) -> None:
        """held: a SplatMap. publish: called from the worker's thread."""
        self._held, self._publish, self._log = held, publish, log
        self._map: SplatMap = held.books
        held.applied = self._on_applied
        self._map_id = ""  # that the log was told of
        self._viewers: dict[str, _Viewer] = {}  # the one seen longest ago first
        self._due: dict[str, None] = {}  # views to answer, in turn
        self._backend: Backend | None = None  # that has the whole map
        self._wanted = (backend, threads)
        self._failed: frozenset[str] = frozenset()
        self._dropped_views = 0
        self._introduced = ("", "", 0)  # map, backend and size that the log was told of

        self._orders = self._open_shared_memory()
        self._lock = threading.Lock()  # of the next two
        self._cameras: dict[str, ViewCamera] = {}  # that came, the newest of each view
        self._next_backend: tuple[str, int] | None = (backend, threads)
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="sorter", daemon=True)
        self._thread.start()

    def set_camera(self, message: ViewCamera) -> None:
        """Takes a camera; one of the same view that still waits is forgotten.

        One with the sequence 0 asks for no order.
        """
        if not message.sequence:
            return
        with self._lock:
            self._cameras.pop(message.view_id, None)
            self._cameras[message.view_id] = message
            if len(self._cameras) > MAX_VIEWS:
                del self._cameras[next(iter(self._cameras))]
        self._held.came.set()

    def use(self, backend: str, threads: int) -> None:
        """Sorts with another backend from now on; one that failed gets another chance."""
        with self._lock:
            self._next_backend = backend, threads
        self._held.came.set()

    def figures(self) -> dict[str, Any]:
        """The state of the work, for diagnostics. From any thread."""
        backend = self._backend
        return {
            **self._held.figures(),
            "Views": len(self._viewers),
            "Views dropped": self._dropped_views,
            "Backend": backend.name if backend else "",
        }

    def close(self) -> None:
        """Ends the thread after its present sort, and waits for that; removes shared memory."""
        self._closing = True
        self._held.came.set()
        self._thread.join()
        if self._orders:
            self._orders.close()

    def _run(self) -> None:
        came = self._held.came
        while True:
            came.wait(self._longest_wait())
            came.clear()
            if self._closing:
                return
            with self._lock:
                backend, self._next_backend = self._next_backend, None
                cameras, self._cameras = self._cameras, {}
            if backend is not None:
                self._attempt(self._use, backend)
            for message in cameras.values():
                self._attempt(self._update_view, message)
            self._attempt(self._held.apply_waiting, SLICE)
            self._attempt(self._forget_silent, time.monotonic())
            if (view_id := self._next_due()) is not None:
                self._attempt(self._answer, view_id)

    def _attempt(self, do: Callable[[T], object], what: T) -> None:
        """Logs an exception: no message or device may end the node, or cost other messages."""
        try:
            do(what)
        except Exception as error:
            self._log.warn(
                "sort", f"could not sort: {type(error).__name__}: {shown(error, MOST_SHOWN)}"
            )

    def _forget_silent(self, now: float) -> None:
        for view_id, viewer in list(self._viewers.items()):
            if viewer.seen < now - FORGET_AFTER or len(self._viewers) > MAX_VIEWS:
                viewer.unshare()
                del self._viewers[view_id]
                self._due.pop(view_id, None)

    def _next_due(self) -> str | None:
        """The next view to answer now."""
        if not self._map.revision:
            return None  # all are due again when a map begins
        if not self._map.pulled:
            return next(iter(self._due), None)
        now = time.monotonic()
        return next((name for name in self._due if self._viewers[name].due_from <= now), None)

    def _longest_wait(self) -> float | None:
        """Time until there is work: a view is due, or has been silent for too long. [s]"""
        if self._held.waits or self._next_due() is not None:
            return 0.0
        if self._due and self._map.pulled:
            first = min(self._viewers[name].due_from for name in self._due)
            return max(0.0, first - time.monotonic())
        return FORGET_AFTER if self._viewers else None  # silent views hold memory

    # --- Batches ----------------------------------------------------------------------------------

    def _on_applied(self, batch: GaussianArray) -> None:
        if batch.map_id != self._map_id:
            self._map_id = batch.map_id
            self._log.inform(
                "map",
                f"map '{shown(batch.map_id)}' begins, in frame '{shown(batch.header.frame_id)}'",
            )
        self._due.update(dict.fromkeys(self._viewers))
        if self._backend:
            try:
                self._backend.update(self._map, self._map.changed_rows)
                return
            except Exception as error:
                self._leave(self._backend, error)
        self._open_backend()

    # --- Views ------------------------------------------------------------------------------------

    def _update_view(self, message: ViewCamera) -> None:
        try:
            seen = view_cameras.decode(message)
        except CameraError as error:
            self._drop_view(message, error)
            return
        viewer = self._viewers.pop(message.view_id, None)  # comes back at the end of the dict
        if viewer is None:
            now = time.monotonic()
            viewer = _Viewer(message, seen, now, now + PULL_PATIENCE)
            self._due[message.view_id] = None
        elif (
            viewer.message.sequence != message.sequence
            or viewer.message.segment_key != message.segment_key  # may have missed the last order
            or viewer.camera != seen
        ):
            self._due[message.view_id] = None
        viewer.message, viewer.camera, viewer.seen = message, seen, time.monotonic()
        self._viewers[message.view_id] = viewer

    def _drop_view(self, message: ViewCamera, reason: object) -> None:
        self._dropped_views += 1
        self._log.warn(
            "view",
            f"gaussians/view: camera {message.sequence} of view '{shown(message.view_id)}' "
            f"dropped: {shown(reason, MOST_SHOWN)} ({self._dropped_views} dropped so far)",
        )

    def _answer(self, view_id: str) -> None:
        del self._due[view_id]
        viewer = self._viewers[view_id]
        header, frame_id = viewer.message.header, self._held.header.frame_id
        if not is_frame(header.frame_id, frame_id):
            self._drop_view(
                viewer.message,
                f"header.frame_id is '{shown(header.frame_id)}', the map's '{shown(frame_id)}'",
            )
            return
        shares = self._share(viewer)
        if viewer.answered != (viewer.camera, self._held.edits):
            try:
                view = SortView.of(viewer.camera, self._map.frames)
            except CameraError as error:
                self._drop_view(viewer.message, error)
                return
            self._sort(viewer, view)
        elif shares and not viewer.order.generation:
            slots = self._allocate(viewer, len(viewer.slots))
            slots[:] = viewer.slots
            self._place(viewer, slots)
        elif not shares:
            self._place(viewer, viewer.slots)
        viewer.answered = viewer.camera, self._held.edits
        viewer.due_from = time.monotonic() + PULL_PATIENCE
        order = copy(viewer.order)
        order.header, order.view_id, order.sequence = header, view_id, viewer.message.sequence
        if order.encoding == SplatOrder.PACKED:
            order.packed = pack(viewer.slots, order.slot_bits)
        self._publish(order)

    def _sort(self, viewer: _Viewer, view: SortView) -> None:
        def allocate(count: int) -> NDArray[np.uint32]:
            return self._allocate(viewer, count)

        slots = None
        while slots is None:
            backend = self._backend or self._open_backend()
            begin = time.perf_counter()
            try:
                slots = backend.order(view, allocate)
            except Exception as error:
                self._leave(backend, error)
        sort_time = time.perf_counter() - begin
        known_map, known_backend, known_size = self._introduced
        if (
            (known_map, known_backend) != (self._map.map_id, backend.name)
            or self._map.splats >= 2 * known_size  # a map that arrives in chunks is soon introduced
        ):
            self._introduced = (self._map.map_id, backend.name, max(1, self._map.splats))
            self._log.inform(
                f"sort {backend.name}",
                f"map '{shown(self._map.map_id)}': {len(slots)} of {self._map.splats} splats in "
                f"view, sorted in {1000 * sort_time:.1f} ms with {_describe(backend)}",
            )
        viewer.order = SplatOrder(
            map_id=self._map.map_id,
            revision=0 if self._map.pulled or self._map.missed else self._map.revision,
            backend=backend.name,
            sort_time=sort_time,
            count=len(slots),
            slot_bits=max(1, (self._map.capacity - 1).bit_length()),
        )
        self._place(viewer, slots)

    # --- Shared memory ----------------------------------------------------------------------------

    def _open_shared_memory(self) -> SharedOrders | None:
        try:
            return SharedOrders()
        except OSError as error:
            self._log.inform("memory", f"no shared memory for orders: {error}")
            return None

    def _share(self, viewer: _Viewer) -> bool:
        """Whether the viewer reads this sorter's shared memory; if so, makes its buffer."""
        if not self._orders or viewer.message.segment_key != self._orders.key:
            viewer.unshare()
        elif viewer.buffer is None:
            viewer.buffer = OrderBuffer(self._orders)
        return viewer.buffer is not None

    def _allocate(self, viewer: _Viewer, count: int) -> NDArray[np.uint32]:
        if viewer.buffer:
            try:
                return viewer.buffer.begin(count)
            except OSError as error:
                self._log.warn("memory", f"orders travel in messages: {error}")
                viewer.unshare()
        return backends.new_array(count)

    def _place(self, viewer: _Viewer, slots: NDArray[np.uint32]) -> None:
        """Keeps a viewer's slots, for which _allocate made room, and has its order name them."""
        viewer.slots, order = slots, viewer.order
        if viewer.buffer:
            order.encoding = SplatOrder.SHARED
            order.segment, order.generation = viewer.buffer.finish()
        else:  # in the message; the segment tells the viewer whether it can read any
            order.encoding = SplatOrder.PACKED
            order.segment, order.generation = self._orders.probe if self._orders else "", 0

    # --- Backends ---------------------------------------------------------------------------------

    def _use(self, wanted: tuple[str, int]) -> None:
        self._wanted = wanted
        self._failed = frozenset()
        for view_id, viewer in self._viewers.items():  # so that orders name the new backend
            viewer.answered, self._due[view_id] = None, None
        self._open_backend()

    def _open_backend(self) -> Backend:
        """Opens the best backend left and gives it the map. Raises Unavailable without any."""
        self._close_backend()  # others may need its memory
        wanted, threads = self._wanted
        while self._backend is None:
            try:
                backend, reasons = backends.choose(wanted, threads, self._failed)
            except Unavailable:
                self._failed = frozenset()  # a smaller map may suit them
                raise
            try:
                backend.update(self._map, slice(0, self._map.rows))
                self._backend = backend
            except Exception as error:
                self._leave(backend, error)
        choice = f"sorting with {_describe(backend)}"
        if wanted in reasons:
            self._log.warn(
                "backend", f"backend '{wanted}' is not available: {reasons.pop(wanted)}; {choice}"
            )
        else:
            others = "".join(f"; no {name}: {reason}" for name, reason in reasons.items())
            self._log.inform(f"backend {backend.name}", choice + others)
        return backend

    def _leave(self, backend: Backend, error: Exception) -> None:
        """Closes a backend that failed, and doesn't open it again."""
        reason = str(error) or type(error).__name__
        self._log.warn(f"backend {backend.name}", f"backend '{backend.name}' failed: {reason}")
        self._failed |= {backend.name}
        self._close_backend()

    def _close_backend(self) -> None:
        backend, self._backend = self._backend, None
        if backend:
            backend.close()


def _describe(backend: Backend) -> str:
    return f"{backend.name} ({backend.device})"
