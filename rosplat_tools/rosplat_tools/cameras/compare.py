"""Holds a map against what a camera sees, picture by picture.

Hears `gaussians`, `image_raw`, `camera_info` and `mask`, and by TF or on `pose` where the camera
was. Publishes `rendered`, the map drawn for the picture; `difference`, a heat map of the errors;
`metrics`, with `align` also of how far off the camera was said to be; with `attribute`,
`residuals`: the map with a channel that says where it is wrong.
"""

from __future__ import annotations

import threading
import time

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image

from rosplat_core.lens_pictures import take_picture
from rosplat_core.lenses import Lens, Straightened, Warp
from rosplat_core.log_text import shown
from rosplat_msgs.msg import Comparison
from rosplat_sorter.diagnostics import Diagnostics
from rosplat_sorter.qos import overridable
from rosplat_tools.cameras import comparison
from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.cameras.health import NoPicture
from rosplat_tools.cameras.pose_history import SECOND
from rosplat_tools.cameras.refining import refined
from rosplat_tools.cameras.residual_map import ResidualMap
from rosplat_tools.cameras.taken_pictures import Taken, TakenPictures
from rosplat_tools.images import to_bytes, to_image
from rosplat_tools.program.parameters import declare
from rosplat_tools.program.running import run, spinning

PICTURES = QoSProfile(depth=5)
POLL = 0.005  # how often TF is asked [s]


class Compare(Node):
    """Callbacks hand over; compare() draws."""

    def __init__(self) -> None:
        """Raises SceneError for a parameter that makes no sense."""
        super().__init__("compare")
        attribute = declare(self, "attribute", False, "Publish the map with a channel residual.")
        aligns = declare(self, "align", False, "Find out by how much poses are off.")
        self._came = threading.Event()
        self._map = DrawnMap(self, self._came.set)
        self._pictures = TakenPictures(
            self, self._map, lambda lens: _Optics(lens, aligns), self._came.set
        )
        self._residuals = ResidualMap(self, self._map) if attribute else None
        self._rendered = self.create_publisher(Image, "rendered", **overridable(PICTURES))
        self._difference = self.create_publisher(Image, "difference", **overridable(PICTURES))
        self._metrics = self.create_publisher(Comparison, "metrics", **overridable(PICTURES))
        self._health = self._pictures.health
        Diagnostics(self, self._health.name, self._health.report)

    def compare(self) -> None:
        """Compares pictures until ROS ends."""
        while self.context.ok():
            self._came.wait(POLL)
            self._came.clear()
            self._map.take()
            try:
                if taken := self._pictures.next():
                    self._compare(taken)
            except NoPicture as none:
                self._health.trouble(none.kind, none)
            if self._residuals:
                self._residuals.publish()

    def _compare(self, taken: Taken[_Optics]) -> None:
        began = time.perf_counter()
        warp, world_to_lens = taken.optics.warp, taken.world_to_lens
        mask = taken.counts & warp.met
        if not mask.any():
            raise NoPicture("masked", "the mask leaves no pixel")
        depths = {"near": self._pictures.near, "far": self._pictures.far}
        try:
            colour = take_picture(self._map.renderer, warp, world_to_lens, **depths).colour
        except (RuntimeError, MemoryError) as error:
            reason = shown(error, 300) or "out of memory"
            raise NoPicture("not drawn", reason) from error
        rendered = to_bytes(colour)  # as a camera has it
        message, errors = _measured(rendered, taken.colours, mask)
        if taken.optics.straightened:
            self._align(taken, taken.optics.straightened, message)
        books = self._map.renderer.map
        message.header, message.map_id, message.revision = (
            taken.header,
            books.map_id,
            books.revision,
        )
        self._metrics.publish(message)
        for publisher, pixels in (
            (self._rendered, rendered),
            (self._difference, comparison.heat(errors, mask)),
        ):
            picture = to_image(pixels, "rgb8")
            picture.header = taken.header
            publisher.publish(picture)
        if self._residuals:
            self._residuals.add(warp, world_to_lens, **depths, errors=errors, mask=mask)
        latency = (self.get_clock().now().nanoseconds - taken.stamp) / SECOND
        self._health.well(latency, time.perf_counter() - began)

    def _align(
        self, taken: Taken[_Optics], straightened: Straightened, message: Comparison
    ) -> None:
        near, far = self._pictures.near, self._pictures.far
        found = refined(self._map.renderer, taken, straightened, near, far)
        message.aligned = found.alignment.converged
        if message.aligned:
            message.correction = found.correction()
            self._health.figures = found.figures()
        else:
            self._health.counts["not aligned"] += 1
            self._health.figures = {}


class _Optics:
    """A lens as pictures are drawn through it, and as they are straightened to be aligned."""

    def __init__(self, lens: Lens, aligns: bool) -> None:
        self.warp = Warp(lens)
        self.straightened = Straightened(lens) if aligns else None


def _measured(
    rendered: NDArray[np.uint8], real: NDArray[np.uint8], mask: NDArray[np.bool_]
) -> tuple[Comparison, NDArray[np.float32]]:
    """The figures of two pictures, and the errors of pixels, (height, width)."""
    ours, theirs = (picture.astype(np.float32) / np.float32(255) for picture in (rendered, real))
    exposure = comparison.fit_exposure(ours, theirs, mask)
    plain = comparison.figures(ours, theirs, mask)
    fitted = comparison.figures(exposure.apply(ours), theirs, mask)
    message = Comparison(
        pixels=int(mask.sum()),
        psnr=plain.psnr,
        ssim=plain.ssim,
        explained=plain.explained,
        gain=exposure.gain,
        bias=exposure.bias,
        fitted_psnr=fitted.psnr,
        fitted_ssim=fitted.ssim,
        fitted_explained=fitted.explained,
    )
    return message, comparison.errors(ours, theirs)


def main() -> None:
    """Runs the node until it is told to end; exit code 1 where a parameter makes no sense."""
    run("compare", _compare)


def _compare() -> None:
    node = Compare()
    with spinning(node):
        node.compare()


if __name__ == "__main__":
    main()
