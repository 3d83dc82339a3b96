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
# Metadata by which a prim is composed from those of a named file, and from any number of them.
ARCS = ("references", "payload")
CLIPS = "clips"
NUREC = "omni:nurec:isNuRecVolume"  # an attribute of NVIDIA's volumes, whose splats are elsewhere
MODEL = "rosplat:model"  # of customData
HINTS = {"sortingModeHint": "zDepth", "projectionModeHint": "perspective"}


def main(path: str, most: int, metadata_only: bool) -> None:
    """Writes what a file holds, or the error, to standard output."""
    from pxr import Sdf, Tf, UsdGeom

    _limit(most)
    out = sys.stdout.buffer
    arrays: list[Any] = []
    try:
        layer = Sdf.Layer.OpenAsAnonymous(path, metadataOnly=True)
        if layer is None:
            raise ValueError("no format of OpenUSD's")
        up = layer.pseudoRoot.GetInfo("upAxis")
        told: dict[str, Any] = {"up": str(up or UsdGeom.GetFallbackUpAxis())}
        if not metadata_only:
            told, arrays = _read(path)
    except Tf.ErrorException as error:
        told, arrays = {"error": _reason(error)}, []
    except (ValueError, TypeError, MemoryError, RuntimeError) as error:
        told, arrays = {"error": str(error) or type(error).__name__}, []
    out.write(json.dumps(told).encode() + b"\n")
    for array in arrays:
        out.write(memoryview(array).cast("B"))
    out.flush()


def _read(path: str) -> tuple[dict[str, Any], list[Any]]:
    """What the JSON says of a whole file, and the arrays."""
    from pxr import Sdf, Usd, UsdGeom

    root = Sdf.Layer.FindOrOpen(path)
    if root is None:
        raise ValueError("no format of OpenUSD's")
    _refuse_others(root)
    stage = Usd.Stage.Open(root)
    fields: list[Any] = []
    arrays: list[Any] = []
    told: dict[str, Any] = {
        "meters": UsdGeom.GetStageMetersPerUnit(stage),
        "measured": stage.HasAuthoredMetadata("metersPerUnit"),
        "fields": fields,
        "nurec": False,
    }
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        if prim.GetTypeName() == SPLATS:
            field, found = _field(prim)
            fields.append(field)
            arrays += found
        told["nurec"] |= prim.HasAttribute(NUREC)
    return told, arrays


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


def _refuse_others(root: Any) -> None:
    """Raises ValueError for a file composed of others, other layers of its package excepted."""
    from pxr import Sdf

    package = f"{root.realPath}["
    waiting, seen = [root], set()
    while waiting:
        layer = waiting.pop()
        seen.add(layer.identifier)
        for asset, where in _assets(layer):
            inside = Sdf.ComputeAssetPathRelativeToLayer(layer, asset)
            if not inside.startswith(package):
                raise ValueError(
                    f"{where} names another file, {asset}: make one of them in Python by "
                    "Usd.Stage.Open(file).Export('one.usdc')"
                )
            if inside in seen:
                continue
            found = Sdf.Layer.FindOrOpen(inside)
            if found is None:
                raise ValueError(f"{where} names {asset}, which the package lacks")
            waiting.append(found)


def _assets(layer: Any) -> list[tuple[str, str]]:
    """The files that a layer is composed of, each with who names it."""
    found = [(path, "a sublayer") for path in layer.subLayerPaths]

    def look(path: Any) -> None:
        is_prim = path.IsPrimPath() or path.IsPrimVariantSelectionPath()
        spec = layer.GetPrimAtPath(path) if is_prim else None
        if not spec:
            return
        if spec.HasInfo(CLIPS):
            raise ValueError(f"{path} has value clips, which are not read")
        for arc in ARCS:
            items = spec.GetInfo(arc).GetAddedOrExplicitItems() if spec.HasInfo(arc) else []
            found.extend((item.assetPath, f"{arc} of {path}") for item in items if item.assetPath)

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
        "model": prim.GetCustomDataByKey(MODEL),
        "hints": {
            name: str(prim.GetAttribute(name).Get())
            for name in HINTS
            if prim.GetAttribute(name) and prim.GetAttribute(name).HasAuthoredValue()
        },
    }, arrays


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), len(sys.argv) > 3)
