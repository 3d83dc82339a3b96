"""Reads an OpenUSD file for usd.py, in a process of its own, which a broken file may end.

usd-core trusts the sizes that a file states. Arguments are the file's name, how much memory reading
may take [bytes], and any third one to read the metadata alone. Standard output gets a line of JSON,
then the arrays that the JSON lists, one after the other.
"""

from __future__ import annotations

import json
import re
import resource
import sys
from typing import Any

SPLATS = "ParticleField3DGaussianSplat"
# The schema's attributes, with the floats in a row; each may be halves under its name and an h.
ARRAYS = {
    "positions": 3,
    "orientations": 4,
    "scales": 3,
    "opacities": 1,
    "radiance:sphericalHarmonicsCoefficients": 3,
}
DEGREE = "radiance:sphericalHarmonicsDegree"
# Metadata by which a prim is composed from others.
ARCS = ("references", "payload", "inheritPaths", "specializes", "variantSetNames", "clips")
ANTIALIASED = "rosplat:antialiased"  # of customData
HINTS = {"sortingModeHint": "zDepth", "projectionModeHint": "perspective"}


def main(path: str, most: int, metadata_only: bool) -> None:
    """Writes what a file holds, or the error, to standard output."""
    from pxr import Sdf, Tf, Usd, UsdGeom

    _limit(most)
    out = sys.stdout.buffer
    arrays: list[Any] = []
    try:
        layer = Sdf.Layer.OpenAsAnonymous(path, metadataOnly=metadata_only)
        if layer is None:
            raise ValueError("no format of OpenUSD's")
        if refused := _arcs(layer):
            raise ValueError(f"{refused[0]} isn't read; usdcat --flatten makes one tree of a file")
        stage = Usd.Stage.Open(layer, Usd.Stage.LoadNone)
        told: dict[str, Any] = {
            "up": str(UsdGeom.GetStageUpAxis(stage)),
            "meters": UsdGeom.GetStageMetersPerUnit(stage),
            "measured": stage.HasAuthoredMetadata("metersPerUnit"),
            "fields": [],
        }
        for prim in [] if metadata_only else stage.Traverse():
            if prim.GetTypeName() == SPLATS:
                field, found = _field(prim)
                told["fields"].append(field)
                arrays += found
    except Tf.ErrorException as error:
        told, arrays = {"error": _reason(error)}, []
    except (ValueError, TypeError, MemoryError, RuntimeError) as error:
        told, arrays = {"error": str(error) or type(error).__name__}, []
    out.write(json.dumps(told).encode() + b"\n")
    for array in arrays:
        out.write(memoryview(array).cast("B"))
    out.flush()


def _reason(error: Exception) -> str:
    """usd-core's complaint about a file, without internal names."""
    try:
        return re.sub(r"pxrInternal_\w+::", "", error.args[0].commentary)
    except UnicodeDecodeError:
        return "not in UTF-8"


def _limit(most: int) -> None:
    """Limits this process to `most` bytes more memory than it has now."""
    with open("/proc/self/status", encoding="ascii") as status:
        has = next(int(line.split()[1]) << 10 for line in status if line.startswith("VmData:"))
    resource.setrlimit(resource.RLIMIT_DATA, (has + most, has + most))


def _arcs(layer: Any) -> list[str]:
    """Names of all that composes a file beyond its own tree of prims: it could be any file."""
    found = [f"sublayer {path}" for path in layer.subLayerPaths]

    def look(path: Any) -> None:
        spec = layer.GetPrimAtPath(path) if path.IsPrimPath() else None
        found.extend(f"{arc} of {path}" for arc in ARCS if spec and spec.HasInfo(arc))

    layer.Traverse(layer.pseudoRoot.path, look)
    return found


def _field(prim: Any) -> tuple[dict[str, Any], list[Any]]:
    """A prim's description for the JSON, and those arrays that it has, at the earliest time."""
    from pxr import Usd, UsdGeom

    time = Usd.TimeCode.EarliestTime()
    arrays: list[Any] = []
    forms: list[tuple[str, int] | None] = []
    for name, width in ARRAYS.items():
        found = None
        for attribute in (prim.GetAttribute(name), prim.GetAttribute(f"{name}h")):
            if attribute and not found:
                found = attribute.Get(time)
        if not found:
            forms.append(None)
            continue
        view = memoryview(found)
        rows, *columns = view.shape or ()
        if view.format not in ("f", "e") or columns != ([] if width == 1 else [width]):
            raise ValueError(f"{name} of {prim.GetPath()} isn't an array of the schema's type")
        arrays.append(view)
        forms.append((view.format, rows))
    degree = prim.GetAttribute(DEGREE).Get() if prim.HasAttribute(DEGREE) else None
    if not isinstance(degree, int | None):
        raise ValueError(f"{DEGREE} of {prim.GetPath()} isn't a whole number")
    pose = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time)
    return {
        "path": str(prim.GetPath()),
        "arrays": forms,
        "degree": degree,
        "pose": [list(row) for row in pose],
        "antialiased": prim.GetCustomDataByKey(ANTIALIASED) is True,
        "hints": {
            name: str(prim.GetAttribute(name).Get())
            for name in HINTS
            if prim.GetAttribute(name) and prim.GetAttribute(name).HasAuthoredValue()
        },
    }, arrays


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), len(sys.argv) > 3)
