"""The viewer's node, around the renderer that the rviz Display draws with."""

from __future__ import annotations

import math
import queue
import threading
import time
import uuid
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from rosplat_core.log_text import counted, shown
from rosplat_core.maps import Arrival
from rosplat_core.rendering import OrderSource, RenderSettings
from rosplat_core.splats import InputError
from rosplat_msgs.msg import FirstView, GaussianArray, SplatOrder, ViewCamera
from rosplat_msgs.srv import RenderView
from rosplat_ros.batches import array
from rosplat_ros.first_views import read_first_view
from rosplat_ros.images import to_image
from rosplat_ros.map_receiver import MapReceiver
from rosplat_ros.program.parameters import declare, declare_path
from rosplat_ros.qos import LATCHED, ORDER, VIEW, overridable
from rosplat_ros.view_cameras import numbers
from rviz_gaussian_plugin.offscreen import Renderer
from rviz_gaussian_plugin.viewer.orbit import bounds
from rviz_gaussian_plugin.viewer.panoramas import Panoramas

if TYPE_CHECKING:
    from rosplat_core.first_look import FirstView as View

DISCOVERY = 5.0  # how long stills wait for a sorter to be found [s]
ASK_AGAIN = 0.25  # how long a still waits for an order before it asks for another [s]
KEEP_ALIVE = 1.0  # a view goes out at least this often, for sorters that start late [s]
QUIET = 2.0  # a map that has not grown for so long is taken as complete [s]
WINDOW = (1280, 720)
LONGEST_WAIT = 60.0  # for the order of a picture [s]
ORDER_SOURCES = {name.lower(): source for name, source in OrderSource.__members__.items()}


def described(splats: int, report: dict[str, Any]) -> str:
    """A line on a frame. splats: of the map. report: of Renderer.draw."""
    sort_time, source = report["sort_time"], report["order_source"]
    took = f" in {sort_time * 1e3:.1f} ms" if sort_time else ""  # else not measured
    order = f"sorted by {source}{took}" if source else "not sorted yet"
    detail = f" to {report['error']:.2g} px" if report["error"] else ""
    if report["detail_error"]:
        detail += f" ({report['detail_error']})"
    frame = report["paint_time"] or report["draw_time"]  # this only shows what a painter painted
    return (
        f"{counted(splats, 'splat', 'splats')}, {report['splats']:,} in view{detail} | {order} | "
        f"frame {frame * 1e3:.1f} ms | order age {report['order_age'] * 1e3:.0f} ms"
    )


class Viewer(Node):
    """Feeds the renderer from `gaussians`, asks for orders on `gaussians/view`, takes them.

    Callbacks run in the executor's threads and only hand data over; everything that draws runs in
    the thread that made the viewer.
    """

    def __init__(self) -> None:
        super().__init__("viewer")
        self.output = declare_path(
            self,
            "output",
            "",
            "Folder for demo.png and demo.webp; if set, the viewer draws them and ends.",
        )
        self.serves: bool = declare(
            self, "serve", False, "Show nothing, draw what clients of gaussians/render ask for."
        )
        self.up: list[float] = declare(
            self, "up", [0.0, 0.0, 1.0], "Which way is up in the map's frame, for orbiting."
        )
        order_source: str = declare(
            self, "order_source", "auto", "Whose order is drawn", choices=ORDER_SOURCES
        )
        self.window_size = (
            declare(self, "width", WINDOW[0], "Width of the window. [px]", 64, 8192),
            declare(self, "height", WINDOW[1], "Height of the window. [px]", 64, 8192),
        )
        detail: str = declare(
            self,
            "detail",
            "full",
            "How much of the map is shown: full, pixels (1.5px) or splats (800k).",
        )
        if len(self.up) != 3 or not any(self.up) or not np.isfinite(self.up).all():
            raise InputError(f"parameter up: expected a direction of 3 numbers, got {self.up}")
        try:
            RenderSettings().detail = detail
        except ValueError as error:
            raise InputError(f"parameter {error}") from error
        self.renderer = Renderer()
        try:
            self.renderer.settings.order = ORDER_SOURCES[order_source]
            self.renderer.settings.detail = detail
            self.renderer.settings.depths = self.serves
            self._connect()
        except BaseException:
            del self.renderer  # while its display is there
            raise

    def _connect(self) -> None:
        self.get_logger().info(f"drawing with {self.renderer.renderer_info}")
        self.frame_id = ""
        self.last_batch = math.inf
        self._discovered_until = math.inf
        self._instance = f"viewer_{uuid.uuid4().hex[:8]}"
        self._sequence = 0
        self._published = 0.0
        self._requests: queue.Queue[_Request] = queue.Queue()
        self._panoramas: Panoramas | None = None

        own = MutuallyExclusiveCallbackGroup
        self._map = MapReceiver(self, self._on_batch)
        topic = self._map.topic
        self._order_topic = f"{topic}/order"
        self._views = self.create_publisher(ViewCamera, f"{topic}/view", **overridable(VIEW))
        self.create_subscription(
            SplatOrder,
            self._order_topic,
            self._on_order,  # type: ignore[arg-type] # its result is for others
            callback_group=own(),
            **overridable(ORDER),
        )
        self.first_view: View | None = None  # that the map's publisher offers
        self.create_subscription(
            FirstView,
            f"{topic}/first_view",
            self._on_first_view,
            callback_group=own(),
            **overridable(LATCHED),
        )
        if self.serves:
            self.create_service(
                RenderView, f"{topic}/render", self._on_render, callback_group=own()
            )

    # --- Executor threads -------------------------------------------------------------------------

    def _on_batch(self, message: GaussianArray, arrival: Arrival) -> None:
        try:
            self._apply(message, arrival)
        except MemoryError:
            self._map.pull_again()
            self.get_logger().error(
                f"{self._map.topic}: there is no memory for a batch", throttle_duration_sec=5.0
            )
        except Exception as error:  # no message may end the viewer: the map stays
            self.get_logger().error(
                f"{self._map.topic}: a batch is refused: {shown(error, 300)}",
                throttle_duration_sec=5.0,
            )

    def _apply(self, message: GaussianArray, arrival: Arrival) -> None:
        report = self.renderer.apply(message, arrival)
        if report["missed"] or report["dropped"]:
            self.get_logger().warning(
                f"{self._map.topic}: {counted(report['missed'], 'batch', 'batches')} missing, "
                f"{counted(report['dropped'], 'splat', 'splats')} with invalid values left out",
                throttle_duration_sec=5.0,
            )
        self.frame_id = message.header.frame_id
        self.last_batch = time.monotonic()

    def _on_first_view(self, message: FirstView) -> None:
        try:
            self.first_view = read_first_view(message)
        except ValueError as error:
            self.get_logger().warning(f"{self._map.topic}/first_view: {error}")

    def _on_order(self, message: SplatOrder) -> bool:
        """Takes an order; returns whether it is this viewer's and can be drawn."""
        if not message.view_id.startswith(f"{self._instance}/"):
            return False
        order = (
            message.view_id, message.sequence, message.map_id, message.revision,
            f"sidecar ({shown(message.backend)})", message.sort_time,
        )  # fmt: skip
        try:
            if message.encoding == SplatOrder.SLOTS:
                self.renderer.set_order(*order, array(message.slots, np.uint32))
            else:
                remark = self.renderer.read_order(
                    *order, message.encoding, message.packed, message.count, message.slot_bits,
                    message.segment, message.generation,
                )  # fmt: skip
                if remark:
                    self.get_logger().warning(f"{self._order_topic}: {remark}")
        except Exception as error:  # no order may end the viewer
            reason = shown(error, 300) or "out of memory"
            self.get_logger().warning(
                f"{self._map.topic}/order: an order is dropped: {reason}",
                throttle_duration_sec=5.0,
            )
            return False
        return True

    def _on_render(
        self, request: RenderView.Request, response: RenderView.Response
    ) -> RenderView.Response:
        job = _Request(request, response)
        self._requests.put(job)
        while not job.done.wait(0.1):
            if not self.context.ok():
                response.message = "the viewer ended"
                break
        return response

    # --- The drawing thread -----------------------------------------------------------------------

    def complete(self) -> bool:
        """Whether the map has all that its publisher announced, or has stopped growing."""
        if not self.renderer.splats or self._map.pulling:
            return False
        expected = self.renderer.expected
        if expected and self.renderer.splats + self.renderer.dropped >= expected:
            return True
        return time.monotonic() - self.last_batch > QUIET

    def progress(self) -> str:
        """What a user who sees no map, or not all of it, should know; empty: it is whole."""
        splats, expected = self.renderer.splats, self.renderer.expected
        if not splats:
            heard = self.count_publishers(self._map.topic)
            sends = "its publisher has sent nothing yet" if heard else "nobody publishes it"
            return f"waiting for a map on {self._map.topic}: {sends}"
        if self.complete():
            return ""
        whole = f" of {expected:,}" if expected > splats else ""
        return f"{splats:,}{whole} splats have come"

    def bounds(self) -> tuple[NDArray[np.float64], float]:
        """Centre and radius of the map. [m]"""
        return bounds(self.renderer.sample)

    def set_camera(self, camera: ViewCamera, name: str) -> str:
        """Poses the camera of a view and asks for its order, if wanted; returns the view's id."""
        view_id = f"{self._instance}/{name}"
        self._sequence += 1
        camera.view_id, camera.sequence = view_id, self._sequence
        self.renderer.set_camera(view_id, self._sequence, *numbers(camera))
        self._ask(camera)
        return view_id

    def _ask(self, camera: ViewCamera) -> None:
        wanted = self._wants_orders()
        if not wanted and not self._views_followed():
            self._published = 0.0  # the next one that is wanted is asked for at once
            return
        camera.header.frame_id = self.frame_id
        camera.header.stamp = self.get_clock().now().to_msg()
        camera.segment_key = self.renderer.segment_key
        number = camera.sequence
        camera.sequence = number if wanted else 0
        self._views.publish(camera)
        camera.sequence = number
        self._published = time.monotonic()

    def _wants_orders(self) -> bool:
        return bool(self.renderer.settings.order == OrderSource.SIDECAR)

    def _upload_for(self, view_id: str) -> bool:
        """Uploads what waits; returns whether the sorter's order is of the view's newest camera."""
        self.renderer.upload(all=True)
        return bool(self.renderer.has_order(view_id))

    def _views_followed(self) -> bool:
        """Whether others than sorters hear the views, a streaming publisher for example."""
        listeners = self._views.get_subscription_count()
        return listeners > 0 and listeners > self.count_publishers(self._order_topic)

    def draw_still(self, camera: ViewCamera, name: str, order_timeout: float) -> dict[str, Any]:
        """Draws with the sorter's order, or after order_timeout [s] with one sorted here.

        If no sorter's order is wanted, the renderer sorts at once. Returns its report.
        """
        view_id = self.set_camera(camera, name)
        deadline = time.monotonic() + order_timeout
        answered = False
        while (
            self._wants_orders()
            and not (answered := self._upload_for(view_id))
            and time.monotonic() < deadline
        ):
            if not self.context.ok():
                raise ExternalShutdownException
            if not self._views.get_subscription_count():
                now = time.monotonic()
                self._discovered_until = min(self._discovered_until, now + DISCOVERY)
                if now > self._discovered_until:
                    break
            # A view or an order may be lost while viewer and sorter get to know each other.
            if time.monotonic() - self._published > ASK_AGAIN:
                self.set_camera(camera, name)
            time.sleep(0.001)
        report: dict[str, Any] = self.renderer.draw(view_id, sort_now=not answered)
        if answered and not report["order_fresh"]:  # the map has changed since the order
            report = self.renderer.draw(view_id, sort_now=True)
        return report

    def draw_frame(self, view_id: str, camera: ViewCamera) -> dict[str, Any]:
        """Draws with the best order there is; returns what the renderer reports."""
        if time.monotonic() - self._published > KEEP_ALIVE:
            self._ask(camera)
        report: dict[str, Any] = self.renderer.draw(view_id)
        return report

    def serve_request(self, wait: float) -> None:
        """Serves the next request, if one comes within `wait`. [s]"""
        try:
            job = self._requests.get(timeout=wait)
        except queue.Empty:
            return
        try:
            self._serve(job.request, job.response)
        finally:
            job.done.set()

    def _serve(self, request: RenderView.Request, response: RenderView.Response) -> None:
        frame = request.camera.header.frame_id
        stamp = request.camera.header.stamp
        if frame not in ("", self.frame_id):
            response.message = (
                f"camera.header.frame_id is '{shown(frame)}', the map is in "
                f"'{shown(self.frame_id)}': this viewer knows no transforms"
            )
            return
        shown_detail = self.renderer.settings.detail
        try:
            self.renderer.settings.detail = request.detail or "full"
            if request.camera.projection == ViewCamera.EQUIRECTANGULAR:
                color, depth, report = self._draw_panorama(request)
            else:
                wait = min(request.order_timeout, LONGEST_WAIT)
                report = self.draw_still(request.camera, "render", wait)
                color, depth = self.renderer.read_color(), self.renderer.read_depth()
            response.color, response.depth = to_image(color, "32FC4"), to_image(depth, "32FC1")
        except ExternalShutdownException:
            raise
        except Exception as error:  # no request may end the viewer
            response.message = str(error) or "out of memory"
            return
        finally:
            self.renderer.settings.detail = shown_detail
        for image in (response.color, response.depth):
            image.header.frame_id, image.header.stamp = frame or self.frame_id, stamp
        response.splats = report["splats"]
        response.map_complete = report["map_complete"] and self.complete()
        for name in (
            "error", "detail_error", "order_source", "sort_time", "draw_time", "map_id", "revision",
        ):  # fmt: skip
            setattr(response, name, report[name])
        response.success = True

    def _draw_panorama(
        self, request: RenderView.Request
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], dict[str, Any]]:
        """Colours, depths and a report, as Renderer.draw has it."""
        self.renderer.upload(all=True)
        if not self._panoramas:
            self._panoramas = Panoramas(self)
        began = time.monotonic()
        picture, whole = self._panoramas.draw(
            request.camera, self.renderer.map_id, self.renderer.revision
        )
        books = self._panoramas.renderer.map
        detail = self.renderer.settings.detail
        report = {
            "splats": books.splats, "map_id": books.map_id, "revision": books.revision,
            "map_complete": whole, "error": 0.0, "order_source": "processor", "sort_time": 0.0,
            "detail_error": "" if detail == "full" else "a panorama is drawn in full",
            "draw_time": time.monotonic() - began,
        }  # fmt: skip
        assert picture.depth is not None
        depth = np.where(np.isfinite(picture.depth), picture.depth, np.float32(np.nan))
        return picture.colour, depth, report


@dataclass
class _Request:
    """A picture that a service call waits for."""

    request: RenderView.Request
    response: RenderView.Response

    def __post_init__(self) -> None:
        self.done = threading.Event()
