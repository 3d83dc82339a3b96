"""Two emulated machines (network, /dev/shm, displays) and a line of known speed between them.

Network namespaces of Linux; nothing outside them changes. Knows no ROS.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import uuid
from collections.abc import Sequence
from pathlib import Path

ENDS = ("here", "there")
TOOLS = ("ip", "tc")
BURST = "256kb"  # most that leaves at once; more than a datagram of 64 KiB
LATENCY = "100ms"  # longest that packets queue before they are dropped, as in a switch
SOCKETS = "/tmp/.X11-unix"  # of X servers, by the numbers of their displays


class NoLine(Exception):
    """Namespaces can't be made; the text says why."""


class Line:
    """Exists while the `with` block runs; programs inside should end before it does."""

    def __init__(self, rate: str) -> None:
        """rate: as tc writes it, such as "1gbit"."""
        self._rate = rate
        name = f"rosplat{uuid.uuid4().hex[:6]}"
        self._names = {end: f"{name}{number}" for number, end in enumerate(ENDS)}

    def __enter__(self) -> Line:
        """Raises NoLine."""
        missing = [tool for tool in TOOLS if not shutil.which(tool)]
        if missing:
            raise NoLine(f"no {' and no '.join(missing)}: install iproute2")
        if os.geteuid():
            raise NoLine("only root may make network namespaces")
        try:
            self._make()
        except subprocess.CalledProcessError as error:
            self._remove()
            raise NoLine(f"{' '.join(error.cmd)}: {error.stderr.decode().strip()}") from error
        return self

    def _make(self) -> None:
        here, there = (self._names[end] for end in ENDS)
        for name in (here, there):
            _run("ip", "netns", "add", name)
            _memory(name).mkdir()
        # The two ends of the cable have the names of their machines.
        _run("ip", "link", "add", here, "netns", here, "type", "veth",
             "peer", "name", there, "netns", there)  # fmt: skip
        for number, name in enumerate((here, there)):
            inside = ("ip", "-netns", name)
            _run(*inside, "link", "set", "lo", "up")
            _run(*inside, "address", "add", f"10.213.74.{number + 1}/24", "dev", name)
            _run(*inside, "link", "set", name, "up")
            self._route(name)
            _run("tc", "-netns", name, "qdisc", "add", "dev", name, "root", "tbf",
                 "rate", self._rate, "burst", BURST, "latency", LATENCY)  # fmt: skip

    def __exit__(self, *_: object) -> None:
        self._remove()

    def _remove(self) -> None:
        for name in self._names.values():
            subprocess.run(["ip", "netns", "delete", name], capture_output=True, check=False)
            shutil.rmtree(_memory(name), ignore_errors=True)

    def at(self, end: str, command: Sequence[str]) -> list[str]:
        """The command that runs a command at one of ENDS, which has a /dev/shm of its own.

        It has no X display yet, but SOCKETS of its own: an Xvfb in a network namespace would take a
        number in use outside of the namespace, and the socket of the server there.
        """
        name = self._names[end]
        own = (
            f"mount --bind {_memory(name)} /dev/shm && mkdir -p {SOCKETS} "
            f'&& mount -t tmpfs -o mode=1777 tmpfs {SOCKETS} && exec env -u DISPLAY "$@"'
        )
        return ["ip", "netns", "exec", name, "sh", "-c", own, "sh", *command]

    def connect(self, connected: bool) -> None:
        """Pulls the cable out, or puts it in again."""
        name = self._names["here"]
        _run("ip", "-netns", name, "link", "set", name, "up" if connected else "down")
        if connected:
            self._route(name)

    def _route(self, name: str) -> None:
        """Adds the multicast route by which DDS looks for others."""
        _run("ip", "-netns", name, "route", "add", "224.0.0.0/4", "dev", name)

    def namespace(self, end: str) -> str:
        """Name of the network namespace of one of ENDS."""
        return self._names[end]

    def memory(self, end: str) -> Path:
        """The folder that is /dev/shm at one of ENDS."""
        return _memory(self._names[end])

    def received(self, end: str) -> int:
        """Bytes that have come over the line to one of ENDS."""
        path = f"/sys/class/net/{self._names[end]}/statistics/rx_bytes"
        return int(_run("ip", "netns", "exec", self._names[end], "cat", path))


def _memory(name: str) -> Path:
    """The folder that is /dev/shm on that machine."""
    return Path("/dev/shm") / name


def _run(*command: str) -> bytes:
    return subprocess.run(command, capture_output=True, check=True).stdout
