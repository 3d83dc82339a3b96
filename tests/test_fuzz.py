"""No message, request or file ends a process, or takes memory beyond what the map needs.

`make fuzz` runs more cases, and the C++ under the compiler's sanitizers.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fuzz
import numpy as np
import pytest
from std_msgs.msg import Header
from test_conformance import Display, Publisher, Sorter, Twin

from rosplat_core import _core, depth, formats
from rosplat_core.cameras import load_cameras
from rosplat_core.lens_warps import Warp
from rosplat_core.lenses import LensError
from rosplat_core.maps import Arrival
from rosplat_core.posed_camera import CameraError
from rosplat_core.rendering import CpuRenderer, DrawMode, OrderSource, SplatCamera
from rosplat_core.slot_pages import SLOTS_PER_PAGE
from rosplat_core.splats import InputError
from rosplat_core.view import SortView
from rosplat_msgs.msg import GaussianArray, SplatOrder, ViewCamera
from rosplat_msgs.srv import LoadScene, RenderView, SaveMap
from rosplat_ros import view_cameras
from rosplat_ros.map_publisher import as_message
from rosplat_ros.program.processes import Processes
from rosplat_ros.qos import MAP, VIEW
from rosplat_ros.view_cameras import numbers
from rosplat_sorter.backends import open_backend
from rosplat_sorter.order_slots import OrderReader
from rosplat_sorter.shared_orders import OrderBuffer, SharedOrders
from rosplat_tools.cameras import calibrations
from rosplat_tools.streaming import detail
from rviz_gaussian_plugin import _offscreen
from rviz_gaussian_plugin.offscreen import Renderer

# Of a build of the C++ with sanitizers: what has to be loaded first. ROSPLAT_FUZZ_PATH has its
# modules. Sanitizers keep memory that was freed, so that claims mean nothing there.
SANITIZERS = os.environ.get("ROSPLAT_FUZZ_PRELOAD", "")
REPORT = os.environ.get("ROSPLAT_FUZZ_REPORT", "")

FLOOR = 64 << 20  # what a process may take beyond the map [bytes]
# Of a display that draws by the processor and a sorter; of a publisher. [bytes]
PAGE = SLOTS_PER_PAGE * (36 + 4 * 15 + 16 + 1 + 4 * GaussianArray.MAX_CHANNELS)
PUBLISHED_PAGE = SLOTS_PER_PAGE * (36 + 4 * 15 + 4 + 4 * GaussianArray.MAX_CHANNELS)
PIXEL = 128  # colour and depth, as arrays and in messages on their way [bytes]
MOST_PIXELS = 1 << 14  # of a picture that is drawn; larger ones only take longer


class Claims:
    """The most memory that one of many inputs made this process take beyond what it had. [bytes]

    Of those above a mebibyte: what is below comes and goes by itself.
    """

    def __init__(self) -> None:
        self.most: dict[str, dict[str, float]] = {}

    @contextlib.contextmanager
    def of(self, case: int, size: int, allowed: int) -> Iterator[None]:
        """An input of so many bytes, which may claim so many. Raises AssertionError for more."""
        Path("/proc/self/clear_refs").write_text("5")  # what was held at most is forgotten
        before = _status("VmRSS")
        yield
        claimed = _status("VmHWM") - before
        if SANITIZERS or claimed < 1 << 20:
            return
        found = {"case": case, "bytes": size, "claimed": claimed, "allowed": allowed}
        for name, rank in (("claim", claimed), ("times its size", claimed / max(1, size))):
            if rank > self.most.get(name, {}).get("rank", 0):
                self.most[name] = found | {"rank": rank}
        assert claimed <= allowed, found


def _status(name: str, process: int | str = "self") -> int:
    """A figure of a process's memory. [bytes]"""
    status = Path(f"/proc/{process}/status").read_text()
    return 1024 * int(status.partition(f"\n{name}:")[2].split()[0])


def one_by_one(name: str, cases: int, check: Callable[[int, np.random.Generator], None]) -> None:
    """Runs cases; says which failed, even if the process ends by it."""
    with Path(f"case of {name}").open("w") as running:
        for case in fuzz.cases(cases):
            os.pwrite(running.fileno(), f"{case:12}".encode(), 0)
            check(case, fuzz.random(case))


def in_a_process(name: str, folder: Path) -> None:
    """Runs a check of this file elsewhere, where an abort is seen and memory is measured."""
    environment = os.environ | {
        "PYTHONPATH": os.environ.get("ROSPLAT_FUZZ_PATH", "") + os.pathsep.join(sys.path),
        "LD_PRELOAD": SANITIZERS,
        "ASAN_OPTIONS": "detect_leaks=0",  # Python's
        "UBSAN_OPTIONS": "print_stacktrace=1",
        # What is freed goes back to the system, so that claims are seen.
        "MALLOC_MMAP_THRESHOLD_": "131072",
        "MALLOC_TRIM_THRESHOLD_": "131072",
        "MALLOC_ARENA_MAX": "2",
    }
    ended = subprocess.run(
        [sys.executable, __file__, name], cwd=folder, env=environment,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip
    if ended.returncode:
        running = folder / f"case of {name}"
        case = running.read_text().strip() if running.exists() else "none yet"
        again = f"make fuzz SEED={fuzz.SEED} CASE={case}"
        said = (
            ended.stdout
            if len(ended.stdout) < 8000
            else f"{ended.stdout[:4000]}...{ended.stdout[-4000:]}"
        )
        raise AssertionError(f"{again}\n{said}")
    if REPORT:
        shutil.copy(folder / f"{name}.json", REPORT)


# --- Receivers of maps ----------------------------------------------------------------------------


def test_receivers_agree_on_anything(tmp_path: Path) -> None:
    in_a_process("receive", tmp_path)


def receive() -> Claims:
    """All that holds a map makes the same of the same batches, at the same cost."""
    native = open_backend("native", 1)
    claims = Claims()

    def check(case: int, rng: np.random.Generator) -> None:
        display, sorter, publisher = Display(), Sorter(), Twin()
        drawing = CpuRenderer(threads=1)
        numbered = True
        batches = fuzz.batches(rng)
        for number, message in enumerate(batches, 1):
            with claims.of(case, size_of(message), _allowed(message)):
                results = [outcome(receiver, message) for receiver in (display, sorter)]
                assert results[0] == results[1], (results, brief(message))
                with contextlib.suppress(ValueError):
                    drawing.apply(message)
            numbered &= (message.revision, message.map_id) == (number, "map")
            numbered &= message.model == batches[0].model
            if results[0] == "refused":
                numbered = False
            elif numbered:
                assert outcome(publisher, message) == results[0], brief(message)
            for slot in looked_at(rng, message):
                assert display.in_use(slot) == sorter.in_use(slot), (slot, brief(message))
                assert not numbered or publisher.in_use(slot) == sorter.in_use(slot)
            for group in range(8):
                assert display.place(group) == sorter.place(group), brief(message)
                assert not numbered or publisher.place(group) == sorter.place(group)
            assert (display.origin, display.revision, display.missed, display.channels) == (
                sorter.origin, sorter.revision, sorter.missed, sorter.channels,
            )  # fmt: skip
        asked = fuzz.view_camera(rng)
        with contextlib.suppress(CameraError):
            look(sorter, native, asked)
        with contextlib.suppress(ValueError):  # says what is wrong with the camera
            seen = SplatCamera(*numbers(asked))
            if asked.width * asked.height < MOST_PIXELS:
                drawing.settings.detail = fuzz.one_of(rng, ["full", "2px", "50"])
                drawing.settings.mode = fuzz.one_of(rng, [DrawMode.COLOR, DrawMode.CHANNEL])
                assert drawing.draw(seen)["splats"] >= 0
                drawing.pick(seen)

    one_by_one("receive", fuzz.CASES, check)
    return claims


def look(sorter: Sorter, native: Any, asked: ViewCamera) -> None:
    """What a view is answered by whoever hears it. Raises CameraError."""
    eye = view_cameras.decode(asked)
    chunks = detail.Levels(
        np.array([[-5.0, -5, -5], [0, 0, 0]]), np.array([[0.0, 0, 0], [5, 5, 5]]), [(10, 100)] * 2
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scale = detail.magnification(chunks, [eye])
        levels = detail.choose(chunks, scale, [-1, -1], 3 * SLOTS_PER_PAGE, 1.0)
    assert not np.isnan(scale).any()
    assert levels == [1, 1] or min(levels) >= 0
    view = SortView.of(eye, sorter.map.frames)
    held = sorter.map
    native.update(held, slice(0, held.rows))
    expected = depth.order(view, held.positions, held.extents, *held.slots_and_groups())
    np.testing.assert_array_equal(native.order(view), expected)


def outcome(receiver: Any, message: GaussianArray) -> int | str:
    try:
        result: int = receiver.take(message)
    except ValueError:
        return "refused"
    return result


def size_of(message: Any) -> int:
    """What a message takes, roughly. [bytes]"""
    size = 0
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            size += size_of(value)
        elif isinstance(value, str):
            size += len(value)
        elif isinstance(value, list):
            size += sum(len(v) if isinstance(v, str) else size_of(v) for v in value)
        else:
            size += len(value) * value.itemsize if hasattr(value, "itemsize") else 8
    return size


def _allowed(message: GaussianArray, page: int = PAGE) -> int:
    """Ten times a batch's size, and pages of slots in all that hold a map. [bytes]"""
    slots = np.frombuffer(message.slots, np.uint32)
    splats = min(message.count, max(len(message.opacities), len(message.payload) // 24))
    ends = [message.first_slot, message.first_slot + splats]
    pages = len(np.unique(slots // SLOTS_PER_PAGE)) + ends[1] // SLOTS_PER_PAGE + 1
    pages -= ends[0] // SLOTS_PER_PAGE
    return 10 * size_of(message) + pages * page + (4 << 20)


def brief(message: GaussianArray) -> str:
    return str(message)[:600]


def looked_at(rng: np.random.Generator, message: GaussianArray) -> list[int]:
    slots = [*message.slots[:5], message.first_slot, message.first_slot + message.count - 1]
    slots += [int(rng.integers(fuzz.MOST)), 0, 1024]
    return [slot for slot in slots if 0 <= slot < fuzz.MOST]


# --- Publishers of maps ---------------------------------------------------------------------------


def test_who_hears_a_publisher_has_its_map(tmp_path: Path) -> None:
    in_a_process("publish", tmp_path)


def publish() -> Claims:
    """What the publisher in C++ sends, and is pulled from it, is its map, whatever is called."""
    claims = Claims()

    def check(case: int, rng: np.random.Generator) -> None:
        sent: list[GaussianArray] = []
        publisher = Publisher(lambda batch: sent.append(as_message(batch, Header())))
        heard, behind = Sorter(), Sorter()
        for message in fuzz.batches(rng):
            with (
                claims.of(case, size_of(message), _allowed(message, PUBLISHED_PAGE)),
                contextlib.suppress(ValueError, TypeError),
            ):
                publisher.take(message)
            for batch in sent:
                heard.take(batch)
            sent.clear()
            if rng.integers(2):
                catch_up(behind, publisher)
            after, block = fuzz.one_of(rng, fuzz.WHOLE), fuzz.one_of(rng, fuzz.WHOLE[:13])
            publisher.map.pull(publisher.map.map_id, after, block, 3)
        catch_up(behind, publisher)
        catch_up(late := Sorter(), publisher)
        for receiver in (heard, behind, late):
            np.testing.assert_array_equal(receiver.slots(), publisher.slots())
            for group in range(8):
                assert receiver.place(group) == publisher.place(group)

    one_by_one("publish", fuzz.CASES, check)
    return claims


def catch_up(receiver: Sorter, publisher: Publisher) -> None:
    """Pulls what a receiver lacks."""
    after, block = receiver.revision or 0, 0
    while True:
        batches, block = publisher.map.pull(publisher.map.map_id, after, block, 3)
        for batch in batches:
            receiver.take(as_message(batch, Header()), Arrival.PULLED)
        if not block:
            return


# --- What draws -----------------------------------------------------------------------------------


def test_a_viewer_draws_after_anything(tmp_path: Path, display: str) -> None:
    in_a_process("draw", tmp_path)


def draw() -> Claims:
    """One renderer takes all cases' batches, orders and cameras, and draws the last."""
    claims = Claims()
    renderer, reader = Renderer(), OrderReader()
    shared = OrderBuffer(orders := SharedOrders())

    def check(case: int, rng: np.random.Generator) -> None:
        renderer.settings.order = fuzz.one_of(rng, [OrderSource.SIDECAR, OrderSource.AUTO])
        renderer.settings.mode = fuzz.one_of(rng, [DrawMode.COLOR, DrawMode.CHANNEL])
        asked = fuzz.view_camera(rng)
        if asked.width * asked.height > MOST_PIXELS:
            return
        try:
            renderer.set_camera(f"{case}", asked.sequence, *numbers(asked))
        except ValueError:
            return
        for message in fuzz.batches(rng):
            message.map_id = f"{case}{message.map_id}"
            with (
                claims.of(case, size_of(message), _allowed(message)),
                contextlib.suppress(ValueError),
            ):
                renderer.apply(message)
        order = fuzz.order(rng, max(1, renderer.capacity), shared)
        with (
            claims.of(case, size_of(order), 32 * size_of(order) + (4 << 20)),
            contextlib.suppress(ValueError),
        ):
            offer(renderer, reader, case, order)
        drawn = renderer.draw(f"{case}", sort_now=bool(rng.integers(2)))
        assert (drawn["map_id"], drawn["revision"]) == (renderer.map_id, renderer.revision)
        assert drawn["splats"] <= renderer.capacity, drawn

    one_by_one("draw", fuzz.CASES // 4, check)
    orders.close()
    return claims


def offer(renderer: Renderer, reader: OrderReader, case: int, order: SplatOrder) -> None:
    """An order, as the viewer reads it, and as other programs do. Raises ValueError."""
    named = (
        f"{case}", order.sequence, f"{case}{order.map_id}", order.revision, order.backend,
        order.sort_time,
    )  # fmt: skip
    if order.encoding == SplatOrder.SLOTS:
        renderer.set_order(*named, np.frombuffer(order.slots, np.uint32))
    else:
        reader.read(order)
        renderer.read_order(
            *named, order.encoding, order.packed, order.count, order.slot_bits, order.segment,
            order.generation,
        )  # fmt: skip


# --- Readers of files -----------------------------------------------------------------------------


def test_damaged_files_are_refused_by_name(tmp_path: Path) -> None:
    in_a_process("read", tmp_path)


@pytest.mark.skipif(importlib.util.find_spec("pxr") is None, reason="no usd-core (PyPI)")
def test_damaged_usd_files_are_refused_by_name(tmp_path: Path) -> None:
    in_a_process("read_usd", tmp_path)


def read_usd() -> Claims:
    """As read; a process for each case takes a second."""
    return read("read_usd", fuzz.usd_scenes, fuzz.CASES // 20)


def read(
    name: str = "read",
    scenes: Callable[[Path], list[fuzz.Scene]] = fuzz.scenes,
    cases: int = fuzz.CASES,
) -> Claims:
    """A damaged file is a scene, or a InputError of a line that names it."""
    folder = Path.cwd()
    wholes = scenes(folder / "wholes")
    claims = Claims()
    loaded = refused = 0

    def check(case: int, rng: np.random.Generator) -> None:
        nonlocal loaded, refused
        scene = wholes[case % len(wholes)]
        victim = fuzz.one_of(rng, list(scene)[: 1 + int(rng.integers(len(scene)))])
        data = scene | {victim: fuzz.damaged(rng, scene[victim])}
        path = put(data, folder)
        size = sum(map(len, data.values()))
        with claims.of(case, size, FLOOR), warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", "Reading `.npy`")  # NumPy's, of Python 2
            try:
                formats.load(path, warn=lambda text: None)
                formats.axes(path)
                loaded += 1
            except InputError as error:
                refused += 1
                assert str(error).startswith(str(folder)), error
                assert "\n" not in str(error)
                assert len(str(error)) < 1000

    for scene in wholes:  # what readers import on the way is no file's claim
        assert len(formats.load(put(scene, folder))) > 0
    one_by_one(name, cases, check)
    if not fuzz.CASE:
        assert min(loaded, refused) > cases / 50
    return claims


def test_damaged_cameras_and_lenses_are_refused_by_name(tmp_path: Path) -> None:
    in_a_process("read_cameras", tmp_path)


def read_cameras() -> Claims:
    """A damaged file of cameras, or a calibration, is one, or an InputError that names it."""
    folder, claims = Path.cwd(), Claims()
    wholes = [(scene, _load_cameras) for scene in fuzz.camera_files()]
    wholes += [(scene, _load_lens) for scene in fuzz.lens_files()]
    loaded = refused = 0

    def check(case: int, rng: np.random.Generator) -> None:
        nonlocal loaded, refused
        whole, load = wholes[case % len(wholes)]
        victim = fuzz.one_of(rng, list(whole))
        files = whole | {victim: fuzz.damaged(rng, whole[victim])}
        with tempfile.TemporaryDirectory(dir=folder) as place:
            path = put(files, Path(place))
            size = sum(map(len, files.values()))
            with claims.of(case, size, FLOOR), warnings.catch_warnings():
                warnings.simplefilter("error")
                try:
                    load(path)
                    loaded += 1
                except InputError as error:
                    refused += 1
                    assert str(error).startswith(place), error
                    assert "\n" not in str(error)
                    assert len(str(error)) < 1000

    one_by_one("read_cameras", fuzz.CASES, check)
    if not fuzz.CASE:
        assert min(loaded, refused) > fuzz.CASES / 50
    return claims


def _load_cameras(path: Path) -> None:
    if path.stem == "cameras" and path.suffix != ".json":
        path = path.parent  # COLMAP's
    for camera in load_cameras(path, warn=lambda text: None):
        assert np.isfinite(camera.world_to_camera).all()


def _load_lens(path: Path) -> None:
    info = calibrations.load(str(path))
    for lens_of in (calibrations.lens_of, lambda info: calibrations.rectified(info)[0]):
        with contextlib.suppress(LensError):  # says what is wrong with it
            lens = lens_of(info)
            if lens.width * lens.height < MOST_PIXELS:
                for samples in Warp(lens).samples:
                    assert np.isfinite([samples.x, samples.y]).all()


def put(scene: fuzz.Scene, folder: Path) -> Path:
    """Writes a scene's files; returns the one that is opened."""
    for name, content in scene.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    return folder / next(iter(scene))


# --- Nodes ----------------------------------------------------------------------------------------


def test_nodes_outlive_what_their_peers_send(tmp_path: Path, node: Any, listener: Any) -> None:
    remap = ["--ros-args", "-r", f"__ns:={node.get_namespace()}"]
    hostile = [*remap, "-r", "gaussians:=hostile"]
    os.mkfifo(tmp_path / "fifo")
    (scene,) = [s for s in fuzz.scenes(tmp_path / "wholes") if "scene.spz" in s]
    whole = tmp_path / "wholes" / "scene.spz"
    paths = ["", "\n" * 100, "x" * 5000, str(tmp_path / "fifo"), str(tmp_path), "procedural:-1",
             "\x00", "/dev/zero", str(tmp_path / "damaged"), str(whole)]  # fmt: skip
    with Processes(tmp_path / "log") as processes:
        started = [
            processes.node("rosplat_sorter", "sorter", *hostile),
            processes.node("rosplat_tools", "ply_publisher", *remap, "-p", "save_root:=/"),
            processes.node("rviz_gaussian_plugin", "viewer", *hostile, "-p", "serve:=true"),
        ]
        maps = node.create_publisher(GaussianArray, "hostile", MAP)
        views = node.create_publisher(ViewCamera, "hostile/view", VIEW)
        wanted = ViewCamera(sequence=1)  # an order, for which the sorter hears the map
        listener.wait(lambda: views.publish(wanted) or maps.get_subscription_count() == 2)

        def call(kind: Any, name: str, **request: object) -> Any:
            """Calls a service, unless one of them ends."""
            answer = listener.request(kind, name, **request)
            listener.wait(lambda: processes.check() or answer.done())
            return answer.result()

        listener.call(RenderView, "hostile/render")
        before = [_status("VmHWM", process.pid) for process in started]
        pixels = 0
        for case in fuzz.cases(min(fuzz.CASES, 2000) // 20):
            rng = fuzz.random(case)
            for message in fuzz.batches(rng):
                maps.publish(message)
            asked = fuzz.view_camera(rng)
            views.publish(asked)
            drawn = call(RenderView, "hostile/render", camera=asked).color
            pixels = max(pixels, drawn.width * drawn.height)
            (tmp_path / "damaged").write_bytes(fuzz.damaged(rng, scene["scene.spz"]))
            path = fuzz.one_of(rng, paths)
            if case % 4 == 0:
                call(LoadScene, "ply_publisher/load", path=path)
            elif case % 4 == 1:
                target = path if path != str(whole) else str(tmp_path / "saved.ply")
                call(SaveMap, "ply_publisher/save", path=target)
            processes.check()
        for process, least in zip(started, before, strict=True):
            assert _status("VmHWM", process.pid) - least < FLOOR + PIXEL * pixels
        for name in ("sorter", "ply_publisher", "viewer"):
            assert "Traceback" not in processes.said(name)
            assert max(map(len, processes.said(name).splitlines())) < 2000


def _run(name: str) -> None:
    for module in (_core, _offscreen) if SANITIZERS else ():
        built = Path(module.__file__ or "").read_bytes()
        assert b"__asan_" in built, f"{module.__file__} was built without the sanitizers"
    checks = {
        "receive": receive,
        "publish": publish,
        "draw": draw,
        "read": read,
        "read_usd": read_usd,
        "read_cameras": read_cameras,
    }
    found = checks[name]().most
    Path(f"{name}.json").write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    try:
        _run(sys.argv[1])
    except Exception:
        traceback.print_exc()
        sys.stdout.flush()
        os._exit(1)  # whatever a renderer would say at its end
