"""The laboratory end to end, on a small scene: the real renderers, the report in a browser."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from html import unescape
from pathlib import Path
from urllib.parse import quote

import pytest

from rosplat_lab.bench.command import SUBJECTS
from rosplat_lab.bench.records import load
from rosplat_lab.lab import pages
from rosplat_lab.lab.points import Point, frontier, points
from rosplat_lab.lab.ways import DEFAULT, MODEL
from rosplat_testing import PATIENCE

DOCS = Path(__file__).resolve().parents[1] / "docs"
MOST_COMMITS = 80  # to the engine since a record of it was made
LAB = [sys.executable, "-m", "rosplat_lab.lab"]
BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a quick run of the chart wrote, its documents in `docs`."""
    folder = tmp_path_factory.mktemp("lab")
    run = subprocess.run(
        [*LAB, "procedural:20000", "--quick", "--part", "chart", "--out", str(folder),
         "--docs", str(folder / "docs")],
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    return folder


@pytest.fixture(scope="module")
def found(folder: Path) -> dict[str, Point]:
    """The points of that run, by setting."""
    return {point.setting: point for point in points(load([folder / "lab.json"]))}


def test_every_way_is_as_exact_as_it_should_be(found: dict[str, Point]) -> None:
    """The renderers are as good as their arithmetic, and each loss is seen for what it is."""
    psnr = {setting: point.psnr for setting, point in found.items()}
    assert psnr[DEFAULT] > 75
    assert psnr[DEFAULT] == pytest.approx(psnr["Order Source: Sidecar"], abs=3)
    assert 55 < psnr["the defaults, in a window of 8 bits"] < 66
    late = [f"Order Source: Sidecar, {ms} ms late at 30 deg/s" for ms in (33, 100, 300)]
    assert psnr[DEFAULT] > psnr[late[0]] > psnr[late[1]] > psnr[late[2]]
    assert psnr["sort keys: 16 bits"] > psnr["sort keys: 12 bits"] > psnr["sort keys: distance"]
    assert psnr["SH Degree: 2"] > psnr["SH Degree: 1"]
    assert psnr["Detail: 2 px"] > psnr["Detail: 4 px"] > psnr["Detail: 16 px"]
    assert psnr["compression: quantised"] > 60
    assert psnr["simplify SPLATS=10k"] > psnr["simplify SPLATS=5k"] > 20
    assert 15 < psnr["RVizSplat 1.0.0"] < 45


def test_what_a_user_can_choose_has_a_time_and_a_model_has_none(found: dict[str, Point]) -> None:
    for point in found.values():
        assert (point.ms is None) == (point.aside == MODEL), point.setting
    assert found["Detail: 16 px"].drawn < found[DEFAULT].drawn
    assert not any(point.aside for point in frontier(found.values()))


def test_documents_are_made_of_the_records_that_are_kept(
    folder: Path, found: dict[str, Point], tmp_path: Path
) -> None:
    page = (folder / "docs/accuracy.md").read_text()
    assert all(point.setting in page for point in frontier(found.values()))
    assert (folder / "docs/accuracy.png").stat().st_size < 300_000
    kept = tmp_path / "docs" / pages.KEPT
    kept.mkdir(parents=True)
    shutil.copy(folder / "lab.json", kept / "processor.json")
    drawn = [*LAB, "--part", "pages", "--out", str(tmp_path), "--docs", str(tmp_path / "docs")]
    subprocess.run(drawn, check=True, timeout=300)
    assert (tmp_path / "docs/accuracy.md").read_text() == page


def test_the_report_answers_in_a_browser(
    folder: Path, found: dict[str, Point], tmp_path: Path
) -> None:
    """Searched for a word, asked for an error, and with a setting's pictures."""
    if not BROWSER:
        pytest.skip("no chromium and no chrome")
    page = folder / "lab.html"
    assert "http-equiv" not in page.read_text() and 'src="http' not in page.read_text()
    best = next(p for p in frontier(found.values()) if p.psnr >= 30)
    shown = f"find=simplify&db=30&show={quote('Detail: 4 px')}"
    run = subprocess.run(
        [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom",
         f"--user-data-dir={tmp_path}", f"file://{page}#{shown}"],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    document = unescape(run.stdout)
    rows = re.findall(r"<tr[^>]*><td>([^<]*)</td>", document)
    assert rows and all("simplify" in row for row in rows)
    assert f"For 30 dB, the fastest: {best.setting} (" in document
    assert document.count("<circle") == len(found)
    assert "Detail: 4 px: " in document
    assert 'background-image: url("data:image/webp' in document


def test_an_interrupted_run_ends_at_once_and_quietly(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [*LAB, "procedural:300000", "--part", "chart", "--out", str(tmp_path)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env={name: value for name, value in os.environ.items() if name != "DISPLAY"},
    )  # fmt: skip
    with pytest.raises(subprocess.TimeoutExpired):
        process.communicate(timeout=6)  # workers draw references
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert "Traceback" not in said


def test_a_scene_that_is_not_there_is_named(tmp_path: Path) -> None:
    run = subprocess.run(
        [*LAB, "nowhere.ply", "--out", str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert run.returncode == 1
    assert run.stderr == "lab: nowhere.ply: No such file or directory\n"


def test_every_record_of_the_documents_can_be_measured_anew() -> None:
    """By a subject of bench, or by the laboratory."""
    for path in (DOCS / "results").rglob("*.json"):
        assert {record.subject for record in load([path])} <= {*SUBJECTS, "lab", "atlas"}, path


def test_records_name_a_commit_before_this_one_and_pages_name_it() -> None:
    """Whether the code that was measured has changed since, a reader can then ask git."""
    run = subprocess.run(
        ["git", "rev-parse", "--is-shallow-repository"], cwd=DOCS, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    if run.stdout.strip() != "false":
        pytest.skip("not in a whole clone")
    files = sorted((DOCS / pages.KEPT).glob("*.json"))
    assert files
    for path in files:
        commits = list(dict.fromkeys(record.commit for record in load([path])))
        for commit in commits:
            old = ["git", "merge-base", "--is-ancestor", commit, "HEAD"]
            assert subprocess.run(old, cwd=DOCS, check=False).returncode == 0, f"{path}: {commit}"
        if path.stem.startswith("processor"):  # which any machine can measure anew
            since = ["git", "rev-list", "--count", f"{commits[0]}..HEAD", "--", "rosplat_core"]
            count = subprocess.run(
                since, cwd=DOCS.parent, capture_output=True, text=True, check=True
            )
            assert int(count.stdout) <= MOST_COMMITS, f"{path} is old: make lab DOCS=docs"
        page = "stability.md" if path.stem.endswith("-atlas") else "accuracy.md"
        _, _, made = (DOCS / page).read_text().partition(pages.MADE)
        assert f"commit {', '.join(commits)}," in made
