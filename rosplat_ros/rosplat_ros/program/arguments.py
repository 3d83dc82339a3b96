"""A node's command line."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable

from rclpy.utilities import remove_ros_args

from rosplat_ros.program.parameter_help import declared_by, described


def take_ros_arguments_only(
    program: str, description: str | None, body: Callable[[], None], usage: str = ""
) -> None:
    """Answers --help; ends the program at an argument that isn't ROS's, such as a scene's path.

    body: of the program, by which --help finds its parameters. usage: another way to call it.
    """
    parser = argparse.ArgumentParser(
        prog=program,
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage=f"{program} [--ros-args [-p PARAMETER:=VALUE] [-r TOPIC:=OTHER] ...]"
        + (f"\n       {usage}" if usage else ""),
    )
    if {"-h", "--help"} & set(sys.argv[1:]):
        parser.epilog = described(declared_by(body))
    try:
        parser.parse_args(remove_ros_args(sys.argv)[1:])
    except RuntimeError as error:  # RCLInvalidROSArgsError, UnknownROSArgsError: not public
        # Leaves out the line of rcl's sources that found it.
        parser.error(
            "--ros-args: " + re.sub(r"( Error: Expected lexeme.*)?, at /.*", "", str(error))
        )
    except UnicodeEncodeError as error:  # of the name of a file, say
        parser.error(f"--ros-args: {error.object!r} is not UTF-8")
