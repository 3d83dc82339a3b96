"""Settings of Fast DDS that maps need, for programs that start and for those that they start."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

# A user who sets one of these has configured Fast DDS already.
FAST_DDS_WISHES = (
    "FASTDDS_BUILTIN_TRANSPORTS",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_LOCALHOST_ONLY",
)
ROOM_FOR_SEGMENTS = 1 << 30  # in shared memory, of which the profile takes 32 MiB a program [bytes]


def fast_dds_profile(environment: Mapping[str, str]) -> dict[str, str]:
    """The variable that gives Fast DDS the profile of rosplat_msgs, which has room for maps.

    Empty if the environment sets one of FAST_DDS_WISHES, or shared memory is small (containers).
    """
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    try:
        profile = Path(get_package_share_directory("rosplat_msgs")) / "config" / "fastdds.xml"
        room = shutil.disk_usage("/dev/shm").free
    except (PackageNotFoundError, OSError):
        return {}
    if room < ROOM_FOR_SEGMENTS or any(environment.get(name) for name in FAST_DDS_WISHES):
        return {}
    old = environment.get("ROS_DISTRO") in ("humble", "jazzy")  # later ones warn of the old name
    return {f"{'FASTRTPS' if old else 'FASTDDS'}_DEFAULT_PROFILES_FILE": str(profile)}


def prepare_fast_dds(*, sends_maps: bool = True) -> None:
    """Gives this program that profile. Call it before ROS begins, which reads it once.

    sends_maps: else the program takes 4 MB of shared memory, not 32.
    """
    os.environ.update(fast_dds_profile(os.environ))
    if sends_maps:
        return
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
        profile = Path(os.environ.get(name, ""))
        if profile.name == "fastdds.xml" and profile.with_stem("fastdds_small").exists():
            os.environ[name] = str(profile.with_stem("fastdds_small"))
