"""A camera in a map: from a pose to its picture, beside calls of RenderView; what the warp costs.

Publisher, camera and viewer are processes of their own. Poses come from here: each after the
picture of the one before, or faster than pictures come.
"""

from __future__ import annotations

import itertools
import math
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from rosplat_core.cameras import Camera
from rosplat_core.lens_pictures import take_picture
from rosplat_core.lens_warps import Warp
from rosplat_core.lenses import PLUMB_BOB, Lens
from rosplat_core.rendering import CpuRenderer
from rosplat_lab import metrics
from rosplat_lab.bench import scenes
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Doing, Event, Measurement, Skipped, milliseconds
from rosplat_lab.programs import PATIENCE, Programs
from rosplat_ros.program.processes import quoted

SIZES, QUICK_SIZES = (500_000,), (20_000,)
PICTURES, QUICK_PICTURES = ((640, 360), (1280, 720)), ((160, 90),)
COUNT = 360  # cameras, each a neighbour of the next
# Distortions: of a real camera, and next to none, which is warped all the same.
BARREL, STRAIGHT = (-0.28, 0.07, 3e-4, -5e-4, 0.01), (1e-12,)
OFF = 1 / 3  # between pixels of the picture to be warped and of the lens [px]
SECONDS, QUICK_SECONDS = 5.0, 1.0  # in which pictures are counted
EVERY = 0.005  # between poses meanwhile [s]


def measure(plan: Plan) -> Iterator[Event]:
    """Milliseconds, pictures a second and the warp's dB, by scene, size of pictures and lens."""
    pictures = QUICK_PICTURES if plan.quick else PICTURES
    names = scenes.names(plan.sizes or (QUICK_SIZES if plan.quick else SIZES), plan.scenes)
    jobs = list(itertools.product(names, pictures))
    seconds = QUICK_SECONDS if plan.quick else SECONDS
    for number, (name, picture) in enumerate(jobs):
        of = f"{name}, {picture[0]}x{picture[1]}"
        yield Doing(f"{of}, the warp", number / len(jobs))
        yield from isolated(_warped, name, picture)
        for by in WAYS:
            yield Doing(f"{of}, {by}", (number + 0.5) / len(jobs))
            yield from isolated(_filmed, name, picture, by, plan, seconds)


def _warped(name: str, picture: tuple[int, int]) -> Iterator[Event]:
    """PSNR of pictures that were warped, against the same pictures drawn directly."""
    splats = scenes.load(name)
    renderer = CpuRenderer(splats)
    for view in scenes.views(name):
        camera = scenes.VIEWS[view](splats, *picture, 1)[0]
        lens = Lens.of_camera(camera)
        lens = replace(lens, cx=math.floor(lens.cx) + OFF, cy=math.floor(lens.cy) + OFF)
        bent = replace(lens, model=PLUMB_BOB, coefficients=STRAIGHT)
        drawn, warped = (
            take_picture(renderer, Warp(each), camera.world_to_camera, near=camera.near).colour
            for each in (lens, bent)
        )
        yield Measurement(
            "PSNR of the warp", "dB", metrics.psnr(warped.clip(0, 1), drawn.clip(0, 1)), name,
            len(splats), picture=f"{picture[0]}x{picture[1]}", view=view,
        )  # fmt: skip


def _filmed(
    name: str, picture: tuple[int, int], by: str, plan: Plan, seconds: float
) -> Iterator[Event]:
    splats = scenes.load(name)
    cameras = scenes.overview(splats, *picture, COUNT)
    size = f"{picture[0]}x{picture[1]}"
    of = partial(Measurement, scene=name, splats=len(splats), picture=size, by=by)
    del splats
    if by == TF and _tf_message() is None:
        yield Skipped(f"{TF}: tf2_msgs or tf2_ros is not installed")
        return
    with Programs(plan.out / "log") as film:
        arguments = ["-p", f"path:={quoted(name)}", "-p", f"frame_id:={_frame(film)}"]
        film.node("rosplat_tools", "ply_publisher", *arguments)
        shoot, flood, drawn_by = WAYS[by](film, cameras, f"{by}: no picture in {PATIENCE:.0f} s")
        numbers = itertools.count()  # no picture twice: a viewer keeps its last one
        taken = plan.budget.spend(lambda _: milliseconds(lambda: shoot(next(numbers))))
        yield of("pose to picture", "ms", taken, gpu=drawn_by)
        if flood:
            yield of("pictures", "1/s", flood(seconds), gpu=drawn_by)


def _frame(film: Programs) -> str:
    """The map's frame; its own, as all share TF."""
    return film.namespace.strip("/")


Shooting = tuple[Callable[[int], object], Callable[[float], float] | None, str]
"""Has the picture of a numbered camera taken, and waits for it; pictures a second of a camera that
moves for so long; what draws."""


def _by_camera(
    film: Programs, cameras: list[Camera], complaint: str, *,
    coefficients: tuple[float, ...] = (), by_tf: bool = False,
) -> Shooting:  # fmt: skip
    from geometry_msgs.msg import PoseStamped
    from rclpy.time import Time
    from sensor_msgs.msg import CameraInfo, Image
    from std_msgs.msg import Header

    from rosplat_ros.poses import to_pose
    from rosplat_tools.cameras.calibrations import of_lens
    from rosplat_tools.frames import transform

    lens = Lens.of_camera(cameras[0])
    if coefficients:
        lens = replace(lens, model=PLUMB_BOB, coefficients=coefficients)
    frame = _frame(film)
    optical = f"{frame}_optical"
    film.node(
        "rosplat_tools", "camera", "-p", f"poses:={'tf' if by_tf else 'topic'}",
        "-p", "rate:=1000.0", "-p", "camera.calibration:=topic", "-p",
        f"camera.frame_id:={optical}", "-p", f"near:={cameras[0].near:.9f}",
    )  # fmt: skip
    stamps: list[int] = []

    def on_image(image: Image) -> None:
        stamps.append(Time.from_msg(image.header.stamp).nanoseconds)

    film.asker.create_subscription(Image, "camera/image_raw", on_image, 5)
    infos = film.asker.create_publisher(CameraInfo, "camera/calibration", 5)
    film.wait(infos.get_subscription_count, complaint)
    infos.publish(of_lens(lens))
    tf_message = _tf_message()
    poses = film.asker.create_publisher(PoseStamped, "camera/pose", 5)
    transforms = film.asker.create_publisher(tf_message, "/tf", 5) if by_tf and tf_message else None

    def pose(number: int) -> int:
        """Publishes where the camera is now; returns the time. [ns]"""
        now = film.asker.get_clock().now()
        header = Header(frame_id=frame, stamp=now.to_msg())
        place = to_pose(np.linalg.inv(cameras[number % len(cameras)].world_to_camera))
        if transforms:
            transforms.publish(tf_message(transforms=[transform(header, optical, place)]))
        else:
            poses.publish(PoseStamped(header=header, pose=place))
        return int(now.nanoseconds)

    def shoot(number: int) -> None:
        asked = pose(number)
        film.wait(lambda: stamps and stamps[-1] >= asked, complaint)

    def flood(seconds: float) -> float:
        before, began = len(stamps), time.monotonic()
        for number in itertools.count():
            if time.monotonic() - began > seconds:
                break
            pose(number)
            end = time.monotonic() + EVERY
            while (left := end - time.monotonic()) > 0:
                film.spin_once(left)
        return (len(stamps) - before) / (time.monotonic() - began)

    def begin() -> None:
        infos.publish(of_lens(lens))  # a camera that begins may miss the first one
        pose(0)

    film.wait(lambda: stamps, complaint, again=begin)
    return shoot, flood, "processor"


def _by_render_view(film: Programs, cameras: list[Camera], complaint: str) -> Shooting:
    film.node("rosplat_sorter", "sorter")
    film.node("rviz_gaussian_plugin", "viewer", "-p", "serve:=true")

    def shoot(number: int) -> bool:
        answer = film.picture(cameras[number % len(cameras)], complaint, order_timeout=1.0)
        return bool(answer.success and answer.map_complete)

    while not shoot(-1):
        pass
    found = re.search(r"drawing with (.*)", film.said("viewer"))
    return shoot, None, found[1] if found else ""


def _tf_message() -> Any:
    from rosplat_tools.frames import TFMessage, tf2_ros

    return TFMessage if tf2_ros else None


TF = "camera, poses by TF"
WAYS: dict[str, Callable[[Programs, list[Camera], str], Shooting]] = {
    "camera": _by_camera,
    "camera, distorted": partial(_by_camera, coefficients=BARREL),
    TF: partial(_by_camera, by_tf=True),
    "RenderView": _by_render_view,
}
"""By name: starts what takes the pictures."""
