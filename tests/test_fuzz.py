"""No message, request or file ends a process, or takes memory beyond what the map needs."""

from __future__ import annotations

import contextlib
import os
import resource
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fuzz
import numpy as np
from test_conformance import Display, Publisher, Sorter

from rosplat_msgs.msg import GaussianArray, ViewCamera
from rosplat_msgs.srv import LoadScene, RenderView, SaveMap
from rosplat_sorter import camera, depth
from rosplat_sorter.backends import open_backend
from rosplat_sorter.qos import MAP, VIEW
from rosplat_sorter.view import View
from rosplat_tools import formats
from rosplat_tools.program.processes import Processes
from rosplat_tools.splats import SceneError, Splats

FLOOR = 64 << 20  # what a process may take beyond one and a half maps [bytes]


def one_by_one(check: Callable[[np.random.Generator], None], cases: int) -> None:
    """Runs cases; says which failed."""
    for case in range(cases):
        try:
            check(fuzz.random(case))
        except Exception as error:
            raise AssertionError(f"case {case} of seed {fuzz.SEED}") from error


def peak() -> int:
    """What this process took at most. [bytes]"""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def in_a_process(name: str, *arguments: object) -> None:
    """Runs a function of this file elsewhere, where an abort is seen and memory is measured."""
    ended = subprocess.run(
        [sys.executable, __file__, name, *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=3000, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout[-4000:]


# --- Receivers of maps ----------------------------------------------------------------------------


def test_receivers_agree_on_anything() -> None:
    in_a_process("receive", fuzz.CASES)


def receive(cases: str) -> None:
    """Displays, sorters and publishers make the same of the same batches, at the same cost."""
    native = open_backend("native", 1)
    largest = 0

    def check(rng: np.random.Generator) -> None:
        nonlocal largest
        display, sorter, publisher = Display(), Sorter(), Publisher()
        numbered = True
        for number, message in enumerate(fuzz.batches(rng), 1):
            results = [outcome(receiver, message) for receiver in (display, sorter)]
            assert results[0] == results[1], brief(message)
            numbered &= (message.revision, message.map_id) == (number, "map")
            numbered &= not message.snapshot
            if results[0] == "refused":
                numbered = False
            elif numbered:
                assert outcome(publisher, message) == results[0], brief(message)
            for slot in looked_at(rng, message):
                assert display.in_use(slot) == sorter.in_use(slot), (slot, brief(message))
                assert not numbered or publisher.in_use(slot) == sorter.in_use(slot)
            assert (display.origin, display.revision, display.missed) == (
                sorter.origin, sorter.revision, sorter.missed,
            )  # fmt: skip
        with contextlib.suppress(camera.CameraError):
            view = View.of(camera.decode(fuzz.view_camera(rng)), sorter.frames)
            held = sorter.map
            native.update(held, slice(0, held.pages.rows))
            expected = depth.order(view, held.positions, held.extents, held.slots, held.groups)
            np.testing.assert_array_equal(native.order(view), expected)
        largest = max(largest, publisher.map._arrays.nbytes + 16 * sorter.map.pages.rows)

    before = peak()
    one_by_one(check, int(cases))
    assert peak() - before < 1.5 * largest + FLOOR, f"{peak() - before} for {largest} bytes"


def outcome(receiver: Any, message: GaussianArray) -> int | str | None:
    try:
        result: int | None = receiver.take(message)
    except ValueError:
        return "refused"
    return result


def brief(message: GaussianArray) -> str:
    return str(message)[:600]


def looked_at(rng: np.random.Generator, message: GaussianArray) -> list[int]:
    slots = [*message.slots[:5], message.first_slot, message.first_slot + message.count - 1]
    slots += [int(rng.integers(fuzz.MOST)), 0, 1024]
    return [slot for slot in slots if 0 <= slot < fuzz.MOST]


# --- Readers of files -----------------------------------------------------------------------------


def test_damaged_files_are_refused_by_name(tmp_path: Path) -> None:
    in_a_process("read", fuzz.CASES, tmp_path)


def read(cases: str, folder: str) -> None:
    """A damaged file is a scene, or a SceneError that names it."""
    wholes = [path.read_bytes() for path in scenes(Path(folder))]
    path = Path(folder) / "damaged"

    def check(rng: np.random.Generator) -> None:
        path.write_bytes(fuzz.damaged(rng, fuzz.one_of(rng, wholes)))
        try:
            formats.load(path, warn=lambda text: None)
        except SceneError as error:
            assert str(path) in str(error)
            assert "\n" not in str(error)

    check(fuzz.random(0))  # what it loads on the way is nobody's file
    before = peak()
    one_by_one(check, int(cases))
    assert peak() - before < FLOOR, f"{peak() - before} bytes"


def scenes(folder: Path) -> Iterator[Path]:
    """A small scene in each format that can be written."""
    rng = np.random.default_rng(0)
    splats = Splats(
        positions=rng.normal(size=(40, 3)),
        orientations=np.tile([0, 0, 0, 1], (40, 1)),
        scales=np.full((40, 3), 0.1),
        opacities=np.full(40, 0.5),
        sh=rng.normal(size=(40, 4, 3)),
    )
    for module in formats.FORMATS:
        if hasattr(module, "write"):
            path = folder / f"scene{module.SUFFIX}"
            formats.save(path, splats)
            yield path


# --- Nodes ----------------------------------------------------------------------------------------


def test_nodes_outlive_what_their_peers_send(tmp_path: Path, node: Any, listener: Any) -> None:
    cases = fuzz.CASES // 20
    remap = ["--ros-args", "-r", f"__ns:={node.get_namespace()}"]
    hostile = [*remap, "-r", "gaussians:=hostile"]
    os.mkfifo(tmp_path / "fifo")
    (*_, scene) = scenes(tmp_path)
    paths = ["", "\n" * 100, "x" * 5000, str(tmp_path / "fifo"), str(tmp_path), "procedural:-1",
             "\x00", "/dev/zero", str(tmp_path / "damaged"), str(scene)]  # fmt: skip
    with Processes(tmp_path / "log") as processes:
        started = [
            processes.node("rosplat_sorter", "sorter", *hostile),
            processes.node("rosplat_tools", "ply_publisher", *remap, "-p", "save_root:=/"),
            processes.node("rviz_gaussian_plugin", "viewer", *hostile, "-p", "serve:=true"),
        ]
        maps = node.create_publisher(GaussianArray, "hostile", MAP)
        views = node.create_publisher(ViewCamera, "hostile/view", VIEW)
        listener.wait(lambda: maps.get_subscription_count() == 2)

        def call(kind: Any, name: str, **request: object) -> None:
            """Calls a service, unless one of them ends."""
            answer = listener.request(kind, name, **request)
            listener.wait(lambda: processes.check() or answer.done())

        listener.call(RenderView, "hostile/render")
        before = [peak_of(process) for process in started]
        for case in range(cases):
            rng = fuzz.random(case)
            for message in fuzz.batches(rng):
                maps.publish(message)
            camera = fuzz.view_camera(rng)
            views.publish(camera)
            call(RenderView, "hostile/render", camera=camera)
            (tmp_path / "damaged").write_bytes(fuzz.damaged(rng, scene.read_bytes()))
            path = fuzz.one_of(rng, paths)
            if case % 4 == 0:
                call(LoadScene, "ply_publisher/load", path=path)
            elif case % 4 == 1:
                target = path if path != str(scene) else str(tmp_path / "saved.ply")
                call(SaveMap, "ply_publisher/save", path=target)
            processes.check()
        for process, least in zip(started, before, strict=True):
            assert peak_of(process) - least < FLOOR
        for name in ("sorter", "ply_publisher", "viewer"):
            assert "Traceback" not in processes.said(name)
            assert max(map(len, processes.said(name).splitlines())) < 2000


def peak_of(process: subprocess.Popen[bytes]) -> int:
    status = Path(f"/proc/{process.pid}/status").read_text()
    return 1024 * int(status.partition("\nVmHWM:")[2].split()[0])


if __name__ == "__main__":
    try:
        {"receive": receive, "read": read}[sys.argv[1]](*sys.argv[2:])
    except Exception:
        traceback.print_exc()
        sys.exit(1)
