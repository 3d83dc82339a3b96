"""Cameras as messages."""

import pytest

from rosplat_core.posed_camera import CameraError
from rosplat_sorter.camera import decode


def test_an_unknown_projection_is_refused(make_look):
    with pytest.raises(CameraError, match="projection is 7"):
        decode(make_look(projection=7))
