"""The X display that Xvfb makes."""

import os
from pathlib import Path

import pytest

from rviz_gaussian_plugin.offscreen import ensure_display

# Says that it is up; its socket is there from its second start on.
STUB = """#!/bin/sh
if [ -e "$0.started" ]; then mkdir -p /tmp/.X11-unix; touch "/tmp/.X11-unix/X$$"; fi
touch "$0.started"
echo $$ >"/proc/$$/fd/$2"
exec sleep 60
"""


def test_a_display_without_a_socket_is_made_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An Xvfb that ends takes the socket of one that just starts with its number along."""
    stub = tmp_path / "Xvfb"
    stub.write_text(STUB)
    stub.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.delenv("DISPLAY", raising=False)
    with ensure_display() as name:
        socket = Path(f"/tmp/.X11-unix/X{name.removeprefix(':')}")
        assert socket.exists()
        socket.unlink()
