"""Gives what is started after it room for maps in Fast DDS's shared memory, where there is any."""

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction, SetEnvironmentVariable

from rosplat_tools.program.processes import fast_dds_profile


def _set_profile(context: LaunchContext) -> list[SetEnvironmentVariable]:
    profile = fast_dds_profile(context.environment)
    return [SetEnvironmentVariable(name, value) for name, value in profile.items()]


def generate_launch_description() -> LaunchDescription:
    """To be included in a group, which ends what is set."""
    return LaunchDescription([OpaqueFunction(function=_set_profile)])
