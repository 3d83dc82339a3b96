"""An emulated SLAM run of as many minutes as are asked for, with all that goes wrong on robots.

    python tests/soak.py --minutes 60

A SLAM back end publishes ten messages a second. On another machine, as to network and shared
memory, a sorter and a viewer hear it. One fault after the other strikes and is mended; what the
viewer draws is held against the map of the very revision that it names, drawn here.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import itertools
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from line import Line, NoLine
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from soak_slam import BATCH, RATE, as_message, last_step, steps

from rosplat_core.generated import generate
from rosplat_core.program.machine import machine
from rosplat_core.program.output import say
from rosplat_core.rendering import CpuRenderer, SplatCamera
from rosplat_lab.bench import scenes
from rosplat_msgs.srv import RenderView
from rosplat_ros.program.processes import Processes, interrupt_by_signals, node_command
from rosplat_ros.view_cameras import numbers, view_camera

MOST_SPLATS = 1_500_000
GROWING = 0.25  # of all the time
LASTING = 0.75  # of it, no program is killed
HOLD = 4.0  # how long a fault lasts, but in runs of seconds [s]
PATIENCE = 90.0  # with the right picture after it [s]
REPEAT = 1.0  # after which it is asked for a picture once more, and twice as long from then on [s]
ORDER_TIMEOUT = 0.3  # with the sorter, until the viewer sorts by itself [s]
RIGHT = 45.0  # a picture is that of its revision from so many decibels on
PICTURE = (160, 120)
SHARED_MEMORY = 3 << 29  # of both machines together [bytes]
CLOCK_JUMP = 100.0  # back [s]
NETWORKS = Path("/run/netns")  # where iproute2 has them by name
HERE = Path(__file__).resolve().parent


class Truth:
    """The map as it has to be after a step, and the picture of it."""

    def __init__(self, size: int) -> None:
        self._steps = steps(size)
        self._renderer = CpuRenderer()
        self._step = 0
        scene = generate(size, sh_degree=0)
        self.camera = view_camera(scenes.overview(scene, *PICTURE, 1)[0])

    def picture(self, step: int) -> np.ndarray:
        """(height, width, 4) after a step, which can't be before the last that was asked for."""
        while self._step < step:
            self._step += 1
            self._renderer.apply(as_message(next(self._steps), self._step))
        return self._renderer.draw(SplatCamera(*numbers(self.camera)))["colour"]

    @property
    def step(self) -> int:
        return self._step


def decibels(picture: np.ndarray, expected: np.ndarray) -> float:
    error = float(np.mean((picture - expected) ** 2))
    return 100.0 if error == 0 else -10 * np.log10(error)


class Machines:
    """Two, joined by a line; or, where only root may make them, this one alone."""

    def __init__(self, stack: contextlib.ExitStack) -> None:
        self.missing = ""
        try:
            if os.geteuid():
                raise NoLine("only root may make network namespaces")
            _own_shared_memory()
            self._line: Line | None = stack.enter_context(Line("1gbit"))
            _enter(self._line.namespace("there"))
        except NoLine as error:
            self._line, self.missing = None, str(error)

    def at(self, end: str, command: list[str]) -> list[str]:
        return self._line.at(end, command) if self._line else command

    def connect(self, connected: bool) -> None:
        assert self._line
        self._line.connect(connected)

    def memory(self, end: str) -> Path:
        assert self._line
        return self._line.memory(end)


_libc = ctypes.CDLL(None, use_errno=True)


def _own_shared_memory() -> None:
    """Gives this program and its children a /dev/shm of their own, of SHARED_MEMORY.

    And a list of network namespaces, so that none outlives them.
    """
    new_mounts = 0x20000  # CLONE_NEWNS
    if _libc.unshare(new_mounts):
        raise NoLine(f"no mounts of its own: {os.strerror(ctypes.get_errno())}")
    subprocess.run(["mount", "--make-rprivate", "/"], check=True)
    size = f"size={SHARED_MEMORY}"
    NETWORKS.mkdir(exist_ok=True)
    for folder in ("/dev/shm", str(NETWORKS)):
        subprocess.run(["mount", "-t", "tmpfs", "-o", size, "tmpfs", folder], check=True)


def _enter(namespace: str) -> None:
    """Has what this thread, and those that it makes, do next over the network happen there."""
    with (NETWORKS / namespace).open() as file:
        if _libc.setns(file.fileno(), 0):
            raise NoLine(f"{namespace}: {os.strerror(ctypes.get_errno())}")


@dataclass
class Found:
    """What the report says."""

    faults: list[dict[str, Any]] = field(default_factory=list)
    memory: list[tuple[float, str, int]] = field(default_factory=list)
    lasted: float = 0.0  # when programs were killed first [s]
    longest_frame: float = 0.0
    longest_answer: float = 0.0
    pictures: int = 0
    sorted_by: Counter[str] = field(default_factory=Counter)  # how many of them, by whom
    wrong: int = 0  # not as the map was at the revision that they name
    wrong_but_complete: int = 0  # of those, that claim to have all of the map


class Soak:
    """The programs, and a client that asks the viewer for one picture after the other."""

    def __init__(self, minutes: float, out: Path, stack: contextlib.ExitStack) -> None:
        self.began = time.monotonic()
        self.seconds = 60 * minutes
        self.size = min(MOST_SPLATS, int(self.seconds * GROWING * RATE * BATCH))
        self.hold = min(HOLD, 10 * minutes)
        self.found = Found()
        self.machines = Machines(stack)
        self.clock = 1e6  # that all programs go by; each jump takes it back [s]
        self._trace = out / "trace.txt"
        self._trace.unlink(missing_ok=True)
        self._truth = Truth(self.size)
        self._processes = stack.enter_context(Processes(out / "log"))
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        self._clients: dict[str, Any] = {}
        self._known: dict[tuple[str, int], int] = {}
        self._read = self._sampled = 0
        self.grown = math.inf  # since when the map is [s]
        stack.enter_context(self._client())
        for program in ("slam", "sorter", "viewer"):
            self.start(program)

    @contextlib.contextmanager
    def _client(self) -> Iterator[None]:
        # Its /dev/shm is no other program's.
        os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4"
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("soak")
        del os.environ["FASTDDS_BUILTIN_TRANSPORTS"]
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._clocks = self._node.create_publisher(Clock, "/clock", 10)
        self._ticked = time.monotonic()
        try:
            yield
        finally:
            self._node.destroy_node()
            rclpy.try_shutdown()

    # --- Programs ---------------------------------------------------------------------------------

    def start(self, program: str) -> None:
        serving = ["-p", "serve:=true", "-p", "order_source:=sidecar"]
        command, arguments, end = {
            "slam": (
                [sys.executable, str(HERE / "soak_slam.py"), str(self.size), str(self._trace)],
                [], "here",
            ),
            "sorter": (node_command("rosplat_sorter", "sorter"), [], "there"),
            "viewer": (node_command("rviz_gaussian_plugin", "viewer"), serving, "there"),
            "joiner": (
                node_command("rviz_gaussian_plugin", "viewer"),
                [*serving, "-r", "/gaussians/render:=/joiner/render"], "there",
            ),
        }[program]  # fmt: skip
        command += ["--ros-args", "-p", "use_sim_time:=true", *arguments]
        self.running[program] = self._processes.start(program, self.machines.at(end, command))

    def kill(self, program: str) -> None:
        process = self.running.pop(program)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        self._processes.forget(process)

    def draws(self, viewer: str) -> bool:
        """Whether a viewer that was started has come so far."""
        return "drawing with" in self._processes.said(viewer)

    # --- What is drawn ----------------------------------------------------------------------------

    def spin(self, seconds: float, until: Any = lambda: False) -> bool:
        """Lets time go by; whether something came to hold."""
        deadline = time.monotonic() + seconds
        while not until():
            now = time.monotonic()
            if now > deadline:
                return False
            self._executor.spin_once(min(0.02, deadline - now))
            self._tick(now)
        return True

    def _tick(self, now: float) -> None:
        self.clock += now - self._ticked
        self._ticked = now
        message = Clock()
        message.clock.sec = int(self.clock)
        message.clock.nanosec = int(1e9 * (self.clock % 1))
        self._clocks.publish(message)
        if now - self._sampled > 1.0:
            self._sampled = now
            self._processes.check()
            for name, process in self.running.items():
                self.found.memory.append((now - self.began, name, _resident(process.pid)))

    def step(self) -> int:
        """The newest that was published."""
        return last_step(self._trace)

    def ask(self, service: str, timeout: float) -> Any:
        """The answer to a request for a picture; None where there is none, or no picture."""
        if service not in self._clients:
            self._clients[service] = self._node.create_client(RenderView, service)
        client = self._clients[service]
        asked = time.monotonic()
        if not self.spin(timeout, client.service_is_ready):
            return None
        request = RenderView.Request(camera=self._truth.camera, order_timeout=ORDER_TIMEOUT)
        answers: list[Any] = []

        def answered() -> bool:
            # Once more: one that came before the new viewer knew this client is lost. Seldom, as a
            # viewer draws all that it was asked for.
            if time.monotonic() - asked > REPEAT * (2 ** len(answers) - 1):
                answers.append(client.call_async(request))
            return any(answer.done() for answer in answers)

        response = None
        if self.spin(timeout, answered):
            response = next(answer.result() for answer in answers if answer.done())
        for answer in answers:
            client.remove_pending_request(answer)
        if response is None:
            return None
        if not response.success:
            return None
        self.found.longest_answer = max(self.found.longest_answer, time.monotonic() - asked)
        self.found.longest_frame = max(self.found.longest_frame, response.draw_time)
        return response

    def is_right(self, response: Any, least: int) -> bool:
        """Whether a picture is as the map was after a step that isn't before `least`."""
        with self._trace.open() as trace:
            trace.seek(self._read)
            for line in iter(trace.readline, ""):
                if not line.endswith("\n"):
                    break
                map_id, revision, step = line.split()
                self._known[map_id, int(revision)] = int(step)
                self._read += len(line)
        step = self._known.get((response.map_id, response.revision))
        if step is not None and step * BATCH > 1.3 * self.size:
            self.grown = min(self.grown, time.monotonic() - self.began)
        if step is None or step < self._truth.step:
            return False
        picture = np.frombuffer(response.color.data, np.float32).reshape(*PICTURE[::-1], 4)
        right = bool(decibels(picture, self._truth.picture(step)) >= RIGHT)  # not NumPy's: no JSON
        self.found.pictures += 1
        self.found.sorted_by[response.order_source] += 1
        self.found.wrong += not right
        self.found.wrong_but_complete += not right and response.map_complete
        return right and step >= least

    def begin(self) -> None:
        """Once there is a scene, which takes its time, and the right picture of it."""
        self.spin(math.inf, self.step)
        self.began = time.monotonic()
        while not ((response := self.ask(Fault.service, 2.0)) and self.is_right(response, 1)):
            assert time.monotonic() - self.began < PATIENCE, "no right picture at all"

    def go_through(self, faults: list[Fault], until: float) -> None:
        """Has one strike after the other, each once at least, up to a part of the time."""
        for number, fault in enumerate(itertools.cycle(faults)):
            if number >= len(faults) and time.monotonic() - self.began > until * self.seconds:
                break
            self.suffer(fault)

    def suffer(self, fault: Fault) -> None:
        """Has a fault strike, and measures how long it takes to recover."""
        fault.strike(self)
        struck = time.monotonic()
        while (left := struck + self.hold - time.monotonic()) > 0:
            if response := self.ask(fault.service, left):
                self.is_right(response, 0)
        fault.mend(self)
        self.spin(math.inf, lambda: fault.is_mended(self))
        # From now on it is up to this project.
        mended, least, right = time.monotonic(), self.step(), False
        while not right and time.monotonic() < mended + PATIENCE:
            response = self.ask(fault.service, max(2.0, 2 * self.found.longest_answer))
            seconds = time.monotonic() - mended
            right = response is not None and self.is_right(response, least)
        fault.leave(self)
        self.found.faults.append({"fault": str(fault), "right": right, "seconds": seconds})
        say(
            f"{mended - self.began:7.1f} s: {fault}: "
            + (f"right after {seconds:.1f} s" if right else "WRONG")
        )


def _resident(process: int) -> int:
    with contextlib.suppress(OSError, IndexError):
        return 4096 * int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return 0


# --- Faults ---------------------------------------------------------------------------------------


class Fault:
    """Something goes wrong, and is mended by somebody else."""

    service = "gaussians/render"  # that must have the right picture then
    needs_machines = False
    ends = False  # a program

    def strike(self, soak: Soak) -> None: ...
    def mend(self, soak: Soak) -> None: ...
    def leave(self, soak: Soak) -> None: ...

    def is_mended(self, soak: Soak) -> bool:
        return True

    def __str__(self) -> str:
        return type(self).__name__.lower()


@dataclass
class Killed(Fault):
    program: str
    ends = True

    def strike(self, soak: Soak) -> None:
        soak.kill(self.program)
        self._step = soak.step()

    def mend(self, soak: Soak) -> None:
        soak.start(self.program)

    def is_mended(self, soak: Soak) -> bool:
        """Once it is up again."""
        if self.program == "slam":
            return soak.step() > self._step
        return self.program == "sorter" or soak.draws(self.program)

    def __str__(self) -> str:
        return f"{self.program} killed"


@dataclass
class Stopped(Fault):
    program: str

    def strike(self, soak: Soak) -> None:
        os.killpg(soak.running[self.program].pid, signal.SIGSTOP)

    def mend(self, soak: Soak) -> None:
        os.killpg(soak.running[self.program].pid, signal.SIGCONT)

    def __str__(self) -> str:
        return f"{self.program} stopped"


class Cut(Fault):
    """The line between the machines."""

    needs_machines = True

    def strike(self, soak: Soak) -> None:
        soak.machines.connect(False)

    def mend(self, soak: Soak) -> None:
        soak.machines.connect(True)


class Full(Fault):
    """/dev/shm, while the sorter has to begin with new segments."""

    needs_machines = True
    ends = True

    def strike(self, soak: Soak) -> None:
        self._file = soak.machines.memory("there") / "full"
        with contextlib.suppress(OSError), self._file.open("wb", buffering=0) as file:
            while True:
                file.write(bytes(1 << 20))
        soak.kill("sorter")
        soak.start("sorter")

    def mend(self, soak: Soak) -> None:
        """It stays full: what must not matter."""

    def leave(self, soak: Soak) -> None:
        self._file.unlink()

    def __str__(self) -> str:
        return "/dev/shm full"


class Jump(Fault):
    def strike(self, soak: Soak) -> None:
        soak.clock -= CLOCK_JUMP

    def __str__(self) -> str:
        return "clock back"


class Joins(Fault):
    """No fault at all: a viewer begins late."""

    service = "joiner/render"

    def mend(self, soak: Soak) -> None:
        soak.start("joiner")

    def is_mended(self, soak: Soak) -> bool:
        return soak.draws("joiner")

    def leave(self, soak: Soak) -> None:
        soak.kill("joiner")

    def __str__(self) -> str:
        return "viewer joins"


FAULTS: tuple[Fault, ...] = (
    Killed("sorter"), Stopped("slam"), Joins(), Cut(), Stopped("sorter"), Killed("slam"), Jump(),
    Stopped("viewer"), Full(), Killed("viewer"),
)  # fmt: skip


def soak(minutes: float, out: Path) -> Found:
    """Goes through the faults until time is over, at least once; writes out/soak.json."""
    out.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as stack:
        run = Soak(minutes, out, stack)
        if run.machines.missing:
            say(f"SKIPPED: network cut, /dev/shm full: {run.machines.missing}")
        faults = [f for f in FAULTS if not (f.needs_machines and run.machines.missing)]
        try:
            run.begin()
            # Memory shows in programs that live on.
            run.go_through([fault for fault in faults if not fault.ends], LASTING)
            run.found.lasted = time.monotonic() - run.began
            run.go_through([fault for fault in faults if fault.ends], 1.0)
        finally:
            write(run, minutes, out / "soak.json")
    return run.found


def write(run: Soak, minutes: float, path: Path) -> None:
    """The report: memory of each program in a few hundred samples, and everything else."""
    found = run.found
    every = max(1, len(found.memory) // 2000)
    report = vars(found) | {
        "memory": [(round(t, 1), name, size) for t, name, size in found.memory[::every]],
        "minutes": minutes,
        "splats": run.size,
        "grown": run.grown if run.grown < math.inf else None,
        "steps": run.step(),
        "skipped": run.machines.missing,
        "machine": machine(),
    }
    path.write_text(json.dumps(report, indent=1))
    for program in ("slam", "sorter", "viewer"):
        held = [size / 1e6 for t, name, size in found.memory
                if name == program and run.grown < t < found.lasted]  # fmt: skip
        if held:
            say(f"{program}: {held[0]:.0f} MB once the map had grown, {held[-1]:.0f} at last")
    say(
        f"{found.pictures} pictures, {found.wrong} wrong, {found.wrong_but_complete} of them "
        f"called complete; longest frame {found.longest_frame:.2f} s, longest answer "
        f"{found.longest_answer:.2f} s: {path}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--out", type=Path, default=Path("out/soak"))
    options = parser.parse_args()
    interrupt_by_signals()
    found = soak(options.minutes, options.out)
    sys.exit(found.wrong_but_complete > 0 or not all(fault["right"] for fault in found.faults))


if __name__ == "__main__":
    main()
