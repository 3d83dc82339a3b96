"""Holds a map against what a camera sees, picture by picture.

Hears `gaussians`, `image_raw`, `camera_info` and `mask`. TF, or the topic `pose`, says where the
camera was. Publishes `rendered`, the map drawn for the picture; `difference`, a heat map of the
errors; and `metrics`, which with `align` also say how far off the camera's pose was. With
`attribute`, publishes `residuals`: the map with a channel that says where it is wrong. `--bag BAG`
compares all pictures of a bag instead, and prints a table.
"""

from __future__ import annotations

import sys
import time

from rclpy.node import Node
from sensor_msgs.msg import Image

from rosplat_core.lens_warps import Straightened, Warp
from rosplat_core.lenses import Lens
from rosplat_msgs.msg import Comparison
from rosplat_ros.images import to_image
from rosplat_ros.program.parameters import declare
from rosplat_ros.program.running import run_node
from rosplat_ros.qos import PICTURES, overridable
from rosplat_tools.cameras import compare_bag, comparison
from rosplat_tools.cameras.comparer import compare
from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.cameras.health import NoPicture
from rosplat_tools.cameras.refining import refined
from rosplat_tools.cameras.residual_map import ResidualMap
from rosplat_tools.cameras.taken_pictures import Taken, TakenPictures


class Compare(Node):
    """Callbacks only hand data over; compare() draws."""

    def __init__(self) -> None:
        super().__init__("compare")
        attribute = declare(self, "attribute", False, "Publish the map with a channel residual.")
        aligns = declare(self, "align", False, "Find out by how much poses are off.")
        self._map = DrawnMap(self)
        self._pictures = TakenPictures(self, self._map, lambda lens: _Optics(lens, aligns))
        self._residuals = ResidualMap(self, self._map) if attribute else None
        self._rendered = self.create_publisher(Image, "rendered", **overridable(PICTURES))
        self._difference = self.create_publisher(Image, "difference", **overridable(PICTURES))
        self._metrics = self.create_publisher(Comparison, "metrics", **overridable(PICTURES))
        self._health = self._pictures.health

    def compare(self) -> None:
        """Compares pictures until ROS ends."""
        for _ in self._map.turns():
            try:
                if taken := self._pictures.next():
                    self._compare(taken)
            except NoPicture as none:
                self._health.trouble(none.kind, none)
            if self._residuals:
                self._residuals.publish()

    def _compare(self, taken: Taken[_Optics]) -> None:
        began = time.perf_counter()
        warp = taken.optics.warp
        self._map.publish_cameras("", warp.cameras(taken.world_to_lens, *taken.clip))
        found = compare(self._map.renderer, taken, warp)
        if taken.optics.straightened:
            self._align(taken, taken.optics.straightened, found.figures)
        self._metrics.publish(found.figures)
        for publisher, pixels in (
            (self._rendered, found.rendered),
            (self._difference, comparison.heat(found.errors, found.mask)),
        ):
            publisher.publish(to_image(pixels, "rgb8", taken.header))
        if self._residuals:
            self._residuals.add(found, warp, taken)
        self._health.well(taken.stamp, began)

    def _align(
        self, taken: Taken[_Optics], straightened: Straightened, message: Comparison
    ) -> None:
        found = refined(self._map.renderer, taken, straightened)
        message.aligned = found.alignment.converged
        if message.aligned:
            message.correction = found.correction()
            self._health.figures = found.figures()
        else:
            self._health.counts["not aligned"] += 1
            self._health.figures = {}


class _Optics:
    """A lens, made ready to draw pictures through it and to straighten pictures to align."""

    def __init__(self, lens: Lens, aligns: bool) -> None:
        self.warp = Warp(lens)
        self.straightened = Straightened(lens) if aligns else None


def main() -> None:
    """Runs the node until it is told to end; exit code 1 where a parameter makes no sense.

    With --bag, runs the program that compares all pictures of a bag.
    """
    if any(word.startswith("--bag") for word in sys.argv[1:]):
        sys.exit(compare_bag.main())
    run_node("compare", Compare, Compare.compare, usage="compare --bag BAG [--help] [...]")
