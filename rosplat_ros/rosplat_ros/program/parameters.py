"""Declares parameters: each has a description, numbers have a range."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from rosplat_core.log_text import shown
from rosplat_core.models import Model
from rosplat_core.program.typed_numbers import whole_number
from rosplat_core.splats import InputError
from rosplat_ros.messages import COMPRESSIONS, NONE


def declare(
    node: Node,
    name: str,
    default: Any,
    description: str,
    low: float | None = None,
    high: float | None = None,
    *,
    choices: Iterable[object] = (),
    changes: bool = False,
) -> Any:
    """Declares a parameter; returns its value, a number from low to high, or one of choices.

    changes: whether it may be set later, else it is read-only. Raises InputError for no value, one
    that can't be meant for the default's type, or one that isn't allowed.
    """
    known = ", ".join(map(str, choices))
    description += f": {known}." if known else ""
    descriptor = ParameterDescriptor(description=description, read_only=not changes)
    if low is not None and high is not None:
        if isinstance(default, int):
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    given = node._parameter_overrides  # no public function has them
    try:
        if name in given:
            given[name] = Parameter(name, value=_meant(given[name].value, default))
        value = node.declare_parameter(name, default, descriptor).value
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        raise InputError(str(error)) from error
    except ValueError as error:
        raise InputError(f"parameter {name}: {error}") from error
    if value is None:  # rclpy makes None of an empty list, whatever the type
        raise InputError(f"parameter {name}: has no value")
    if known and value not in (default, *map(str, choices)):
        raise InputError(f"parameter {name}: expected one of {known}, got '{shown(value)}'")
    return value


def _meant(value: Any, default: Any) -> Any:
    """A value in the default's type, where a user may well give it in another."""
    match default, value:
        case (bool(), _) | (_, bool()):
            return value
        case float(), int():  # rate:=10
            return float(value)
        case [float(), *_], [int(), *_]:  # band:=[0, 2]
            return list(map(float, value))
        case int(), float() if value.is_integer():  # max_splats:=2e6
            return int(value)
        case int(), str():  # max_splats:=20k
            return whole_number(value)
        case str(), int() | float():  # detail:=2
            return str(value)
        case str(), [int() | float(), *_]:  # up:=[0, 0, 1]
            return " ".join(map(str, value))
        case [str(), *_], str():  # cameras:=left
            return [value]
    return value


def declare_path(node: Node, name: str, default: str, description: str) -> str:
    """Declares a parameter that names a file or a folder; ~ stands for the user's folder.

    Raises InputError as `declare`.
    """
    return os.path.expanduser(declare(node, name, default, description))


def declare_compression(node: Node) -> str:
    """Declares `compression`, for MapPublisher. Raises InputError for one that is not known."""
    about = "How splats travel, to subscribers beyond a network"
    compression: str = declare(node, "compression", NONE, about, choices=COMPRESSIONS)
    return compression


def declare_model(node: Node) -> Model | None:
    """Declares `model`, None for the scene's own. Raises InputError for one that is not known."""
    about = "How splats become pixels; empty: as the scene says, or ewa"
    name: str = declare(node, "model", "", about, choices=Model)
    return Model.of(name) if name else None


def declare_clip(node: Node) -> tuple[float, float]:
    """Declares `near` and `far` of a camera, and returns both. [m]

    Raises InputError where nothing is between them.
    """
    near: float = declare(node, "near", 0.01, "Splats nearer are left out. [m]", 1e-4, 1e6)
    far: float = declare(node, "far", 1e6, "Splats farther are left out. [m]", 1e-3, 1e10)
    if not near < far:
        raise InputError(f"parameters near, far: {near} is not less than {far}")
    return near, far
