"""Programs that run beside each other and end together, for demos, pictures and benchmarks."""

from __future__ import annotations

import ctypes
import importlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from rosplat_core.program.output import finish
from rosplat_ros.program.loading import exit_by_signals
from rosplat_ros.program.middleware import fast_dds_profile

ENDINGS = (signal.SIGINT, signal.SIGTERM)
GRACE = 5.0  # what a program gets to end by itself [s]
ENDS = 3.0  # for so long after a signal, a program that ends by it heeds no other [s]


class ProcessError(RuntimeError):
    """A program that could not be started or ended early; the text says which, and why."""


def quoted(text: object) -> str:
    """Text as the value of a parameter, `-p name:=value`: unquoted, ROS reads it as YAML."""
    return "'" + str(text).replace("'", "''") + "'"


_interrupted_at: float | None = None  # of time.monotonic()


def interrupt_by_signals() -> None:
    """Makes SIGTERM end this program as Ctrl-C does: by KeyboardInterrupt, block by block.

    The exception comes at once, wherever the main thread waits: see _Waker. Signals that follow
    within ENDS are ignored: a terminal and ros2 launch both send one, and cleaning up goes on.
    """
    global _interrupted_at
    _interrupted_at = None
    for number in ENDINGS:
        signal.signal(number, _interrupt)
    if _Waker.running is None:
        _Waker.running = _Waker()


class _Waker:
    """Wakes the main thread for a signal that lands just before that thread begins to wait.

    Python runs handlers in the main thread, between two steps of a program. A system call that has
    begun by then, or that another thread's signal doesn't interrupt, goes on to its end first. So
    each signal wakes a thread, which interrupts the main thread until its handlers have run.
    """

    running: _Waker | None = None
    _POKE = signal.SIGURG  # nobody else sends it, and programs that are started ignore it
    _PERIOD = 0.02  # [s]

    def __init__(self) -> None:
        self._main = threading.get_ident()
        self._heard = False
        self._signals, writing = os.pipe()
        os.set_blocking(writing, False)
        signal.signal(self._POKE, self._on_poke)
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        os.register_at_fork(after_in_child=lambda: signal.set_wakeup_fd(-1))  # the pipe is ours
        threading.Thread(target=self._watch, name="signals", daemon=True).start()

    def _on_poke(self, _number: int, _frame: FrameType | None) -> None:
        self._heard = True

    def _watch(self) -> None:
        while numbers := os.read(self._signals, 64):
            self._heard = not set(numbers) - {self._POKE}
            while not self._heard:
                signal.pthread_kill(self._main, self._POKE)
                time.sleep(self._PERIOD)


_postponed: list[int] | None = None  # signals that came within uninterrupted(); None outside it


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Postpones the interrupts of signals until the block has ended."""
    global _postponed
    came: list[int] = []
    _postponed = came
    try:
        yield
    finally:
        _postponed = None
    for number in came:
        _interrupt(number, None)


def _interrupt(number: int, _frame: FrameType | None) -> None:
    global _interrupted_at
    if _postponed is not None:
        _postponed.append(number)
        return
    if 0.0 < since_interrupt() < ENDS:
        return
    _interrupted_at = _interrupted_at or time.monotonic()
    raise KeyboardInterrupt


def since_interrupt() -> float:
    """How long ago a signal first interrupted this program, 0 where none has. [s]

    An interrupt may show here alone: Python drops what destructors or ends of imports raise.
    """
    return time.monotonic() - _interrupted_at if _interrupted_at else 0.0


def run_module(program: str, module: str, arguments: list[str] | None = None) -> int:
    """Runs the main of a module, a command's or a node's; returns the exit code. Without arguments,
    it takes those of the program, which ends by it.

    An interrupt is quiet even while the module is loaded, which takes seconds. A library, or
    rviz_gaussian_plugin, that is missing is named.
    """
    exit_by_signals()
    try:
        main = importlib.import_module(module).main
        interrupt_by_signals()
        code: int | None = main() if arguments is None else main(arguments)
        return code or 0
    except ModuleNotFoundError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    except Exception:
        if since_interrupt():  # libraries in C turn KeyboardInterrupt into others
            return 130
        raise
    finally:
        if arguments is None:  # no caller goes on; in Python's own end, a signal has a traceback
            for number in ENDINGS:
                signal.signal(number, signal.SIG_IGN)
        finish()


_PR_SET_PDEATHSIG = 1  # of linux/prctl.h
_libc = ctypes.CDLL(None)


def end_with_parent() -> None:
    """Has the kernel end this program when the thread that started it ends, killed or not.

    For subprocess's preexec_fn.
    """
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


class Processes:
    """Starts programs and ends all of them, last started first, when the `with` block is left.

    The programs end with this one, however it ends. For the main thread, where signals arrive.
    """

    def __init__(self, log_folder: Path) -> None:
        """Each program's output goes to log_folder/<name>.log."""
        self.folder = log_folder
        self._running: list[tuple[str, subprocess.Popen[bytes]]] = []

    def __enter__(self) -> Processes:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ProcessError(f"{self.folder}: no folder for logs: {error.strerror}") from error
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def start(
        self, name: str, command: Sequence[str], **environment: str
    ) -> subprocess.Popen[bytes]:
        """Starts a program in a session of its own. Raises ProcessError where it isn't there."""
        with self.log(name).open("wb") as log:
            try:
                process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    # Unbuffered, or a log would lack what a program said last.
                    env=os.environ
                    | {"PYTHONUNBUFFERED": "1"}
                    | fast_dds_profile(os.environ | environment)
                    | environment,
                    start_new_session=True,
                    preexec_fn=end_with_parent,
                )
            except OSError as error:
                raise ProcessError(f"{name} can't be started: {error}") from error
        self._running.append((name, process))
        return process

    def node(
        self, package: str, executable: str, *arguments: str, name: str | None = None
    ) -> subprocess.Popen[bytes]:
        """Starts a node. Raises ProcessError where it isn't there."""
        return self.start(name or executable, node_command(package, executable, *arguments))

    def log(self, name: str) -> Path:
        """Where a program's output goes."""
        return self.folder / f"{name}.log"

    def check(self, but: subprocess.Popen[bytes] | None = None) -> None:
        """Raises ProcessError if a program other than `but` has ended."""
        for name, process in self._running:
            if process is not but and process.poll() is not None:
                raise ProcessError(
                    f"{name} ended with code {process.returncode}: {self.last_line(name)}"
                )

    def forget(self, process: subprocess.Popen[bytes]) -> None:
        """Forgets a program that has ended: check() no longer raises for it."""
        self._running = [entry for entry in self._running if entry[1] is not process]

    def said(self, name: str) -> str:
        """All that a program has said."""
        return self.log(name).read_text(errors="replace")

    def last_line(self, name: str) -> str:
        """What a program said last."""
        lines = self.said(name).strip().splitlines()
        return lines[-1] if lines else f"it said nothing in {self.log(name)}"

    def warnings(self, name: str) -> list[str]:
        """What a node has warned of."""
        return re.findall(r"^\[WARN\] \[[^]]*\] \[[^]]*\]: (.*)$", self.said(name), re.MULTILINE)

    def end(self) -> None:
        """Ends every program: first by the signal of Ctrl-C, then by force."""
        # A second Ctrl-C must not leave half of them behind.
        before = {number: signal.signal(number, signal.SIG_IGN) for number in ENDINGS}
        for _, process in reversed(self._running):
            _signal(process, signal.SIGINT)
        deadline = time.monotonic() + GRACE
        for _, process in reversed(self._running):
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                _signal(process, signal.SIGKILL)
                process.wait()
        self._running.clear()
        for number, handler in before.items():
            signal.signal(number, handler)


def node_command(package: str, executable: str, *arguments: str) -> list[str]:
    """The command that `ros2 run` would start. Raises ProcessError if the package is missing."""
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix

    try:
        program = Path(get_package_prefix(package)) / "lib" / package / executable
    except PackageNotFoundError as error:
        raise ProcessError(f"{package} is not installed: source its workspace") from error
    return [str(program), *arguments]


def _signal(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    # The group: a program may have started others, Xvfb say.
    if process.poll() is None:
        os.killpg(process.pid, number)
