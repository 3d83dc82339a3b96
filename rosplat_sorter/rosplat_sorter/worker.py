"""The thread that applies edits and sorts, so that the node only passes messages on."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from rosplat_core.log_text import counted, shown
from rosplat_core.maps import REPLACE, Arrival, BatchError
from rosplat_core.posed_camera import CameraError, PosedCamera
from rosplat_core.view import SortView
from rosplat_ros import view_cameras
from rosplat_ros.batches import array_bytes
from rosplat_ros.messages import is_frame
from rosplat_sorter import backends
from rosplat_sorter.backends import AUTO, Backend, Unavailable
from rosplat_sorter.map import SplatMap
from rosplat_sorter.shared_orders import OrderBuffer, SharedOrders

if TYPE_CHECKING:
    from std_msgs.msg import Header

    from rosplat_msgs.msg import GaussianArray, ViewCamera

T = TypeVar("T")

# Viewers send their cameras at least each second; a viewer silent for so long is gone. [s]
FORGET_AFTER = 10.0
MAX_VIEWS = 32

MOST_SHOWN = 300  # characters of an error in a line of the log

# Between two answers to a view while a pull is under way, at least. [s]
PULL_PATIENCE = 1.0

# Of waiting batches: while there are more, the worker is busy, and should get none. [bytes]
MOST_WAITING = 1 << 25

# Of batches: once so much is applied, the next view gets its answer. [bytes]
SLICE = 1 << 22


@dataclass(frozen=True)
class Answer:
    """An order for a view, field by field as in SplatOrder.

    slots: uint32 (n,), below 2^slot_bits. sort_time: [s]. segment: the one that holds the slots in
    that generation; with generation 0, one by which the viewer may find out whether it can read it.
    """

    header: Header
    view_id: str
    sequence: int
    map_id: str
    revision: int
    backend: str
    sort_time: float
    slots: NDArray[np.uint32]
    slot_bits: int
    segment: str = ""
    generation: int = 0


class Host(Protocol):
    """The worker's owner. Its methods are called from the worker's thread, and while it is made."""

    def publish(self, answer: Answer) -> None: ...

    def inform(self, subject: str, text: str) -> None:
        """Logs a text. May be called often, as may warn; both have to throttle each subject."""

    def warn(self, subject: str, text: str) -> None: ...

    def pull_again(self) -> None:
        """Has all of the map come again: there was no memory for a batch, and those that waited
        behind it are dropped.
        """


@dataclass
class _Inbox:
    batches: deque[tuple[GaussianArray, Arrival]] = field(default_factory=deque)
    batch_bytes: int = 0  # of these and of the one that is being applied
    views: dict[str, ViewCamera] = field(default_factory=dict)  # the newest of each view
    backend: tuple[str, int] | None = None

    def edit(self, batch: GaussianArray, arrival: Arrival) -> None:
        """Keeps a batch; forgets those that it replaces."""
        if batch.operation == REPLACE:
            self.forget()
        self.batches.append((batch, arrival))
        self.batch_bytes += array_bytes(batch)

    def forget(self) -> None:
        """Drops all batches but the one that is being applied."""
        self.batch_bytes -= sum(array_bytes(batch) for batch, _ in self.batches)
        self.batches.clear()

    def set_camera(self, message: ViewCamera) -> None:
        """Keeps a camera, the newest of each view, and of no more views than are answered."""
        self.views.pop(message.view_id, None)
        self.views[message.view_id] = message
        if len(self.views) > MAX_VIEWS:
            del self.views[next(iter(self.views))]

    def __bool__(self) -> bool:
        return bool(self.batches or self.views or self.backend)


@dataclass
class _Viewer:
    message: ViewCamera
    camera: PosedCamera
    seen: float
    due_from: float  # time of the next answer while a pull is under way [s]
    answer: Answer | None = None
    answered: tuple[PosedCamera, int] | None = None  # the answer's camera, and number of batches
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

    def __init__(self, host: Host, backend: str = AUTO, threads: int = 0) -> None:
        self._host = host
        self._map = SplatMap()
        self._frame_id = ""  # of the map
        self._batches = 0  # that were applied
        self._applied = time.monotonic()  # when the last of them was; at first, the start
        self._viewers: dict[str, _Viewer] = {}  # the one seen longest ago first
        self._due: dict[str, None] = {}  # views to answer, in turn
        self._backend: Backend | None = None  # that has the whole map
        self._wanted = (backend, threads)
        self._failed: frozenset[str] = frozenset()
        self._dropped_batches = 0
        self._dropped_splats = 0
        self._dropped_views = 0
        self._introduced = ("", "", 0)  # map, backend and size that the log was told of

        self._orders = self._open_shared_memory()
        self._wake = threading.Condition()
        self._inbox = _Inbox(backend=(backend, threads))
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="sorter", daemon=True)
        self._thread.start()

    @property
    def busy(self) -> bool:
        """Whether too many batches wait."""
        return self._inbox.batch_bytes > MOST_WAITING

    def edit(self, batch: GaussianArray, arrival: Arrival = Arrival.HEARD) -> None:
        """Takes a batch of the map. Waits for nothing."""
        with self._wake:
            self._inbox.edit(batch, arrival)
            self._wake.notify_all()

    def set_camera(self, message: ViewCamera) -> None:
        """Takes a camera; one of the same view that still waits is forgotten.

        One with the sequence 0 asks for no order.
        """
        if not message.sequence:
            return
        with self._wake:
            self._inbox.set_camera(message)
            self._wake.notify_all()

    def use(self, backend: str, threads: int) -> None:
        """Sorts with another backend from now on; one that failed gets another chance."""
        with self._wake:
            self._inbox.backend = (backend, threads)
            self._wake.notify_all()

    def figures(self) -> dict[str, Any]:
        """The state of the work, for diagnostics. From any thread."""
        splats, backend = self._map, self._backend
        return {
            "Map": splats.map_id,
            "Revision": splats.revision,
            "Splats": splats.splats,
            "Age (s)": round(time.monotonic() - self._applied, 3),
            "Backlog (bytes)": self._inbox.batch_bytes,
            "Batches missed": splats.missed,
            "Batches dropped": self._dropped_batches,
            "Splats dropped": self._dropped_splats,
            "Views": len(self._viewers),
            "Views dropped": self._dropped_views,
            "Backend": backend.name if backend else "",
        }

    def close(self) -> None:
        """Ends the thread after its present sort, and waits for that; removes shared memory."""
        with self._wake:
            self._closing = True
            self._wake.notify_all()
        self._thread.join()
        if self._orders:
            self._orders.close()

    def _run(self) -> None:
        while True:
            with self._wake:
                # Wakes for silent views as well, which hold memory.
                self._wake.wait_for(
                    lambda: self._closing or self._inbox or self._next_due() is not None,
                    timeout=self._longest_wait(),
                )
                if self._closing:
                    return
                backend, self._inbox.backend = self._inbox.backend, None
                views, self._inbox.views = self._inbox.views, {}
            if backend is not None:
                self._attempt(self._use, backend)
            for message in views.values():
                self._attempt(self._update_view, message)
            self._apply_slice()
            self._attempt(self._forget_silent, time.monotonic())
            if (view_id := self._next_due()) is not None:
                self._attempt(self._answer, view_id)

    def _attempt(self, do: Callable[[T], object], what: T) -> None:
        """Logs an exception: no message or device may end the node, or cost other messages."""
        try:
            do(what)
        except Exception as error:
            self._host.warn(
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
        """Time until a view is due, or has been silent for too long. [s]"""
        if self._due and self._map.pulled:
            first = min(self._viewers[name].due_from for name in self._due)
            return max(0.0, first - time.monotonic())
        return FORGET_AFTER if self._viewers else None

    # --- Batches ----------------------------------------------------------------------------------

    def _apply_slice(self) -> None:
        """Applies the next batches that wait, until SLICE bytes are applied."""
        applied = 0
        while applied < SLICE:
            with self._wake:
                if not self._inbox.batches:
                    return
                waiting = self._inbox.batches.popleft()
            size = array_bytes(waiting[0])
            self._attempt(self._apply, waiting)
            applied += size
            del waiting  # frees its memory before the count of waiting bytes falls
            with self._wake:
                self._inbox.batch_bytes -= size

    def _apply(self, waiting: tuple[GaussianArray, Arrival]) -> None:
        batch, arrival = waiting
        splats, known_map = self._map, self._map.map_id
        try:
            report = splats.apply(batch, arrival)
        except (MemoryError, BatchError) as error:
            self._dropped_batches += 1
            self._host.warn(
                "batch",
                f"gaussians: batch {batch.revision} of map '{shown(batch.map_id)}' dropped: "
                f"{shown(error, MOST_SHOWN) or 'out of memory'} "
                f"({self._dropped_batches} dropped so far)",
            )
            if isinstance(error, MemoryError):
                with self._wake:
                    self._inbox.forget()
                self._host.pull_again()
            return
        self._batches += 1
        self._applied = time.monotonic()
        self._frame_id = batch.header.frame_id
        if batch.map_id != known_map:
            self._host.inform(
                "map", f"map '{shown(batch.map_id)}' begins, in frame '{shown(self._frame_id)}'"
            )
        if report["missed"]:
            self._host.warn(
                "gap",
                f"gaussians: missed {counted(report['missed'], 'batch', 'batches')} before "
                f"{batch.revision} of map '{shown(batch.map_id)}'; the map may be incomplete "
                f"({splats.missed} missed so far)",
            )
        if report["dropped"]:
            self._dropped_splats += report["dropped"]
            self._host.warn(
                "splats",
                f"gaussians: {counted(report['dropped'], 'splat', 'splats')} of batch "
                f"{batch.revision} dropped: a value is not finite, or a quaternion is "
                "zero, or a scale negative "
                f"({self._dropped_splats} dropped so far)",
            )
        self._due.update(dict.fromkeys(self._viewers))
        if self._backend:
            try:
                self._backend.update(splats, splats.changed_rows)
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
        self._host.warn(
            "view",
            f"gaussians/view: camera {message.sequence} of view '{shown(message.view_id)}' "
            f"dropped: {shown(reason, MOST_SHOWN)} ({self._dropped_views} dropped so far)",
        )

    def _answer(self, view_id: str) -> None:
        del self._due[view_id]
        viewer = self._viewers[view_id]
        header, splats = viewer.message.header, self._map
        if not is_frame(header.frame_id, self._frame_id):
            self._drop_view(
                viewer.message,
                f"header.frame_id is '{shown(header.frame_id)}', "
                f"the map's '{shown(self._frame_id)}'",
            )
            return
        last = viewer.answer
        if last is None or viewer.answered != (viewer.camera, self._batches):
            try:
                view = SortView.of(viewer.camera, splats.frames)
            except CameraError as error:
                self._drop_view(viewer.message, error)
                return
            self._share(viewer)
            last = self._sort(viewer, view)
        elif self._share(viewer) and not last.generation:
            slots = self._allocate(viewer, len(last.slots))
            slots[:] = last.slots
            last = self._placed(viewer, replace(last, slots=slots))
        elif not viewer.buffer:
            last = self._placed(viewer, last)
        viewer.answer = replace(
            last, header=header, view_id=view_id, sequence=viewer.message.sequence
        )
        viewer.answered = viewer.camera, self._batches
        viewer.due_from = time.monotonic() + PULL_PATIENCE
        self._host.publish(viewer.answer)

    def _sort(self, viewer: _Viewer, view: SortView) -> Answer:
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
            self._host.inform(
                f"sort {backend.name}",
                f"map '{shown(self._map.map_id)}': {len(slots)} of {self._map.splats} splats in "
                f"view, sorted in {1000 * sort_time:.1f} ms with {_describe(backend)}",
            )
        answer = Answer(
            header=viewer.message.header,
            view_id=viewer.message.view_id,
            sequence=viewer.message.sequence,
            map_id=self._map.map_id,
            revision=0 if self._map.pulled or self._map.missed else self._map.revision,
            backend=backend.name,
            sort_time=sort_time,
            slots=slots,
            slot_bits=max(1, (self._map.capacity - 1).bit_length()),
        )
        return self._placed(viewer, answer)

    # --- Shared memory ----------------------------------------------------------------------------

    def _open_shared_memory(self) -> SharedOrders | None:
        try:
            return SharedOrders()
        except OSError as error:
            self._host.inform("memory", f"no shared memory for orders: {error}")
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
                self._host.warn("memory", f"orders travel in messages: {error}")
                viewer.unshare()
        return backends.new_array(count)

    def _placed(self, viewer: _Viewer, answer: Answer) -> Answer:
        """The answer, with the place of its slots, for which _allocate made room."""
        if viewer.buffer:
            segment, generation = viewer.buffer.finish()
        else:
            segment, generation = self._orders.probe if self._orders else "", 0
        return replace(answer, segment=segment, generation=generation)

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
            self._host.warn(
                "backend", f"backend '{wanted}' is not available: {reasons.pop(wanted)}; {choice}"
            )
        else:
            others = "".join(f"; no {name}: {reason}" for name, reason in reasons.items())
            self._host.inform(f"backend {backend.name}", choice + others)
        return backend

    def _leave(self, backend: Backend, error: Exception) -> None:
        """Closes a backend that failed, and doesn't open it again."""
        reason = str(error) or type(error).__name__
        self._host.warn(f"backend {backend.name}", f"backend '{backend.name}' failed: {reason}")
        self._failed |= {backend.name}
        self._close_backend()

    def _close_backend(self) -> None:
        backend, self._backend = self._backend, None
        if backend:
            backend.close()


def _describe(backend: Backend) -> str:
    return f"{backend.name} ({backend.device})"
