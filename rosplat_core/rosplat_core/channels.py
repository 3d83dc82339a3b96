"""Named channels: further values of each splat, such as a label. Knows no ROS."""

from __future__ import annotations

import re
from collections.abc import Sequence

from rosplat_core.log_text import shown

MOST = 8  # as GaussianArray.MAX_CHANNELS

_NAME = re.compile(r"[!-~]{1,64}")  # printable ASCII without spaces, as a PLY's header needs


class ChannelError(ValueError):
    """Channels that a map can't have; the text names the field."""


def is_name(text: str) -> bool:
    """Whether a text may be a channel's name."""
    return _NAME.fullmatch(text) is not None


def joined(known: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """The channels of a map that has the known ones, after a batch with these names.

    Raises ChannelError for an invalid name, a name that is there twice, and more than MOST in all.
    """
    for name in names:
        if not is_name(name):
            raise ChannelError(
                f"channel_names: '{shown(name, 40)}' is no name: 1 to 64 characters of ASCII, "
                "no spaces"
            )
    if len(set(names)) < len(names):
        raise ChannelError("channel_names: one is there twice")
    together = tuple(dict.fromkeys([*known, *names]))
    if len(together) > MOST:
        raise ChannelError(f"channel_names: {len(together)} in all, a map has at most {MOST}")
    return together
