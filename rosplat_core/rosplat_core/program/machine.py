"""The machine that this runs on: processor, GPU, driver, commit, memory of processes."""

from __future__ import annotations

import os
import platform
import subprocess
from pathlib import Path


def machine() -> str:
    """Processor, cores that this process may use, memory and system."""
    cores = len(os.sched_getaffinity(0))
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    return f"{_processor()}, {cores} cores, {memory:.0f} GiB, {platform.platform()}"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "") or platform.machine()


def commit() -> str:
    """The commit of the checkout that this runs in, else $ROSPLAT_COMMIT, else empty."""
    top = _said("git", "rev-parse", "--show-toplevel")
    here = top and (Path(top) / __name__.partition(".")[0]).is_dir()  # not another project's
    return (here and _said("git", "describe", "--always", "--dirty")) or os.environ.get(
        "ROSPLAT_COMMIT", ""
    )


def resident_bytes(pid: int | None = None) -> int:
    """Memory that a process has in RAM, by default this one; 0 when it has ended."""
    return _memory("VmRSS", pid or os.getpid())


def peak_bytes(pid: int) -> int:
    """The most memory that a process has had in RAM; 0 when it has ended."""
    return _memory("VmHWM", pid)


def processor_seconds(pid: int) -> float:
    """Processor time of all threads of a process; 0 when it has ended. [s]"""
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return 0.0
    user, system = text.rpartition(")")[2].split()[11:13]  # of proc(5): after the name
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def _memory(name: str, pid: int) -> int:
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0
    lines = [line for line in status.splitlines() if line.startswith(f"{name}:")]
    return 1024 * int(lines[0].split()[1]) if lines else 0


def nvidia_gpu() -> tuple[str, str]:
    """Name and driver's version of the first NVIDIA GPU, empty where there is none."""
    asked = "--query-gpu=name,driver_version", "--format=csv,noheader", "--id=0"
    name, _, driver = _said("nvidia-smi", *asked).partition(", ")
    return name, driver


def _said(*command: str) -> str:
    try:
        run = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return run.stdout.strip()
