"""First views as FirstView messages, in and out; and the frame that a scene stands upright in."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from rosplat_msgs.msg import FirstView
from rosplat_ros.poses import to_point, to_vector

if TYPE_CHECKING:
    from rosplat_core.first_look import FirstView as View


def first_view_message(view: View, frame_id: str, stamp: Time) -> FirstView:
    """The message for a view of a map in frame_id."""
    return FirstView(
        header=Header(frame_id=frame_id, stamp=stamp),
        eye=to_point(view.eye),
        target=to_point(view.target),
        up=to_vector(view.up),
        width=view.width,
        inside=view.inside,
    )


def read_first_view(message: FirstView) -> View:
    """The view of a message. Raises ValueError for one that is no view."""
    from rosplat_core.first_look import FirstView as View  # takes its time

    eye, target, up = (
        np.array([vector.x, vector.y, vector.z])
        for vector in (message.eye, message.target, message.up)
    )
    known = np.isfinite([*eye, *target, *up, message.width]).all()
    if not known or not up.any() or (eye == target).all():
        raise ValueError("first_view: not finite, no vertical, or the eye is the target")
    return View(eye, target, up / np.linalg.norm(up), max(0.0, message.width), message.inside)
