"""A map as Rerun's GaussianSplats3D, an archetype of rerun-sdk 0.41 and later."""

from __future__ import annotations

import numpy as np
from std_msgs.msg import Header

from rosplat_core.harmonics import C0
from rosplat_core.splats import InputError, Splats

BANDS = 16  # harmonics of degree 3, of which Rerun takes all but the first


class RerunLog:
    """Shows maps in a viewer of Rerun, on the timeline of their stamps."""

    def __init__(self, address: str) -> None:
        """address: of a viewer; empty: starts one. Raises InputError where there is no Rerun."""
        try:
            import rerun
        except ImportError as error:
            raise InputError("as: rerun needs rerun-sdk 0.41 or later, of PyPI") from error
        if not hasattr(rerun, "GaussianSplats3D"):
            raise InputError(f"as: rerun-sdk is {rerun.__version__}, expected 0.41 or later")
        self._rerun = rerun
        rerun.init("rosplat", spawn=not address)
        if address:
            rerun.connect_grpc(address)

    def log(self, splats: Splats, header: Header) -> None:
        """Logs a map under its frame's name."""
        stamp = header.stamp.sec + 1e-9 * header.stamp.nanosec
        self._rerun.set_time("ros_time", timestamp=stamp)
        self._rerun.log(header.frame_id or "map", self._rerun.GaussianSplats3D(**fields(splats)))


def fields(splats: Splats) -> dict[str, object]:
    """The arguments of GaussianSplats3D. Rerun keeps base colours and opacities in 8 bits."""
    base = np.column_stack([C0 * splats.sh[:, 0] + 0.5, splats.opacities])
    given: dict[str, object] = {
        "centers": splats.positions + splats.origin,
        "scales": splats.scales,
        "quaternions": splats.orientations,
        "colors": np.rint(255 * np.clip(base, 0, 1)).astype(np.uint8),
    }
    if splats.sh_degree:
        rest = splats.sh[:, 1:]
        missing = BANDS - 1 - rest.shape[1]
        given["sh_coefficients"] = np.pad(rest, ((0, 0), (0, missing), (0, 0)))
        given["spherical_harmonics_degree"] = splats.sh_degree
    return given
