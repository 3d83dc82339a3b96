"""Programs beside each other: none outlives the block that started it."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from rosplat_ros.program.middleware import FAST_DDS_WISHES, fast_dds_profile, prepare_fast_dds
from rosplat_ros.program.processes import ProcessError, Processes, run_module
from rosplat_testing import PATIENCE

SLEEP = ["sh", "-c", "echo awake; exec sleep 600"]
# Ignores the signal of Ctrl-C, and has a child.
STUBBORN = ["sh", "-c", "trap '' INT; sleep 600 & echo $!; wait"]


def wait(until: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not until():
        assert time.monotonic() < deadline, "timed out"
        time.sleep(0.02)


def said(processes: Processes, name: str) -> str:
    wait(lambda: processes.said(name).endswith("\n"))
    return processes.said(name)


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_fast_dds_is_made_fit_for_maps_unless_somebody_sees_to_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    names = []
    for distro in ("jazzy", "kilted"):
        settings = fast_dds_profile({"ROS_DISTRO": distro, "ROS_LOCALHOST_ONLY": ""})
        ((name, path),) = settings.items()
        assert "<segment_size>33554432</segment_size>" in Path(path).read_text()
        names.append(name)
    assert names == ["FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"]
    for name in (*names, "FASTDDS_BUILTIN_TRANSPORTS", "ROS_LOCALHOST_ONLY"):
        assert not fast_dds_profile({name: "1"})
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=64 << 20))
    assert not fast_dds_profile({})


def test_programs_see_to_fast_dds_by_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in FAST_DDS_WISHES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("os.environ", dict(os.environ))
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=2 << 30))

    def profile() -> str:
        return next((os.environ[name] for name in FAST_DDS_WISHES if name in os.environ), "")

    prepare_fast_dds(sends_maps=False)
    assert profile().endswith("config/fastdds_small.xml")
    os.environ.update(dict.fromkeys(FAST_DDS_WISHES[1:3], "/a/user's.xml"))
    prepare_fast_dds()
    assert profile() == "/a/user's.xml"


def test_leaving_the_block_ends_all_even_by_an_error(tmp_path: Path) -> None:
    with pytest.raises(KeyError), Processes(tmp_path / "log") as processes:
        started = [processes.start(name, SLEEP) for name in ("one", "two")]
        assert said(processes, "one") == "awake\n"
        raise KeyError
    assert all(process.returncode is not None for process in started)


def test_what_ignores_the_signal_is_ended_by_force_with_its_children(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rosplat_ros.program.processes.GRACE", 0.3)
    with Processes(tmp_path) as processes:
        process = processes.start("stubborn", STUBBORN)
        child = int(said(processes, "stubborn"))
        assert is_alive(child)
    assert process.returncode == -signal.SIGKILL
    wait(lambda: not is_alive(child))


def test_a_program_that_ends_early_is_named_with_its_last_words(tmp_path: Path) -> None:
    with Processes(tmp_path) as processes:
        failing = processes.start("failing", [sys.executable, "-c", "print('hm'); exit('no file')"])
        failing.wait(PATIENCE)
        with pytest.raises(ProcessError, match="failing ended with code 1: no file"):
            processes.check()


def test_what_a_node_warned_of_is_told_without_the_rest_of_its_log(tmp_path: Path) -> None:
    warn = "import rclpy.logging as l; n = l.get_logger('a.b'); n.info('one'); n.warning('[2]: x')"
    with Processes(tmp_path) as processes:
        processes.start("node", [sys.executable, "-c", warn]).wait(PATIENCE)
        assert processes.warnings("node") == ["[2]: x"]


def test_what_is_not_there_can_t_be_started(tmp_path: Path) -> None:
    with Processes(tmp_path) as processes:
        with pytest.raises(ProcessError, match="ghost can't be started"):
            processes.start("ghost", ["/nowhere/ghost"])
        with pytest.raises(ProcessError, match="no_such_package is not installed"):
            processes.node("no_such_package", "node")
    with pytest.raises(ProcessError, match="null"), Processes(Path("/dev/null/log")):
        pass


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_nothing_behind(tmp_path: Path, number: signal.Signals) -> None:
    program = (
        "import sys, time; from pathlib import Path\n"
        "from rosplat_ros.program.processes import Processes, interrupt_by_signals\n"
        "interrupt_by_signals()\n"
        "with Processes(Path(sys.argv[1])) as processes:\n"
        "    print(processes.start('sleep', sys.argv[2:]).pid, flush=True); time.sleep(600)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path), *SLEEP],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        assert process.stdout
        child = int(process.stdout.readline())
        assert is_alive(child)
        os.kill(process.pid, number)
        process.wait(PATIENCE)
    assert not is_alive(child)


def test_a_killed_program_leaves_none_of_those_it_started(tmp_path: Path) -> None:
    program = (
        "import sys; from pathlib import Path\n"
        "from rosplat_ros.program.processes import Processes\n"
        "with Processes(Path(sys.argv[1])) as processes:\n"
        "    child = processes.start('sleep', sys.argv[2:])\n"
        "    print(child.pid, flush=True); child.wait()\n"
    )
    command = [sys.executable, "-c", program, str(tmp_path), *SLEEP]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        child = int(process.stdout.readline())
        assert is_alive(child)
        process.kill()
    wait(lambda: not is_alive(child))


def test_a_signal_that_no_system_call_heard_of_interrupts_all_the_same() -> None:
    """As one does that lands just before the call: here it lands in another thread."""
    program = (
        "import signal, threading, time\n"
        "from rosplat_ros.program.processes import interrupt_by_signals\n"
        "interrupt_by_signals()\n"
        "def aside():\n"
        "    time.sleep(0.2)\n"
        "    signal.pthread_kill(threading.get_ident(), signal.SIGTERM)\n"
        "threading.Thread(target=aside).start()\n"
        "try: time.sleep(600)\n"
        "except KeyboardInterrupt: print('interrupted')\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=True,
    )
    assert run.stdout == "interrupted\n"


INTERRUPTED = "import os, signal; os.kill(os.getpid(), signal.SIGINT); x = [1] * 1000; "


@pytest.mark.parametrize(
    "module", [INTERRUPTED, f"try: {INTERRUPTED}\nexcept BaseException: raise ImportError('of C')"]
)
def test_an_interrupt_while_a_command_loads_is_quiet(tmp_path: Path, module: str) -> None:
    (tmp_path / "loading.py").write_text(module + "\ndef main(): print('ran')")
    program = (
        "import sys; from rosplat_ros.program.processes import run_module; "
        "sys.exit(run_module('program', 'loading'))"
    )
    run = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "")


def test_programs_begin_with_nothing_that_takes_long_to_load() -> None:
    """Before run_module has made an interrupt quiet."""
    code = "import sys, rosplat_tools.commands; assert not {'numpy', 'rclpy'} & sys.modules.keys()"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=PATIENCE)


def test_a_library_that_a_command_lacks_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    assert run_module("lab", "rosplat_tools.no_such.command", None) == 1
    assert capsys.readouterr().err == "lab: No module named 'rosplat_tools.no_such'\n"


ENDS = """
import os, signal, sys, time
from types import SimpleNamespace
from rosplat_ros.program import processes
def again():
    for number in (signal.SIGINT, signal.SIGTERM) * 3:
        os.kill(os.getpid(), number)
        time.sleep(0.01)
def main():
    try:
        time.sleep(600)
    finally:
        again()
class AtTheEnd:
    def __del__(self):
        again()
last = AtTheEnd()
processes.importlib = SimpleNamespace(import_module=lambda name: SimpleNamespace(main=main))
print("begun", flush=True)
code = processes.run_module("program", "module")
again()
print("ended")
sys.exit(code)
"""


def test_signals_that_follow_the_first_hold_up_no_cleaning_up() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", ENDS], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout
        assert process.stdout.readline() == "begun\n"
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=PATIENCE)
    assert (process.returncode, output) == (130, "ended\n")
