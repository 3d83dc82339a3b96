"""Holds a map against all pictures of a bag; prints a table, the worst picture first."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import CameraInfo, Image
from tqdm import tqdm

from rosplat_core.lens_warps import Warp
from rosplat_core.log_text import counted, shown
from rosplat_core.program.output import say, told
from rosplat_core.program.progress import watched
from rosplat_core.rendering import CpuRenderer
from rosplat_core.scenes import NAMES, load_scene
from rosplat_core.splats import InputError
from rosplat_msgs.msg import Comparison, GaussianArray
from rosplat_ros.images import read_mask
from rosplat_ros.poses import to_matrix, to_pose
from rosplat_ros.program.said_once import words_of
from rosplat_tools import bags
from rosplat_tools.cameras.comparer import compare
from rosplat_tools.cameras.health import NoPicture
from rosplat_tools.cameras.pose_history import Pose, PoseError, PoseHistory
from rosplat_tools.cameras.poses import nanoseconds
from rosplat_tools.cameras.taken_pictures import PictureReader
from rosplat_tools.frames import Frames

ALWAYS = 1e9  # how far back poses are kept [s]
TF, TF_STATIC = "/tf", "/tf_static"


class Bag:
    """A bag's pictures, their lens and poses, and the map: of --scene, or as the bag leaves it."""

    def __init__(self, options: argparse.Namespace) -> None:
        """Reads all but the pictures. Raises InputError."""
        self.path: str = options.bag
        self.image = self._topic(options.image, Image, "--image")
        info = options.info or f"{self.image.rpartition('/')[0]}/camera_info"
        self._info = self._topic(info, CameraInfo, "--info")
        self._map = "" if options.scene else self._topic(options.map, GaussianArray, "--map")
        self._pose = options.pose and self._topic(options.pose, PoseStamped, "--pose")
        self._frame: str = options.frame
        self.info: CameraInfo | None = None
        self.renderer = CpuRenderer()
        self._announced = False  # whether the map has held all that was announced
        self._poses = PoseHistory(ALWAYS, ALWAYS)
        self._tf = None if self._pose else self._transforms()
        self._read()
        if options.scene:
            with watched("reading the map") as progress:
                splats = load_scene(options.scene, progress, lambda text: None)
            self.renderer = CpuRenderer(splats)
        if not self.renderer.map.splats:
            raise InputError(f"{shown(self.path)}: {self._map} has no map")
        if self._map:
            self._check_map()

    def _topic(self, name: str, kind: type, option: str) -> str:
        return bags.topic(self.path, name, option, kind)[0]

    def _transforms(self) -> Frames:
        try:
            return Frames(keeps=ALWAYS)
        except InputError as error:
            raise InputError(f"{error}: give --pose, a topic of PoseStamped") from error

    def _read(self) -> None:
        kinds: dict[str, type] = {self._info: CameraInfo}
        if self._map:
            kinds[self._map] = GaussianArray
        if self._tf:
            from tf2_msgs.msg import TFMessage

            kinds |= {TF: TFMessage, TF_STATIC: TFMessage}
        else:
            kinds[self._pose] = PoseStamped
        with _counted("reading the bag") as drawn:
            for topic, message in bags.messages(self.path, kinds):
                self._add(topic, message)
                drawn.update()

    def _add(self, topic: str, message: Any) -> None:
        if topic == self._info:
            self.info = self.info or message
        elif topic == self._map:
            try:
                self.renderer.apply(message)
            except ValueError as error:
                raise InputError(f"{shown(self.path)}: {topic}: {error}") from error
            if message.operation == GaussianArray.REPLACE:
                self._announced = False
            self._announced |= self.renderer.map.complete  # splats may be deleted later
            self._frame = message.header.frame_id
        elif self._tf:
            for transform in message.transforms:
                self._tf.add(transform, topic == TF_STATIC)
        else:
            try:
                self._poses.add(nanoseconds(message.header.stamp), to_matrix(to_pose(message.pose)))
            except ValueError as error:
                raise InputError(f"{shown(self.path)}: {topic}: {error}") from error

    def _check_map(self) -> None:
        books, where = self.renderer.map, f"{shown(self.path)}: {self._map}"
        if books.missed:
            raise InputError(
                f"{where}: the map lacks {counted(books.missed, 'batch', 'batches')}: record it "
                f"from its beginning or with {self._map}/repeat, or give --scene"
            )
        if not self._announced:
            print(
                f"compare: {where}: more of the map was to come than {books.splats:,} splats",
                file=sys.stderr,
            )

    def pose(self, image: Image) -> Pose:
        """Where a picture was taken. Raises PoseError."""
        if self._tf:
            return self._tf.pose(
                image.header.frame_id, self._frame, nanoseconds(image.header.stamp)
            )[1]
        return self._poses.at(nanoseconds(image.header.stamp))


def _counted(what: str) -> tqdm[None]:
    return tqdm(desc=what, unit="", disable=None, leave=False)


def compare_all(
    bag: Bag, reader: PictureReader[Warp]
) -> tuple[list[Comparison], Mapping[str, int]]:
    """Figures of all pictures that can be compared, and how many can't be, by reason.

    Reasons of the same words, whatever their numbers, are one: the first that came up.
    """
    if bag.info:
        reader.lens.hear(bag.info)
    figures: list[Comparison] = []
    left_out: Counter[str] = Counter()
    reasons: dict[str, str] = {}  # by their words
    with _counted("comparing pictures") as drawn:
        for _, image in bags.messages(bag.path, {bag.image: Image}):
            drawn.update()
            try:
                taken = reader.read(image, bag.pose(image))
                figures.append(compare(bag.renderer, taken, taken.optics).figures)
            except (NoPicture, PoseError) as error:
                reason = shown(error, 200)
                left_out[reasons.setdefault(words_of(reason), reason)] += 1
    return figures, left_out


def table(figures: list[Comparison]) -> list[str]:
    """A line for each picture, the worst first, below the columns' names."""
    lines = [f"{'time [s]':>20} {'PSNR':>6} {'SSIM':>6} {'explained':>9} {'fitted':>6}  gain"]
    for each in sorted(figures, key=lambda each: each.psnr):
        time = f"{each.header.stamp.sec}.{each.header.stamp.nanosec:09d}"
        gain = " ".join(f"{value:.2f}" for value in each.gain)
        lines.append(
            f"{time:>20} {each.psnr:6.2f} {each.ssim:6.4f} {each.explained:9.4f} "
            f"{each.fitted_psnr:6.2f}  {gain}"
        )
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Prints the table; 1 where nothing could be compared."""
    parser = argparse.ArgumentParser(prog="compare", description=__doc__)
    parser.add_argument("--bag", required=True, help="folder or file of a rosbag2")
    parser.add_argument("--scene", help=f"the map, {NAMES}; by default that of the bag")
    parser.add_argument("--map", default="", help="topic of the map, if the bag has several")
    parser.add_argument("--image", default="", help="topic of pictures, if the bag has several")
    parser.add_argument("--info", help="topic of CameraInfo (default: camera_info beside --image)")
    parser.add_argument("--pose", help="topic of the camera's poses in the map (default: TF)")
    parser.add_argument("--frame", default="map", help="frame of --scene (default: %(default)s)")
    parser.add_argument("--rectified", action="store_true", help="pictures are, by r and p")
    parser.add_argument("--mask", help="picture file, black where pixels don't count")
    options = parser.parse_args(arguments)
    try:
        mask = read_mask(options.mask) if options.mask else None
        bag = Bag(options)
        reader = PictureReader(Warp, rectified=options.rectified, mask=mask)
        figures, left_out = compare_all(bag, reader)
    except (InputError, MemoryError) as error:
        print(f"compare: {told(error)}", file=sys.stderr)
        return 1
    for reason, count in left_out.items():
        first = ", the first" if count > 1 else ""
        print(
            f"compare: left out {counted(count, 'picture', 'pictures')}{first}: {reason}",
            file=sys.stderr,
        )
    if not figures:
        print(f"compare: {shown(options.bag)}: no picture could be compared", file=sys.stderr)
        return 1
    say("\n".join(table(figures)))
    psnr = np.array([each.psnr for each in figures])
    pictures = counted(len(psnr), "picture", "pictures")
    say(f"{pictures}: PSNR {psnr.mean():.2f} dB in the mean, {psnr.min():.2f} at worst")
    return 0
