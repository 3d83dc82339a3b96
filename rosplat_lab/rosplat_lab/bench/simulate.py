"""A robot that lives in a map: pictures of its camera with physics between them, and lidar scans.

Also many robots, each in an environment of its own, in one map; and the same pictures by
mujoco_warp, where it is installed. Everything runs without ROS. The truth of ranges is that of
generated rooms: the surfaces that their splats were laid on.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from ament_index_python.packages import get_package_share_directory
from numpy.typing import NDArray

from rosplat_core import harmonics
from rosplat_core.generated.rooms import Rooms
from rosplat_core.quaternions import from_matrices, to_matrices
from rosplat_core.rendering import CpuRenderer, Renderer
from rosplat_core.scenes import ROOMS
from rosplat_core.splats import InputError, Splats
from rosplat_core.upright import find_up
from rosplat_lab.bench import scenes
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Budget, Doing, Event, Measurement, Skipped, milliseconds
from rosplat_lab.reference.room_rays import meet, off_edges
from rosplat_tools import SplatCamera
from rosplat_tools.lidars.scanning import Lidar, Pattern
from rosplat_tools.simulation.physics import load_mujoco
from rosplat_tools.simulation.robot_model import Standing, put_in_map

RIVAL = "mujoco_warp"
SIZES, QUICK_SIZES = (500_000,), (20_000,)  # of rooms
SEED = 0
START = (-1.2, -1.2, 0.0)  # in rooms: in the middle one, between its doors [m, rad]
PERIOD = 0.1  # between pictures [s]
TURN = 1.0  # of the robot, on the spot [rad/s]
CAMERA = "camera"  # 640x360
ENVIRONMENTS = (1, 4, 16)
PICTURES = ((84, 84), (320, 240), (640, 360))  # of the environments [px]
QUICK_PICTURES = PICTURES[:1]
HEADINGS = 8  # from which another draws the same pictures
RINGS, COLUMNS = 16, 1024
HEIGHT = 0.3  # of the lidar over the floor [m]
TURNS = 3  # scans from places beside START
EDGE = 0.03  # rays that pass an edge by less are counted apart [m]
CLOSE = 0.03  # an error that counts as small [m]
ANGLES = (0, 30, 60, 75, 90)  # of incidence [deg]

Sizes = tuple[tuple[int, int], ...]


def measure(plan: Plan) -> Iterator[Event]:
    """Milliseconds, also of a core, of a picture and of physics; steps a second of environments;
    errors and time of a lidar."""
    try:
        load_mujoco()
    except InputError as error:
        yield Skipped(f"robots: {error}")
        return
    rooms = [f"{ROOMS}{size}" for size in plan.sizes or (QUICK_SIZES if plan.quick else SIZES)]
    pictures = QUICK_PICTURES if plan.quick else PICTURES
    for number, name in enumerate([*rooms, *plan.scenes]):
        yield Doing(name, number / (len(rooms) + len(plan.scenes)))
        yield from isolated(_filmed, name, plan.budget, pictures)
        yield from isolated(_filmed_by_card, name, plan.budget, pictures)
        yield from isolated(_beside, name)
        if name in rooms:
            yield from isolated(_scanned, name, plan.budget)


def _filmed(name: str, budget: Budget, sizes: Sizes) -> Iterator[Event]:
    splats = scenes.load(name)
    began = time.perf_counter()
    stands = _turning(name, splats)
    put = time.perf_counter() - began
    yield Measurement("solid parts of the map", "s", put, name, len(splats), boxes=stands.boxes)
    yield from _pictures(name, splats, stands, CpuRenderer(splats), "", budget, sizes)


def _filmed_by_card(name: str, budget: Budget, sizes: Sizes) -> Iterator[Event]:
    from rviz_gaussian_plugin.offscreen import CardRenderer

    splats = scenes.load(name)
    card = CardRenderer(splats)
    if "llvmpipe" in card.device:
        yield Skipped(f"pictures by a graphics card: there is {card.device}")
    else:
        yield from _pictures(name, splats, _turning(name, splats), card, card.device, budget, sizes)


def _pictures(
    name: str, splats: Splats, stands: Standing, renderer: Renderer, gpu: str, budget: Budget,
    sizes: Sizes,
) -> Iterator[Event]:  # fmt: skip
    robot = stands.robot
    eye = SplatCamera(robot.model, robot.data, renderer, map_pose=stands.map_pose)
    if eye.problem:
        yield Skipped(f"bodies in pictures: {eye.problem}")

    def of(quantity: str, work: Callable[[], object]) -> Iterator[Event]:
        return _both(quantity, _timed(work, budget), name, len(splats), gpu)

    def live() -> None:
        robot.step(PERIOD)
        eye.render(CAMERA)

    def in_time() -> None:
        robot.step(time.perf_counter() - start - robot.time)  # what the clock is ahead
        eye.render(CAMERA)

    yield from of(f"physics of {PERIOD:g} s", lambda: robot.step(PERIOD))
    yield from of("picture and depth, with physics", live)
    start = time.perf_counter() - robot.time
    yield from of("picture and depth, in real time", in_time)
    yield from of("picture and depth, with bodies", lambda: eye.picture(CAMERA, bodies=True))
    for size in sizes:
        robot.model.cam_resolution[robot.model.camera(CAMERA).id] = size
        for count in ENVIRONMENTS:
            yield Measurement(
                "steps a second", "1/s", _steps(stands, eye, count, budget), name, len(splats), gpu,
                environments=count, pixels=f"{size[0]}x{size[1]}",
            )  # fmt: skip


def _turning(name: str, splats: Splats) -> Standing:
    """A robot that turns on the spot."""
    file = Path(get_package_share_directory("rosplat_tools")) / "robots/mobile.xml"
    start = START if name.startswith(ROOMS) else (0.0, 0.0, 0.0)
    stands = put_in_map(file, splats, find_up(splats), start)
    stands.robot.command("angular_z", TURN)
    return stands


def _steps(stands: Standing, eye: SplatCamera, count: int, budget: Budget) -> list[float]:
    """How many steps all environments together take in a second: a step is PERIOD and a picture."""
    robot = stands.robot
    model, steps = robot.model, round(PERIOD / robot.model.opt.timestep)
    datas = [copy.copy(robot.data) for _ in range(count)]
    for number, data in enumerate(datas):  # no two see the same
        data.actuator("angular_z").ctrl = TURN * (1 + number / count)

    def step() -> None:
        for data in datas:
            load_mujoco().mj_step(model, data, steps)
            eye.render(CAMERA, data)

    return [1e3 * count / passed for passed in budget.spend(lambda _: milliseconds(step))]


def _beside(name: str) -> Iterator[Event]:
    """Our pictures and a rival's, of the same robot at the same headings."""
    splats = scenes.load(name)
    stands = _turning(name, splats)
    robot = stands.robot
    try:
        theirs = WarpCamera(robot.model, robot.data, splats, stands.map_pose, CAMERA)
    except ImportError as error:
        yield Skipped(f"the same pictures by {RIVAL}: {error} (pip install mujoco-warp)")
        return
    eye = SplatCamera(robot.model, robot.data, splats, map_pose=stands.map_pose)
    work: dict[str, Callable[[], object]] = {
        "rosplat": lambda: eye.render(CAMERA), theirs.name: theirs.render,
    }  # fmt: skip
    samples: dict[str, list[tuple[float, float]]] = {by: [] for by in work}
    for number in range(HEADINGS + 1):
        theirs.set_data(robot.data)
        for by, draw in work.items():
            taken = _clocked(draw)
            if number:  # the first compiles
                samples[by].append(taken)
        robot.step(2 * math.pi / HEADINGS / TURN)
    for by, pairs in samples.items():
        passed, used = zip(*pairs, strict=True)
        yield from _both("the same pictures by", (passed, used), name, len(splats), by=by)


def _scanned(name: str, budget: Budget) -> Iterator[Event]:
    splats = scenes.load(name)
    renderer, rooms = CpuRenderer(splats), Rooms(np.random.default_rng(SEED))
    pattern = Pattern.of(RINGS, COLUMNS, -math.radians(15), math.radians(15))
    lidar, random = Lidar(pattern), np.random.default_rng(SEED)
    errors, angles, clear = [], [], []
    pose = to_lidar = np.eye(4)
    for _ in range(TURNS):
        pose[:3, 3] = np.add((*START[:2], HEIGHT), random.uniform(-0.2, 0.2, 3))
        eyes = np.broadcast_to(pose[:3, 3], pattern.rays.shape)
        met = meet(rooms, eyes, pattern.rays)
        to_lidar = np.asarray(np.linalg.inv(pose))
        errors.append(lidar.scan(renderer, to_lidar).ranges - met.distances)
        angles.append(np.degrees(met.angles))
        clear.append(off_edges(rooms, eyes, pattern.rays, met.sides, EDGE))
    error, angle = np.abs(np.concatenate(errors)), np.concatenate(angles)
    for low, high in (*pairwise(ANGLES), (0, 60)):
        within = (angle >= low) & (angle < high)
        for rays, chosen in (("all", within), ("off edges", within & np.concatenate(clear))):
            said = {"incidence": f"{low} to {high} deg", "rays": rays}
            known = error[chosen]
            yield Measurement(
                "error of ranges", "mm", 1e3 * np.median(known), name, len(splats), **said
            )
            yield Measurement(
                f"ranges within {CLOSE:g} m", "share", np.mean(known < CLOSE), name, len(splats),
                **said,
            )  # fmt: skip
    taken = _timed(lambda: lidar.scan(renderer, to_lidar), budget)
    yield from _both("scan", taken, name, len(splats), rings=RINGS, columns=COLUMNS)


def _both(
    quantity: str, taken: tuple[Sequence[float], Sequence[float]], *of: Any, **parameters: Any
) -> Iterator[Event]:
    """Measurements of times by the clock, and of all cores together; the rest as Measurement's."""
    passed, used = taken
    yield Measurement(quantity, "ms", passed, *of, **parameters)
    yield Measurement(f"{quantity}, processor", "core-ms", used, *of, **parameters)


def _timed(work: Callable[[], object], budget: Budget) -> tuple[list[float], list[float]]:
    """Milliseconds of each call, by the clock and of all cores together."""
    used: list[float] = []

    def once(_: int) -> float:
        passed, of_cores = _clocked(work)
        used.append(of_cores)
        return passed

    return budget.spend(once), used[1:]  # the first call warms up


def _clocked(work: Callable[[], object]) -> tuple[float, float]:
    """Milliseconds of a call, by the clock and of all cores together."""
    before = time.process_time()
    passed = milliseconds(work)
    return passed, 1e3 * (time.process_time() - before)


class WarpCamera:
    """A camera of a MuJoCo model, through which mujoco_warp sees its bodies and a map, on the
    processor: the other that draws both. Its splats have one colour for all directions, and stand
    still in the world of the model."""

    def __init__(
        self, model: Any, data: Any, splats: Splats, map_pose: NDArray[np.float64], camera: str
    ) -> None:
        """map_pose: (4, 4) the map's pose in MuJoCo's world [m]. Raises ImportError."""
        import mujoco_warp
        import warp

        warp.config.log_level = warp.LOG_ERROR  # else it tells of all that it compiles
        self.name = f"{RIVAL} {version('mujoco-warp')}"
        self._warp, self._mujoco_warp = warp, mujoco_warp
        self._model = model
        place, turn = map_pose[:3, 3], map_pose[:3, :3]
        orientations = from_matrices(turn @ to_matrices(splats.orientations))
        colours = np.clip(0.5 + harmonics.C0 * splats.sh[:, 0], 0, 1)
        number = model.camera(camera).id
        width, height = model.cam_resolution[number].tolist()
        with warp.ScopedDevice("cpu"):
            self._warp_model = mujoco_warp.put_model(model)
            self._context = mujoco_warp.create_render_context(
                model,
                cam_active=[number],
                render_rgb=True,
                render_depth=True,
                splat_position=_floats((splats.positions + splats.origin) @ turn.T + place),
                splat_rotation=_floats(np.roll(orientations, 1, axis=1)),  # w first
                splat_scale=_floats(splats.scales),
                splat_rgba=_floats(np.column_stack([colours, splats.opacities])),
            )
            self._rgb = warp.empty((1, height, width), dtype=warp.vec3)
            self._depth = warp.empty((1, height, width), dtype=float)
        self.set_data(data)

    def set_data(self, data: Any) -> None:
        """Takes the state of the pictures to come."""
        with self._warp.ScopedDevice("cpu"):
            self._data = self._mujoco_warp.put_data(self._model, data)

    def render(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Colours (height, width, 3), 0 to 1, and depths (height, width) as it means them."""
        with self._warp.ScopedDevice("cpu"):
            self._mujoco_warp.refit_bvh(self._warp_model, self._data, self._context)
            self._mujoco_warp.render(self._warp_model, self._data, self._context)
            self._mujoco_warp.get_rgb(self._context, 0, self._rgb)
            self._mujoco_warp.get_depth(self._context, 0, 1.0, self._depth)
            return self._rgb.numpy()[0], self._depth.numpy()[0]


def _floats(values: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, np.float32)
