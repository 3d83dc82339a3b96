"""setup.sh and env.sh in a copy of the checkout, with stand-ins for what installs and builds."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROGRAMS = {
    "dpkg-query": "[ -e present ] && echo install ok installed",
    "id": "echo 1000",
    "sudo": '[ "$1" = -n ] && exit $(cat needs_password); echo "$@" >>as_root',
    "python3": 'case "$*" in *" venv "*) for folder; do :; done; mkdir -p "$folder"/{bin,share}; '
    'cp "$0" "$folder/bin/python"; touch "$folder/bin/activate"; '
    'echo /opt/python/cp3 >"$folder/share/a.cmake" ;; -c*) echo include include ;; esac',
    "colcon": "echo Summary",
}


class Checkout:
    """A folder with the two scripts, and a machine that has the given ROS 2."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in ("setup.sh", "env.sh", "requirements"):
            source = ROOT / name
            (shutil.copytree if source.is_dir() else shutil.copy)(source, folder / name)
        (folder / "programs").mkdir()
        for name, text in PROGRAMS.items():
            program = folder / "programs" / name
            program.write_text(f"#!/bin/bash\n{text}\n")
            program.chmod(0o755)
        (folder / "present").touch()

    def bash(self, command: str, ros: str, **variables: str) -> subprocess.CompletedProcess[str]:
        kept = ("HOME", "LANG", "TMPDIR")
        environment = {name: os.environ[name] for name in kept if name in os.environ}
        environment["PATH"] = f"{self.folder}/programs:/usr/bin:/bin"
        return subprocess.run(
            ["bash", "-c", command],
            cwd=self.folder,
            env=environment | {"ROSPLAT_ROS": ros} | variables,
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
            check=False,
        )

    def setup(self, ros: str, **variables: str) -> subprocess.CompletedProcess[str]:
        return self.bash("./setup.sh", ros, **variables)


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    return Checkout(tmp_path)


def test_each_ros_keeps_its_environment_and_its_build(checkout: Checkout) -> None:
    kept = []
    for ros, sourced in (
        ("wheels", ""),
        ("jazzy", "jazzy"),
        ("kilted-wheels", "jazzy"),
        ("wheels", "kilted"),
    ):
        done = checkout.setup(ros, ROS_DISTRO=sourced)
        assert done.returncode == 0, done.stderr
        folder = checkout.folder / ".ros" / ros
        assert f"build-base: .ros/{ros}/build" in (folder / "colcon.yaml").read_text()
        for name in ("venv", "build", "install", "log"):
            kept.append(folder / name / "mine")
            kept[-1].parent.mkdir(exist_ok=True)
            kept[-1].touch()
        assert all(path.exists() for path in kept)


def test_a_ros_that_is_not_there_is_an_error(checkout: Checkout) -> None:
    for sourced, named in (("", "no ROS 2"), ("humble", "humble")):
        done = checkout.setup("iron", ROS_DISTRO=sourced)
        assert done.returncode == 1
        assert f"asks for iron, and {named} is sourced" in done.stderr
    assert "requirements/ has" in checkout.setup("iron-wheels").stderr
    assert not (checkout.folder / ".ros").exists()


def test_env_says_where_colcon_finds_this_ros(checkout: Checkout) -> None:
    for ros in ("wheels", "jazzy"):
        done = checkout.bash('. ./env.sh; echo "$COLCON_DEFAULTS_FILE"', ros, ROS_DISTRO="jazzy")
        assert done.stdout == f"{checkout.folder}/.ros/{ros}/colcon.yaml\n"


def test_what_sudo_installs_is_said_first(checkout: Checkout) -> None:
    (checkout.folder / "present").unlink()
    (checkout.folder / "needs_password").write_text("1")
    refused = checkout.setup("wheels")
    assert refused.returncode == 1
    assert not (checkout.folder / "as_root").exists()
    (checkout.folder / "needs_password").write_text("0")
    done = checkout.setup("wheels")
    assert done.returncode == 0, done.stderr
    for command in ("apt-get update", "apt-get install -y --no-install-recommends cmake"):
        assert f"sudo {command}" in refused.stdout
        assert f"sudo {command}" in done.stdout
    assert "install" in (checkout.folder / "as_root").read_text()


def test_what_this_ros_lacks_is_left_out(checkout: Checkout) -> None:
    """All else that a manifest asks for must be there."""
    checkout.setup("wheels")
    built = (checkout.folder / ".ros/wheels/colcon.yaml").read_text()
    assert "    - -DROSPLAT_RCLCPP=OFF\n    - -DROSPLAT_DISPLAY=OFF\n" in built
    rviz = checkout.folder / "programs/rviz2"
    rviz.touch(0o755)
    checkout.setup("jazzy", ROS_DISTRO="jazzy")
    built = (checkout.folder / ".ros/jazzy/colcon.yaml").read_text()
    assert "    - -DROSPLAT_RCLCPP=ON\n    - -DROSPLAT_DISPLAY=ON\n" in built


@pytest.mark.parametrize(
    ("package", "switch", "lacking"),
    [
        ("rosplat_ros", "ROSPLAT_RCLCPP", "rclcpp"),
        ("rosplat_lab", "ROSPLAT_DISPLAY", "rviz_common"),
        ("rviz_gaussian_plugin", "ROSPLAT_DISPLAY", "rviz_common"),
    ],
)
def test_a_build_fails_without_what_its_manifest_asks_for(
    tmp_path: Path, package: str, switch: str, lacking: str
) -> None:
    command = ["cmake", "-S", ROOT / package, "-B", tmp_path, f"-D{switch}=ON",
               f"-DCMAKE_DISABLE_FIND_PACKAGE_{lacking}=ON",
               f"-DPython3_EXECUTABLE={sys.executable}", "-DBUILD_TESTING=OFF"]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode
    assert lacking in done.stderr


def test_an_unchanged_checkout_is_not_built_again(checkout: Checkout) -> None:
    (checkout.folder / "rosplat_core").mkdir()
    source = checkout.folder / "rosplat_core/a.py"
    source.write_text("1")
    assert "Building" in checkout.setup("wheels").stdout
    (checkout.folder / ".ros/wheels/install").mkdir()
    (checkout.folder / ".ros/wheels/install/local_setup.bash").touch()
    assert "Building" not in checkout.setup("wheels").stdout
    source.write_text("22")
    assert "Building" in checkout.setup("wheels").stdout
    assert "Building" not in checkout.setup("wheels").stdout


def test_a_checkout_that_has_moved_is_built_anew(checkout: Checkout) -> None:
    checkout.setup("wheels")
    old = checkout.folder / ".ros/wheels/venv/old"
    old.touch()
    moved = checkout.folder.with_name("moved")
    checkout.folder.rename(moved)
    checkout.folder = moved
    assert "./setup.sh builds it anew" in checkout.bash(". ./env.sh", "wheels").stderr
    done = checkout.setup("wheels")
    assert done.returncode == 0, done.stderr
    assert "building anew" in done.stdout
    assert not (moved / ".ros/wheels/venv/old").exists()
    assert "anew" not in checkout.bash(". ./env.sh", "wheels").stderr


def test_what_is_no_more_is_no_longer_installed(checkout: Checkout) -> None:
    installed = checkout.folder / ".ros/wheels/install/rosplat_tools/lib"
    gone = [
        installed / "rosplat_tools/program",
        installed / "python3.11/site-packages/rosplat_tools/module.py",
    ]
    kept = installed / "python3.11/site-packages/another/module.py"
    for file in (*gone, kept):
        file.parent.mkdir(parents=True)
        file.touch()
    assert checkout.setup("wheels").returncode == 0
    assert not any(file.exists() for file in gone)
    assert kept.exists()


def test_env_says_what_is_not_built(checkout: Checkout) -> None:
    assert "ROSPLAT_ROS=wheels" in checkout.bash(". ./env.sh", "wheels").stderr
    (checkout.folder / ".ros/wheels/install").mkdir(parents=True)
    (checkout.folder / ".ros/wheels/install/local_setup.bash").touch()
    assert not checkout.bash(". ./env.sh", "wheels").stderr


def test_a_folder_with_a_space_is_named(tmp_path: Path) -> None:
    (tmp_path / "my robots").mkdir()
    done = Checkout(tmp_path / "my robots").setup("wheels")
    assert done.returncode == 1
    assert "move the checkout" in done.stderr
