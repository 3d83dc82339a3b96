"""The report of `render`, where pictures are equal and where there is no git."""

import json
import math
from pathlib import Path

import pytest

from rosplat_lab.metrics import MOST_PSNR
from rosplat_lab.render.command import write_report


def test_a_report_is_json_for_whoever_reads_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")  # without git
    monkeypatch.setenv("ROSPLAT_COMMIT", "abc")
    rows: list[dict[str, object]] = [{"camera": 3}, {"camera": 4, "psnr": math.inf}]
    write_report(tmp_path / "report.json", {"via": "host"}, rows)
    report = json.loads((tmp_path / "report.json").read_text(), parse_constant=pytest.fail)
    assert (report["via"], report["commit"]) == ("host", "abc")
    assert report["cameras"] == [{"camera": 3}, {"camera": 4, "psnr": MOST_PSNR}]
