"""Draws the cameras of a file through the whole chain, and holds the pictures against references.

Publisher and renderer run as separate processes. The renderer's service draws each camera, in its
own order or, with --sidecar, in that of a sorter.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from rosplat_core.cameras import Camera, load_cameras, picture_of
from rosplat_core.formats.bounds import naming_the_file
from rosplat_core.models import Model
from rosplat_core.program.files import make_folder, replacing, write_text
from rosplat_core.program.machine import commit, machine
from rosplat_core.program.output import say, told
from rosplat_core.scenes import NAMES, check_scene
from rosplat_core.splats import InputError
from rosplat_lab.metrics import LEAST_SIDE, compare
from rosplat_lab.programs import Programs
from rosplat_msgs.srv import RenderView
from rosplat_ros.program.processes import Processes, quoted
from rosplat_sorter.backends import BACKENDS

START_TIMEOUT = 120.0  # since the map was last seen to be loaded, sent or received further [s]
SETTLED = 1.0  # a complete map that hasn't changed for so long has all its edits [s]
PUBLISHER = "publisher"  # name of its log
ORDER_TIMEOUT = 10.0  # for the sorter, of a renderer that doesn't sort itself [s]
LONGEST_SIDE, MOST_PIXELS = 16384, 1 << 25  # that the renderer draws


class RenderError(RuntimeError):
    """A picture that could not be drawn; the text says why."""


def render(
    publisher: Sequence[str],
    cameras: list[Camera],
    *,
    via: str = "host",
    sidecar: str = "",
    detail: str = "full",
    log_folder: Path = Path("out/log"),
    on_picture: Callable[[Camera, NDArray[np.float32], RenderView.Response], None],
) -> None:
    """Publishes a map and draws it in processes of their own; hands over each picture.

    publisher: an executable of rosplat_tools and its arguments after --ros-args.
    via is "host", the embedded renderer, or "rviz", the Display in rviz2. on_picture gets the
    camera, (height, width, 4) premultiplied RGBA and the rest of the answer. sidecar: the backend
    of a sorter, in whose orders is drawn.
    detail: how much of the map to draw, as RenderView has it.
    Raises RenderError, ProcessError, TimeoutError.
    """
    with Programs(log_folder, "render") as programs:
        programs.node("rosplat_tools", *publisher, name=PUBLISHER)
        if sidecar:
            programs.node("rosplat_sorter", "sorter", "-p", f"backend:={sidecar}")
        source = "Sidecar" if sidecar else "Auto"
        if via == "rviz":
            start_rviz(programs, f"{programs.namespace}/gaussians", source)
        else:
            settings = ["-p", "serve:=true", "-p", f"order_source:={source.lower()}"]
            programs.node("rviz_gaussian_plugin", "viewer", *settings)
        _wait_for_map(programs, cameras[0])
        for camera in tqdm(cameras, "drawing", unit="picture", disable=None):
            answer = _drawn(programs, camera, ORDER_TIMEOUT, detail)
            pixels = np.frombuffer(answer.color.data, np.float32)
            on_picture(camera, pixels.reshape(camera.height, camera.width, 4), answer)
        for warning in programs.warnings(PUBLISHER):
            print(f"render: {warning}", file=sys.stderr)


def start_rviz(processes: Processes, topic: str, order_source: str = "Auto") -> None:
    """Starts rviz2 with a display of the topic; on a screen of its own where there is none."""
    if not shutil.which("rviz2"):
        raise RenderError("rviz2 is not installed here: use --via host")
    config = processes.folder / "render.rviz"
    config.write_text(RVIZ_CONFIG.format(topic=topic, order_source=order_source))
    command = ["rviz2", "-d", str(config)]
    if not os.environ.get("DISPLAY"):
        command = ["xvfb-run", "-a", "-s", "-screen 0 1280x800x24", *command]
    processes.start("rviz2", command)


RVIZ_CONFIG = """\
Visualization Manager:
  Displays:
    - Class: rviz_gaussian_plugin/GaussianMap
      Name: Gaussian Map
      Enabled: true
      Topic: {topic}
      Order Source: {order_source}
      Render Service: true
      Value: true
  Global Options:
    Fixed Frame: map
  Views:
    Current:
      Class: rviz_default_plugins/Orbit
"""


def _wait_for_map(programs: Programs, camera: Camera) -> None:
    """Waits until the renderer has all of the map, and its last edits."""
    changed = time.monotonic()
    seen, complete = (-1, ""), False
    while not complete or time.monotonic() - changed < SETTLED:
        small = Camera(**(vars(camera) | {"width": 16, "height": 16}))
        answer = _drawn(programs, small, 0.0)
        complete = answer.map_complete
        progress = (answer.revision, programs.last_line(PUBLISHER))
        if progress != seen:  # it grows, or is read: be patient
            seen, changed = progress, time.monotonic()
        if time.monotonic() - changed > START_TIMEOUT:
            raise RenderError("the map did not arrive: " + programs.last_line(PUBLISHER))
        time.sleep(0.1)


def _drawn(
    programs: Programs, camera: Camera, order_timeout: float, detail: str = "full"
) -> RenderView.Response:
    complaint = f"camera {camera.id}: the renderer has not answered"
    answer = programs.picture(camera, complaint, order_timeout, detail)
    if not answer.success:
        raise RenderError(f"camera {camera.id}: {answer.message}")
    return answer


def check(path: Path, cameras: Sequence[Camera]) -> None:
    """Raises InputError for cameras of a file that can't be drawn, or held against their images."""
    if not cameras:
        raise InputError(f"{path}: holds no cameras")
    first: dict[int, int] = {}
    for index, camera in enumerate(cameras):
        where = f"{path}: camera {index}"
        if first.setdefault(camera.id, index) != index:
            raise InputError(f"{where}: id {camera.id} is that of camera {first[camera.id]}")
        size = f"{camera.width}x{camera.height}"
        if (
            max(camera.width, camera.height) > LONGEST_SIDE
            or camera.width * camera.height > MOST_PIXELS
        ):
            raise InputError(
                f"{where}: {size}, expected sides of at most {LONGEST_SIDE} "
                f"and {MOST_PIXELS:,} pixels"
            )
        if picture := picture_of(path, camera):
            try:
                height, width = _pixels(picture).shape[:2]
            except InputError as error:
                raise InputError(f"{where}: {error}") from error
            if (width, height) != (camera.width, camera.height):
                raise InputError(f"{where}: {camera.image} is {width}x{height}, expected {size}")
            if min(width, height) < LEAST_SIDE:
                raise InputError(
                    f"{where}: {camera.image} is {size}, expected sides of at least {LEAST_SIDE} "
                    "to compare"
                )


def read_picture(path: Path) -> NDArray[np.float64]:
    """(height, width, 3) RGB of a picture file, 8 or 16 bit, scaled to 0..1. Raises InputError."""
    pixels = _pixels(path)
    return pixels[..., ::-1] / np.iinfo(pixels.dtype).max


def _pixels(path: Path) -> NDArray[np.unsignedinteger]:
    with naming_the_file(path):
        data = np.frombuffer(path.read_bytes(), np.uint8)
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH
    pixels = cv2.imdecode(data, flags) if len(data) else None
    if pixels is None:
        raise InputError(f"{path}: not a picture")
    return pixels  # type: ignore[return-value]


def write_picture(path: Path, color: NDArray[np.float32], form: str) -> Path:
    """Writes premultiplied RGBA over black: png16, png8 or the floats themselves as npy.

    Raises OSError, and leaves no part of a file.
    """
    if form == "npy":
        path = path.with_suffix(".npy")
        with replacing(path) as partial, partial.open("wb") as file:
            np.save(file, color)
        return path
    bits = np.dtype({"png8": np.uint8, "png16": np.uint16}[form])
    most = 2 ** (8 * bits.itemsize) - 1
    scaled = np.rint(np.clip(color[..., 2::-1], 0, 1) * most).astype(bits)
    path = path.with_suffix(".png")
    with replacing(path) as partial:
        partial.write_bytes(cv2.imencode(".png", scaled)[1].tobytes())
    return path


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 if every picture was drawn."""
    parser = argparse.ArgumentParser(prog="render", description=__doc__)
    parser.add_argument("scene", help=f"scene: {NAMES}")
    parser.add_argument(
        "cameras", type=Path, help="camera file (docs/guides/measure.md has its fields)"
    )
    parser.add_argument("out", type=Path, help="folder for the pictures and report.json")
    parser.add_argument("--via", choices=["host", "rviz"], default="host", help="what draws")
    parser.add_argument(
        "--format", choices=["png16", "png8", "npy"], default="png16", help="format of the pictures"
    )
    parser.add_argument(
        "--sidecar", choices=sorted(BACKENDS), default="",
        help="draw in the orders of a sorter with this backend",
    )  # fmt: skip
    parser.add_argument(
        "--detail", default="full", metavar="D",
        help="how much of the map to draw: full, an error (1.5px) or a number of splats (800k)",
    )  # fmt: skip
    parser.add_argument(
        "--model", choices=[str(model) for model in Model],
        help="how the map was trained, where its file does not say so",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    rows: list[dict[str, object]] = []

    def write_view(camera: Camera, color: NDArray[np.float32], answer: RenderView.Response) -> None:
        picture = write_picture(options.out / str(camera.id), color, options.format)
        row: dict[str, object] = {
            "camera": camera.id,
            "picture": picture.name,
            "splats": answer.splats,
            "error_px": answer.error,
            "detail_error": answer.detail_error,
            "order_source": answer.order_source,
            "sort_ms": answer.sort_time * 1e3,
            "draw_ms": answer.draw_time * 1e3,
        }
        if picture_taken := picture_of(options.cameras, camera):
            reference = read_picture(picture_taken)
            row |= {"reference": camera.image, **compare(color[..., :3], reference)}
        rows.append(row)

    try:
        cameras = load_cameras(options.cameras, panoramas=options.via == "host")
        check(options.cameras, cameras)
        check_scene(options.scene)
        make_folder(options.out)
        publisher = ["ply_publisher", "-p", f"path:={quoted(options.scene)}"]
        if options.model:
            publisher += ["-p", f"model:={options.model}"]
        render(
            publisher, cameras,
            via=options.via, sidecar=options.sidecar,
            detail=options.detail,
            log_folder=options.out / "log", on_picture=write_view,
        )  # fmt: skip
    except (RuntimeError, OSError, ValueError, MemoryError) as error:
        print(f"render: {told(error)}", file=sys.stderr)
        return 1

    command = shlex.join(["render", *(sys.argv[1:] if arguments is None else arguments)])
    settings = {
        "scene": options.scene,
        "via": options.via,
        "detail": options.detail,
        "model": options.model or "",
    }
    write_report(options.out / "report.json", settings | {"command": command}, rows)
    for row in rows:
        figures = f"camera {row['camera']}: {row['splats']:,} splats"
        if row["error_px"]:
            figures += f" to {row['error_px']:.2f} px"
        if row["detail_error"]:
            figures += f" ({row['detail_error']})"
        figures += f", {row['order_source']}"
        if "psnr" in row:
            figures += (
                f", PSNR {row['psnr']:.2f} dB, SSIM {row['ssim']:.5f}, FLIP {row['flip']:.5f}"
            )
        say(figures)
    say(f"wrote {options.out / 'report.json'}")
    return 0


def write_report(path: Path, settings: dict[str, object], rows: Sequence[dict[str, Any]]) -> None:
    """Writes what drew under which settings, and a row for each camera, as JSON."""
    report = settings | {"machine": machine(), "commit": commit(), "cameras": list(rows)}
    write_text(path, json.dumps(report, indent=1, allow_nan=False) + "\n")
