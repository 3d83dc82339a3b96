"""rviz2 by remote control."""

import sys
from pathlib import Path

import pytest

from rosplat_lab.driven_rviz import DrivenRviz
from rosplat_ros.program.processes import ProcessError, Processes

SLEEP = [sys.executable, "-c", "import time; time.sleep(600)"]


def test_an_rviz2_that_does_not_listen_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rosplat_lab.driven_rviz.node_command", lambda *_: SLEEP)
    monkeypatch.setattr("rosplat_lab.driven_rviz.PATIENCE", 0.1)
    with (
        Processes(tmp_path) as processes,
        pytest.raises(ProcessError, match="rviz2 can't be driven"),
    ):
        DrivenRviz(processes, "")
