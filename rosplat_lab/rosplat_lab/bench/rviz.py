"""How long a frame of rviz2 takes, and how near its picture is, by our Display and by others."""

from __future__ import annotations

import contextlib
import math
import re
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from rosplat_core import formats
from rosplat_core.cameras import Camera, Place, look_at, place
from rosplat_core.program import machine
from rosplat_core.splats import InputError, Splats
from rosplat_lab import driven_rviz, metrics
from rosplat_lab.bench import mouse, scenes
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Budget, Doing, Event, Measurement, Skipped
from rosplat_lab.driven_rviz import DrivenRviz, Refused
from rosplat_lab.programs import Programs
from rosplat_lab.reference.renderer import render
from rosplat_ros.program.processes import ProcessError, Processes, quoted

SIZES = (500_000, 2_000_000)
QUICK_SIZES = (20_000,)
PICTURE, SOFTWARE_PICTURE, QUICK_PICTURE = (1920, 1080), (960, 720), (640, 360)
FRAME = (200, 200)  # what rviz2's window has around its view, at most [px]
FOV = math.pi / 4  # height of an Orbit view, which nothing changes [rad]
DISTANCES = {"overview": 2.5, "near": 1.0}  # of the camera, by the name of the view [radii]
NEAREST = 0.001  # where a view's near plane may be [m]
TURNS = {"standing": 0.0, "moving": math.radians(30)}  # of the camera [rad/s]
ACCURATE = 1_000_000  # splats that the reference draws in minutes
SETTLING, QUICK_SETTLING = 1.0, 0.3  # between what changes and what is measured [s]
LOADING = 300.0  # until a display shows the scene [s]
PICTURE_TIMEOUT = 60.0  # [s]

OURS = {"Class": "rviz_gaussian_plugin/GaussianMap", "Name": "ROSplat", "Topic": "{topic}"}
UNSYNCHRONISED = {"__GL_SYNC_TO_VBLANK": "0", "vblank_mode": "0"}  # NVIDIA's drivers, Mesa's

Display = dict[str, Any]
"""An entry of `Displays` in an .rviz file, as rviz saves it."""


def measure(plan: Plan) -> Iterator[Event]:
    """Frame times by scene, view, motion of the camera and display; PSNR where it stands."""
    displays = [OURS]
    for path in plan.displays:
        displays += read_displays(path)
    if not driven_rviz.is_here():
        yield Skipped("no rviz2, or rviz_gaussian_plugin was built without it")
        return
    from rviz_gaussian_plugin.offscreen import ensure_display

    names = scenes.names(plan.sizes or (QUICK_SIZES if plan.quick else SIZES), plan.scenes)
    width, height = _picture(plan)
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(ensure_display(width + FRAME[0], height + FRAME[1]))
        except RuntimeError as error:
            yield Skipped(f"rviz2: {error}")
            return
        for number, name in enumerate(names):
            yield from _scene(plan, name, displays, number, len(names))


def _picture(plan: Plan) -> tuple[int, int]:
    if plan.quick:
        return QUICK_PICTURE
    return PICTURE if machine.nvidia_gpu()[0] else SOFTWARE_PICTURE


def read_displays(path: Path) -> list[Display]:
    """The displays of a YAML file: a list, as `Displays` of an .rviz file. Raises InputError."""
    try:
        entries = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except (ValueError, yaml.YAMLError) as error:
        raise InputError(f"{path}: not YAML: {error}") from error
    if not (isinstance(entries, list) and entries and all(map(_is_display, entries))):
        raise InputError(f"{path}: expected a list of displays, each with Class and Name")
    return entries


def _is_display(entry: object) -> bool:
    return isinstance(entry, dict) and {"Class", "Name"} <= entry.keys()


@dataclass(frozen=True)
class Orbit:
    """A camera that looks at a point, as rviz's Orbit view has it. [m, rad]"""

    focus: NDArray[np.float64]
    distance: float
    near: float
    pitch: float = 0.35
    yaw: float = 0.6

    @classmethod
    def of(cls, camera: Camera, distance: float) -> Orbit:
        """An orbit around the point so far ahead of a camera that stands upright."""
        ahead = camera.world_to_camera[2, :3]
        eye = -camera.world_to_camera[:3, :3].T @ camera.world_to_camera[:3, 3]
        pitch, yaw = math.asin(-ahead[2]), math.atan2(-ahead[1], -ahead[0])
        return cls(eye + distance * ahead, distance, camera.near, pitch, yaw)

    def view(self) -> dict[str, Any]:
        """The orbit as the view in an .rviz file."""
        x, y, z = map(float, self.focus)
        return {
            "Class": "rviz_default_plugins/Orbit", "Distance": self.distance,
            "Focal Point": {"X": x, "Y": y, "Z": z}, "Near Clip Distance": self.near,
            "Pitch": self.pitch, "Yaw": self.yaw,
        }  # fmt: skip

    def camera(self, width: int, height: int) -> Camera:
        """The orbit as the reference's camera."""
        flat = math.cos(self.pitch)
        outward = [
            flat * math.cos(self.yaw), flat * math.sin(self.yaw), math.sin(self.pitch)
        ]  # fmt: skip
        eye = self.focus + self.distance * np.array(outward)
        focal = 0.5 * height / math.tan(FOV / 2)
        pose = look_at(eye, self.focus)
        return Camera(0, width, height, focal, focal, width / 2, height / 2, pose, near=self.near)


def _scene(
    plan: Plan, name: str, displays: list[Display], number: int, total: int
) -> Iterator[Event]:
    yield Doing(f"{name}: loading", number / total)
    splats = scenes.load(name)
    here = place(splats)
    near = max(0.001 * here.radius, NEAREST)
    orbits = {
        view: Orbit(here.centre, distance * here.radius, near)
        for view, distance in DISTANCES.items()
        if view == "overview" or not plan.quick
    }
    by_mouse = {"overview": orbits["overview"]}
    if not plan.quick:
        by_mouse["inside"] = _inside(name, splats, here)
    with Programs(plan.out / "log") as programs:
        values = {
            "ply": str((programs.folder / "rviz.ply").resolve()),
            "topic": f"{programs.namespace}/gaussians", "sh_degree": str(splats.sh_degree),
        }  # fmt: skip
        programs.node("rosplat_tools", "ply_publisher", "-p", f"path:={quoted(name)}")
        if "{ply}" in str(displays):
            formats.save(values["ply"], splats)
        bench = Bench(plan, name, splats, orbits, by_mouse, programs)
        if len(splats) <= ACCURATE:
            yield Doing(f"{name}: reference pictures", number / total)
            bench.draw_references()
        for index, display in enumerate(displays):
            done = (number + index / len(displays)) / total
            yield Doing(f"{name}, {display['Name']}", done)
            try:
                yield from bench.display(filled(display, values))
            except (Refused, TimeoutError, ProcessError) as error:
                yield Skipped(f"{name}, {display['Name']}: {error}")


def _inside(name: str, splats: Splats, place: Place) -> Orbit:
    """A view from within a scene; in rooms, where it stands in one."""
    rooms = "room" in scenes.views(name)
    (camera,) = scenes.VIEWS["room" if rooms else "inside"](splats, *PICTURE, 1)
    return Orbit.of(camera, 0.5 if rooms else 0.6 * place.radius)


def filled(entry: Any, values: dict[str, str]) -> Any:
    """The entry with {ply}, {topic} and {sh_degree} in its texts replaced."""
    if isinstance(entry, dict):
        return {key: filled(value, values) for key, value in entry.items()}
    if isinstance(entry, str):
        for key, value in values.items():
            entry = entry.replace(f"{{{key}}}", value)
    return entry


@dataclass
class Bench:
    """Displays of a scene, each in an rviz2 of its own."""

    plan: Plan
    name: str
    splats: Splats
    orbits: dict[str, Orbit]
    by_mouse: dict[str, Orbit]
    processes: Processes
    references: dict[str, NDArray[np.float64]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._picture = _picture(self.plan)
        self._settling = Budget(1, 1, QUICK_SETTLING if self.plan.quick else SETTLING)

    def draw_references(self) -> None:
        """Draws what each view should show, on black."""
        for view, orbit in self.orbits.items():
            picture = render(self.splats, orbit.camera(*self._picture))
            self.references[view] = np.clip(picture.rgba[..., :3], 0, 1)

    def display(self, display: Display) -> Iterator[Event]:
        """All measurements of a display. Raises Refused, TimeoutError, ProcessError."""
        with Processes(self.processes.folder) as own:
            rviz = DrivenRviz(own, configuration(display, self.orbits), **UNSYNCHRONISED)
            if not rviz.properties(display["Name"]):
                raise Refused(f"rviz2 has no {display['Class']}, or can't load it")
            self._resize(rviz)
            self._wait_until_shown(rviz, display["Name"])
            put(rviz, display)
            self._watch(rviz, 0.0, self._settling)  # until the map is uploaded
            for view in self.orbits:
                yield from self._view(rviz, display["Name"], view)
            if "llvmpipe" in self._watch(rviz, 0.0, self._settling)["renderer"]:
                yield from self._drag(rviz, display["Name"])

    def _resize(self, rviz: DrivenRviz) -> None:
        width, height = self._picture
        deadline = time.monotonic() + 10
        while rviz.ask("resize", width=width, height=height) != [width, height]:
            if time.monotonic() > deadline:
                raise TimeoutError(f"the screen has no room for {width}x{height} in rviz2's window")
            time.sleep(0.2)

    def _wait_until_shown(self, rviz: DrivenRviz, name: str) -> None:
        """Waits until the Status of the display counts the scene's splats."""
        deadline = time.monotonic() + LOADING
        count = re.compile(rf"\b{len(self.splats)}\b")
        while True:
            status = rviz.status(name)
            texts = [text.replace(",", "") for level, text in status.values() if level == "Ok"]
            if any(map(count.search, texts)):
                return
            self.processes.check()
            if time.monotonic() > deadline:
                raise TimeoutError(f"its Status never counted the splats: {status}")
            time.sleep(0.1)

    def _labels(self, view: str, display: str) -> dict[str, Any]:
        width, height = self._picture
        return {
            "scene": self.name, "splats": len(self.splats), "picture": f"{width}x{height}",
            "view": view, "display": display,
        }  # fmt: skip

    def _drag(self, rviz: DrivenRviz, name: str) -> Iterator[Event]:
        if not shutil.which("xdotool"):
            yield Skipped(f"{self.name}, {name}: no xdotool to move the mouse with")
            return
        rviz.set("Global Options", "Frame Rate", value=mouse.FRAME_RATE)
        for view, orbit in self.by_mouse.items():
            put(rviz, orbit.view(), root="view")
            yield from mouse.measure(rviz, self.plan.quick, self._labels(view, name))

    def _view(self, rviz: DrivenRviz, name: str, view: str) -> Iterator[Measurement]:
        labels = self._labels(view, name)
        for camera, turn in TURNS.items():
            put(rviz, self.orbits[view].view(), root="view")
            self._watch(rviz, turn, self._settling)
            seen = self._watch(rviz, turn, self.plan.budget)
            labels["gpu"] = seen["renderer"]
            yield Measurement("frame", "ms", seen["frame"], **labels, camera=camera)
            if "llvmpipe" not in seen["renderer"]:  # llvmpipe's clock misses what it defers
                yield Measurement("drawing", "ms", seen["drawing"], **labels, camera=camera)
            if not turn and view in self.references:
                found = metrics.psnr(self._photograph(rviz), self.references[view])
                yield Measurement("PSNR", "dB", found, **labels)

    def _watch(self, rviz: DrivenRviz, turn: float, budget: Budget) -> Any:
        rviz.ask("start watch", turn=turn)
        time.sleep(budget.seconds)
        while rviz.ask("frames") <= budget.least:  # one more: times lie between two
            time.sleep(0.1)
        return rviz.ask("stop watch")

    def _photograph(self, rviz: DrivenRviz) -> NDArray[np.float64]:
        file = rviz.folder / "rviz.png"
        file.unlink(missing_ok=True)
        rviz.ask("photograph", file=str(file.resolve()))
        deadline = time.monotonic() + PICTURE_TIMEOUT
        while not file.exists():
            rviz.processes.check()
            if time.monotonic() > deadline:
                raise TimeoutError("rviz2 draws no more")
            time.sleep(0.05)
        with Image.open(file) as picture:
            return np.asarray(picture.convert("RGB")) / 255


def configuration(display: Display, orbits: dict[str, Orbit]) -> str:
    """The text of an .rviz file with a display and a hidden Grid; it draws as often as it can."""
    (first, *_) = orbits.values()
    manager = {
        "Displays": [{"Enabled": True, "Value": True} | display, mouse.GRID],
        "Global Options": {
            "Fixed Frame": "map", "Background Color": "0; 0; 0", "Frame Rate": 1000
        },
        "Tools": [{"Class": "rviz_default_plugins/MoveCamera"}],
        "Views": {"Current": first.view()},
    }  # fmt: skip
    text: str = yaml.safe_dump({"Panels": [], "Visualization Manager": manager})
    return text


def put(rviz: DrivenRviz, wanted: Display, root: str = "displays") -> None:
    """Sets properties that differ: a display may clamp values before it knows its scene."""
    above = [wanted["Name"]] if root == "displays" else []
    found = rviz.properties(*above, root=root)
    for path, value in _values(wanted):
        name = "/".join(path)
        if name not in found:
            raise Refused(f"{wanted['Class']} has no property {name}, it has: {', '.join(found)}")
        if not _is(found[name], value):
            try:
                rviz.set(*above, *path, value=value, root=root)
            except Refused as error:
                raise Refused(f"{name} of {wanted['Class']} is {found[name]}: {error}") from error


def _values(entry: dict[str, Any], *above: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Path and value of each property that has a value of its own."""
    for key, value in entry.items():
        if isinstance(value, dict):
            yield from _values(value, *above, key)
        elif above and key == "Value":  # of a property that has others below it
            yield above, value
        elif above or key not in ("Class", "Name", "Enabled", "Value"):
            yield (*above, key), value


def _is(found: object, wanted: object) -> bool:
    if isinstance(found, float) and isinstance(wanted, float):
        return math.isclose(found, wanted, rel_tol=1e-6, abs_tol=1e-9)  # rviz has 32 bits
    return str(found) == str(wanted)
