"""Maps in the messages of other packages: a module for each type, which reads and writes it.

A module has
- TYPE, TOPIC and DEPTH: the message, and how its own programs publish it; FIELDS, which it needs;
- Reader(name, warn), a MapReader;
- messages(kind, splats, header): the messages of a whole map; kind makes an empty one.

A type whose package isn't installed, or is of a release with other fields, is neither heard nor
sent, and said so.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any, Protocol

from std_msgs.msg import Header

from rosplat_core.formats.decoded import Warn
from rosplat_core.splats import InputError, Splats
from rosplat_ros.messages import message_class


class MapReader(ABC):
    """Makes a map of messages. Methods raise InputError, naming topic and field."""

    def __init__(self, name: str, warn: Warn) -> None:
        """name: of the topic."""
        self.frame_id = ""  # the map's; empty if unknown
        self._name, self._warn = name, warn
        self._splats: Splats

    @abstractmethod
    def add(self, message: Any) -> bool:
        """Keeps what a message says. Whether there is a map to be shown now."""

    def splats(self) -> Splats:
        """The map of all messages so far."""
        return self._splats


class Foreign(Protocol):
    """A module of this package."""

    TYPE: str
    TOPIC: str
    DEPTH: int
    FIELDS: tuple[str, ...]
    Reader: Callable[[str, Warn], MapReader]
    messages: Callable[[type, Splats, Header], Iterator[Any]]


TYPES = (
    "point_cloud",
    "gaussian_array",
    "gaussian_splats",
    "splat_array",
    "splat_tiles",
    "splat_blob",
)


def foreign(name: str) -> Foreign:
    """The module for one of TYPES."""
    module: Any = import_module(f"{__name__}.{name}")
    return module


def message_of(kind: Foreign) -> Any:
    """The Python class of a module's message.

    Raises InputError where its package isn't installed, or is of a release without its fields.
    """
    found = message_class(kind.TYPE)
    if lacking := [name for name in kind.FIELDS if name not in found.get_fields_and_field_types()]:
        package = kind.TYPE.partition("/")[0]
        raise InputError(f"{kind.TYPE} has no {', '.join(lacking)} in this release of {package}")
    return found
