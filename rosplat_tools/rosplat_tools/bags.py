"""Messages of a rosbag2, read by rosbag2_py of ROS 2, or else by rosbags of PyPI."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message

from rosplat_core.log_text import shown
from rosplat_core.splats import InputError
from rosplat_ros.program.mistakes import type_name

Read = Callable[[Collection[str]], Iterator[tuple[str, bytes]]]
"""Yields topics and serialized messages of the topics that it is given."""


def topic(path: str, name: str, how: str, *kinds: type) -> tuple[str, type]:
    """The topic of that name, of one of the kinds, and its kind; without a name, the only one.

    how: a user gives the name. Raises InputError, naming the bag and the topics that it has.
    """
    by_type = {type_name(kind): kind for kind in kinds}
    with _opened(path) as (types, _):
        known = {each: by_type[found] for each, found in types.items() if found in by_type}
    if not name and len(known) == 1:
        return next(iter(known.items()))
    if name in known:
        return name, known[name]
    what = " or ".join(kind.__name__ for kind in kinds)
    listed = f"it has {', '.join(sorted(known))}" if known else "it has none"
    asked = f"no {what} on {shown(name)}" if name else f"which {what}? Give {how}"
    raise InputError(f"{shown(path)}: {asked}: {listed}")


def messages(path: str, kinds: Mapping[str, type]) -> Iterator[tuple[str, Any]]:
    """Topics and their messages in the order in which they were recorded.

    kinds: the class of each topic that is read. Raises InputError, naming the bag.
    """
    with _opened(path) as (_, read):
        for topic, data in read(kinds):
            yield topic, deserialize_message(data, kinds[topic])


@contextmanager
def _opened(path: str) -> Iterator[tuple[dict[str, str], Read]]:
    if not Path(path).exists():
        raise InputError(f"{shown(path)}: No such file or directory")
    try:
        import rosbag2_py
    except ImportError:
        with _opened_by_rosbags(path) as opened:
            yield opened
        return
    reader = rosbag2_py.SequentialReader()

    def read(wanted: Collection[str]) -> Iterator[tuple[str, bytes]]:
        reader.set_filter(rosbag2_py.StorageFilter(topics=list(wanted)))
        while wanted and reader.has_next():
            topic, data, _ = reader.read_next()
            yield topic, data

    try:
        reader.open(rosbag2_py.StorageOptions(path), rosbag2_py.ConverterOptions("", ""))
        yield {each.name: each.type for each in reader.get_all_topics_and_types()}, read
    except RuntimeError as error:
        raise InputError(f"{shown(path)}: no whole bag: {shown(error, 300)}") from error


@contextmanager
def _opened_by_rosbags(path: str) -> Iterator[tuple[dict[str, str], Read]]:
    try:
        from rosbags.rosbag2 import Reader, ReaderError
    except ImportError as error:
        raise InputError(
            f"{shown(path)}: to read bags, install rosbag2_py (of ROS 2) or rosbags (of PyPI)"
        ) from error
    try:
        with Reader(path) as reader:

            def read(wanted: Collection[str]) -> Iterator[tuple[str, bytes]]:
                chosen = [each for each in reader.connections if each.topic in wanted]
                for connection, _, data in reader.messages(chosen) if chosen else ():
                    yield connection.topic, data

            yield {each.topic: each.msgtype for each in reader.connections}, read
    except (ReaderError, OSError, RuntimeError) as error:
        raise InputError(f"{shown(path)}: no whole bag: {shown(error, 300)}") from error
