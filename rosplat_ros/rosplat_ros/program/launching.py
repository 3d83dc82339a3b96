"""What launch files have in common. Needs launch_ros, which no node does."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from launch import Action, LaunchContext, LaunchDescription, SomeSubstitutionsType
from launch.actions import (
    DeclareLaunchArgument,
    GroupAction,
    OpaqueFunction,
    SetEnvironmentVariable,
)
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from rosplat_ros.program.middleware import fast_dds_profile

# Arguments of a scene that is published where one is given: the default, and what it means.
SCENE = {
    "scene": (
        "",
        "Scene file to publish: .ply, .spz, .sog, .splat, .ksplat, .glb, .usd or a SOG folder; a "
        "lod-meta.json is streamed; empty: the map comes from elsewhere",
    ),
    "up": (
        "",
        "The scene's vertical, such as '0 -1 0'; by default the file's, or else by its ground",
    ),
    "frame_id": (
        "",
        "Frame of the scene as the file has it; by default 'scene', which stands "
        "upright in the frame 'map' by a transform that is published, too",
    ),
    "max_splats": (2_000_000, "The most splats of a streamed scene that the map holds"),
}

# Before the command of a program: it ends with the launch, even with one that is killed.
ENDS_WITH_LAUNCH: SomeSubstitutionsType = [
    "setpriv --pdeathsig TERM " if shutil.which("setpriv") else "",
    LaunchConfiguration("launch-prefix", default=""),
]


def description(
    arguments: Mapping[str, tuple[Any, str]],
    actions: Callable[[dict[str, Any]], Iterable[Action]],
    *before: Action,
) -> LaunchDescription:
    """What `ros2 launch` reads. arguments: by name the default, and what it means. actions: of the
    arguments' values, of the defaults' types; programs among them have room for maps in Fast DDS's
    shared memory.
    """

    def begin(context: LaunchContext) -> list[GroupAction]:
        given = {
            name: _meant(name, LaunchConfiguration(name).perform(context), default)
            for name, (default, _) in arguments.items()
        }
        room = fast_dds_profile(context.environment)
        settings = [SetEnvironmentVariable(*each) for each in room.items()]
        return [GroupAction([*settings, *actions(given)])]

    declared = [
        DeclareLaunchArgument(name, default_value=_written(default), description=text)
        for name, (default, text) in arguments.items()
    ]
    return LaunchDescription([*declared, *before, OpaqueFunction(function=begin)])


def _meant(name: str, text: str, default: Any) -> Any:
    """An argument's value, of the default's type. Raises ValueError that names the argument."""
    try:
        match default:
            case bool():
                return {"true": True, "1": True, "false": False, "0": False}[text.strip().lower()]
            case int() | float():
                return type(default)(text)
            case list():
                return [float(part) for part in text.replace(",", " ").split()]
    except (KeyError, ValueError) as error:
        raise ValueError(f"{name}: expected {_EXPECTED[type(default)]}, got '{text}'") from error
    return text


_EXPECTED = {bool: "true or false", int: "a whole number", float: "a number", list: "numbers"}


def _written(default: Any) -> str:
    """A default as a user would give it."""
    match default:
        case bool():
            return str(default).lower()
        case float():
            return f"{default:g}"
        case list():
            return " ".join(map(_written, default))
    return str(default)


def program(
    package: str, executable: str, *remappings: tuple[str, str], **parameters: object
) -> Node:
    """A node named like its executable, which ends with the launch."""
    typed = {  # a path of digits stays a text
        name: value if isinstance(value, list) else ParameterValue(value, value_type=type(value))
        for name, value in parameters.items()
    }
    return Node(
        package=package,
        executable=executable,
        name=executable,
        parameters=[typed],
        remappings=remappings,
        prefix=ENDS_WITH_LAUNCH,
        exec_name=executable,  # in the log, not the prefix's
        output="screen",
    )


def scene_publisher(given: Mapping[str, Any]) -> list[Node]:
    """The node that publishes the scene of the arguments SCENE; none without a scene."""
    if not given["scene"]:
        return []
    return [publisher(given["scene"], given["frame_id"], given["max_splats"], up=given["up"])]


def publisher(scene: str, frame_id: str, max_splats: int, **parameters: object) -> Node:
    """The node that publishes a scene. max_splats: the most of a streamed one.

    frame_id: of the scene as the file has it; empty: `scene`, which stands upright in `map`.
    """
    standing = {} if frame_id else {"upright_frame": "map"}
    parameters |= {"path": scene, "frame_id": frame_id or "scene"} | standing
    name = "ply_publisher"
    if scene.endswith("lod-meta.json"):
        name, parameters = "stream_publisher", parameters | {"max_splats": max_splats}
    return program("rosplat_tools", name, **parameters)
