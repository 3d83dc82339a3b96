"""A file is replaced whole, or stays as it was."""

import errno
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from rosplat_core.formats import InputError, check_output
from rosplat_core.program.files import replacing, write_below, write_text


def test_what_is_written_takes_the_file_s_place(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    for text in ("old", "größer"):
        write_text(path, text)
        assert path.read_text(encoding="utf-8") == text
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_an_interrupted_writing_leaves_the_old_file(
    tmp_path: Path, error: type[BaseException]
) -> None:
    path = tmp_path / "a.json"
    write_text(path, "old")
    with pytest.raises(error), replacing(path) as partial:
        partial.write_text("ne")
        raise error
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_killed_program_left_is_removed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.json"
    script = (
        "import os, sys; from pathlib import Path\n"
        "from rosplat_core.program.files import replacing\n"
        "with replacing(Path(sys.argv[1])): os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", script, str(path)], check=False, cwd=tmp_path)
    (left,) = tmp_path.iterdir()
    os.utime(left, (0, 0))
    (tmp_path / ".b.json.x.part").touch()
    os.utime(tmp_path / ".b.json.x.part", (0, 0))
    with replacing(path) as partial:
        os.utime(partial, (0, 0))
        write_text(path, "meanwhile")  # another program's is locked, and stays
        partial.write_text("whole")
    assert path.read_text() == "whole"
    assert {each.name for each in tmp_path.iterdir()} == {"a.json", ".b.json.x.part"}
    assert caplog.text.count("removed; a program was killed") == 1


def test_what_can_t_be_written_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    for raised in (OSError(errno.ENOSPC, "No space left on device"), OSError("encoder error -2")):
        with pytest.raises(OSError, match=r"(No space|error -2).*a\.json'$"), replacing(path):
            raise raised
    with pytest.raises(OSError, match=r"b\.json"), replacing(path):
        (tmp_path / "b.json").read_bytes()
    with pytest.raises(FileNotFoundError, match=r"none/a\.json'$"):
        write_text(tmp_path / "none" / "a.json", "")


def test_what_is_no_file_stays(tmp_path: Path) -> None:
    """A device, say: who may write to its folder could replace it."""
    path = tmp_path / "a.ply"
    os.mkfifo(path)
    with pytest.raises(OSError, match=r"no file.*a\.ply'$"), replacing(path) as partial:
        partial.write_text("new")
    with pytest.raises(InputError, match=r"a\.ply: is no file"):
        check_output(path, overwrite=True)
    assert path.is_fifo()
    assert list(tmp_path.iterdir()) == [path]


def test_nobody_can_lay_a_link_where_it_writes(tmp_path: Path) -> None:
    victim, path = tmp_path / "victim", tmp_path / "a.json"
    victim.write_text("mine")
    for name in (".a.json.part", "a.json.part", "a.json.tmp", "a.json"):
        (tmp_path / name).symlink_to(victim)
    names: list[str] = []
    for _ in range(2):
        with replacing(path) as partial:
            names.append(partial.name)
            partial.write_text("yours")
    assert victim.read_text() == "mine"
    assert (path.is_symlink(), path.read_text()) == (False, "yours")
    assert names[0] != names[1]


def test_a_file_is_for_whom_the_user_s_mask_lets(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    before = os.umask(0o027)
    try:
        write_text(path, "x")
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_what_stands_above_the_mark_stays(tmp_path: Path) -> None:
    path = tmp_path / "a.md"
    write_below(path, "# Title\n", "<!-- made -->\n", "1\n")
    assert path.read_text() == "# Title\n<!-- made -->\n1\n"
    write_text(path, "# Title\nBy hand: größer\n<!-- made -->\n1\n")
    write_below(path, "# Title\n", "<!-- made -->\n", "2\n")
    assert path.read_text(encoding="utf-8") == "# Title\nBy hand: größer\n<!-- made -->\n2\n"
