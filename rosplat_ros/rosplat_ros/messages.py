"""Parts of messages of maps. Arrays are copied as blocks of memory, never by element."""

from __future__ import annotations

from array import array
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import payload
from rosplat_core.splats import InputError

NONE = "none"
COMPRESSIONS = (NONE, payload.QUANTISED)

Slots = range | NDArray[np.integer]
"""Which slots of a map: a contiguous range, or a list in any order, each once."""


def as_array(typecode: str, values: NDArray[np.generic]) -> array[float]:
    """An array.array, which setters of rosidl take as it is. They copy an ndarray by element."""
    result: array[float] = array(typecode)
    result.frombytes(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)
    return result


def message_class(type_name: str) -> Any:
    """The Python class of a message, "package/msg/Name". Raises InputError where it isn't here."""
    package, _, name = type_name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:  # an older release of the package lacks some
        raise InputError(f"{type_name} is of {package}, which isn't installed") from error


def plain_frame(frame_id: str) -> str:
    """A frame's name as tf2 takes it: without the leading slash that ROS 1 wrote."""
    return frame_id.removeprefix("/")


def is_frame(frame_id: str, other: str) -> bool:
    """Whether a message's frame is another one; an empty name stands for that."""
    return plain_frame(frame_id) in ("", plain_frame(other))
