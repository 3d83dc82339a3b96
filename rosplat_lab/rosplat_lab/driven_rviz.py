"""rviz2 by remote control, for tests and benchmarks: see driven_rviz.cpp."""

from __future__ import annotations

import json
import os
import socket
import time
from pathlib import Path
from typing import Any

from rosplat_ros.program.processes import ProcessError, Processes, node_command

NAME = "rviz2"  # of its log
PATIENCE = 60.0  # longest wait for an answer of rviz2 [s]


class Refused(RuntimeError):
    """rviz could not do what it was asked for."""


def is_here() -> bool:
    """Whether there is an rviz2 to drive."""
    try:
        (program,) = node_command("rosplat_lab", "driven_rviz")
    except (ImportError, ProcessError):
        return False
    return Path(program).exists()


class DrivenRviz:
    """A running rviz2; `load` gives it a configuration."""

    def __init__(
        self, processes: Processes, config: str, *arguments: str, **environment: str
    ) -> None:
        """Starts it with the text of an .rviz file, and waits until it can be driven.

        Raises ProcessError where it ends instead, or can't be driven.
        """
        self.processes = processes
        self.folder = processes.folder
        address = f"/tmp/rosplat_rviz_{os.getpid()}_{time.monotonic_ns()}"
        file = self.folder / "start.rviz"
        file.write_text(config)
        self.process = processes.start(
            NAME,
            node_command("rosplat_lab", "driven_rviz", "-d", str(file), *arguments),
            ROSPLAT_RVIZ_SOCKET=address,
            **environment,
        )
        self._connection = self._connect(address)

    def _connect(self, address: str) -> Any:
        deadline = time.monotonic() + PATIENCE
        while True:
            connection = socket.socket(socket.AF_UNIX)
            try:
                connection.connect(address)
            except OSError as error:
                connection.close()
                self.processes.check()
                if time.monotonic() > deadline:
                    last = self.processes.last_line(NAME)
                    raise ProcessError(f"{NAME} can't be driven: {error}: {last}") from error
                time.sleep(0.03)
            else:
                connection.settimeout(PATIENCE)
                return connection.makefile("rw")

    def quit(self) -> int:
        """Closes rviz2's window, and returns its exit code."""
        self.ask("quit")
        self._connection.close()
        code = self.process.wait(PATIENCE)
        self.processes.forget(self.process)  # not before it ended: its screen would go first
        return code

    def ask(self, what: str, **request: object) -> Any:
        """The answer to a request; see driven_rviz.cpp. Raises Refused."""
        try:
            self._connection.write(json.dumps({"do": what} | request) + "\n")
            self._connection.flush()
            line = self._connection.readline()
        except OSError:
            line = ""
        if not line:
            raise Refused(f"rviz2 ended at {what!r}: {self.processes.said(NAME)[-500:]}")
        reply = json.loads(line)
        if "error" in reply:
            raise Refused(f"{what!r}: {reply['error']}")
        return reply["result"]

    def load(self, config: str) -> None:
        """Loads a configuration, in place of all that there was."""
        file = self.folder / "loaded.rviz"
        file.write_text(config)
        self.ask("load", file=str(file))
        places = None
        while places != (places := self.ask("places")):  # until the window's layout rests
            time.sleep(0.2)

    def save(self, file: Path) -> None:
        """Saves the configuration."""
        self.ask("save", file=str(file))

    def set(self, *path: str, value: object, root: str = "displays") -> None:
        """Sets a property of a display (or of the view) as typing it would."""
        self.ask("set", path=path, value=value, root=root)

    def properties(self, *path: str, root: str = "displays") -> dict[str, Any]:
        """The values below a property, but for its status, by names joined by slashes."""
        found: dict[str, Any] = {}

        def collect(property: dict[str, Any], prefix: str) -> None:
            for child in property["children"]:
                if child["name"].startswith("Status"):
                    continue
                name = f"{prefix}{child['name']}"
                found[name] = child["value"]
                collect(child, f"{name}/")

        collect(self.ask("tree", path=path, root=root), "")
        return found

    def status_line(self) -> str:
        """What the tool or the view says in the window's status line, as HTML."""
        line: str = self.ask("status line")
        return line

    def status(self, *path: str) -> dict[str, tuple[str, str]]:
        """Level (Ok, Warn, Error) and text of each entry of a display's Status."""
        tree = self.ask("tree", path=path, root="displays")
        return {
            entry["name"]: (entry["level"], entry["value"])
            for child in tree["children"]
            if child["name"].startswith("Status")
            for entry in child["children"]
        }

    def complaints(self) -> list[str]:
        """What a user would see in yellow or red: each entry of a Status that isn't Ok, rviz's own
        Global Status too, and each display that rviz could not load. Disabled displays have none.
        """
        found: list[str] = []

        def visit(property: dict[str, Any], path: str) -> None:
            if not property["children"] and property.get("level", "Ok") != "Ok":
                found.append(f"{path}: {property['value']}")
            for child in property["children"]:
                visit(child, f"{path}, {child['name']}")

        for display in self.ask("tree", path=[], root="displays")["children"]:
            if display["value"] is False:
                continue
            if display["children"]:
                visit(display, display["name"])
            else:
                found.append(f"{display['name']}: rviz could not load it")
        return found
