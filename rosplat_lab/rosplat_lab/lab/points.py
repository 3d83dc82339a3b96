"""What was measured: a point for each method, scene and camera, kept to be measured once."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from rosplat_core.cameras import Camera
from rosplat_core.program.files import write_text
from rosplat_core.splats import SceneError, Splats
from rosplat_lab import reference
from rosplat_lab.arguments import make_folder
from rosplat_lab.lab import bench, fragments, motion, orders, viewers


@dataclass(frozen=True)
class Point:
    """One picture against its reference."""

    key: str
    method: str
    family: str
    aside: str
    """Why the method is not held against others, empty where it is."""
    scene: str
    camera: int
    splats: int | None
    """Drawn, None for models and where the renderer sorts."""
    sort_ms: float | None
    draw_ms: float | None
    pose_ms: float | None
    """As in Shot; models have no times."""
    psnr: float
    ssim: float
    flip: float
    worst: float
    machine: str
    gpu: str
    commit: str
    command: str

    @property
    def ms(self) -> float | None:
        """What a frame costs, sorting and drawing; None for models."""
        return None if self.sort_ms is None or self.draw_ms is None else self.sort_ms + self.draw_ms


class Store:
    """Points in a file of a JSON object a line, and binary results beside it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        make_folder(folder)
        self._file = folder / "points.jsonl"
        self._points = {point.key: point for point in _read(self._file)}
        if self._file.exists() and not self._file.read_bytes().endswith(b"\n"):
            with self._file.open("ab") as file:  # to the line that an interrupted run was writing
                file.write(b"\n")

    def get(self, key: str) -> Point | None:
        """The point of a key, if it was measured."""
        return self._points.get(key)

    def add(self, point: Point) -> None:
        """Keeps a point, at once: an interrupted run goes on here."""
        self._points[point.key] = point
        with self._file.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(point)) + "\n")

    def truth(self, key: str) -> Path:
        """Where the reference picture of a key is, or is to be."""
        return self.folder / "truth" / f"{key}.npy"


def _read(path: Path) -> Iterator[Point]:
    names = {field.name for field in fields(Point)}
    if not path.exists():
        return
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            entry = json.loads(line)
        except ValueError:  # the line that an interrupted run was writing
            continue
        if isinstance(entry, dict) and set(entry) == names:
            yield Point(**entry)


def key(*parts: object) -> str:
    """A name for what a result depends on."""
    return hashlib.sha256("\n".join(map(str, parts)).encode()).hexdigest()[:24]


def scene_key(splats: Splats) -> str:
    """Of what a scene draws: no channels."""
    digest = hashlib.sha256()
    for name, value in vars(splats).items():
        if name != "channels":
            digest.update(np.asarray(value).data)
    return digest.hexdigest()[:24]


def camera_key(camera: Camera) -> str:
    """Of a camera's values."""
    return key(*vars(camera).items(), camera.world_to_camera.tolist())


def code_version() -> str:
    """Of the code and shaders that pictures and times come from, methods.py apart: there a method's
    name stands for what it does."""
    import rviz_gaussian_plugin._offscreen as renderer
    from rviz_gaussian_plugin.offscreen import _media_folder

    sources = [
        Path(module.__file__ or "") for module in (bench, fragments, motion, orders, viewers)
    ]
    sources += sorted(Path(reference.__file__).parent.glob("*.py"))
    binaries = [Path(renderer.__file__ or ""), *sorted(_media_folder().iterdir())]
    digests = [hashlib.sha256(path.read_bytes()).hexdigest() for path in binaries]
    return key(*map(_meaning, sources), *digests)


def _meaning(path: Path) -> str:
    """A source without its comments, docstrings and layout."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list) and body and isinstance(body[0], ast.Expr):
            value = body[0].value
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                del body[0]
    return ast.dump(tree)


RUN = ("machine", "gpu", "commit", "command")  # fields of a Point that many have in common


def save(path: Path, points: Iterable[Point]) -> None:
    """Writes points for other programs: each names its run, by number."""
    runs: dict[tuple[str, ...], int] = {}
    rows = []
    for point in points:
        row = {name: _short(value) for name, value in asdict(point).items() if name not in RUN}
        run = tuple(getattr(point, name) for name in RUN)
        rows.append(json.dumps(row | {"run": runs.setdefault(run, len(runs))}))
    heads = [json.dumps(dict(zip(RUN, run, strict=True))) for run in runs]
    lines = ",\n".join(rows)
    write_text(path, f'{{"runs": [{", ".join(heads)}],\n"points": [\n{lines}\n]}}\n')


def load(path: Path) -> list[Point]:
    """Reads what save wrote. Raises OSError, or SceneError where it is something else."""
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(kept, dict):
            raise ValueError("no object with runs and points")
        points = [_point(kept["runs"], row, number) for number, row in enumerate(kept["points"])]
        if not points:
            raise ValueError("no points")
    except KeyError as error:
        raise SceneError(f"{path}: not what lab writes: no field {error}") from error
    except (ValueError, LookupError, TypeError) as error:
        raise SceneError(f"{path}: not what lab writes: {error}") from error
    return points


def _point(runs: list[dict[str, str]], row: dict[str, Any], number: int) -> Point:
    values = runs[row["run"]] | {name: value for name, value in row.items() if name != "run"}
    if wrong := values.keys() ^ {field.name for field in fields(Point)}:
        raise ValueError(f"point {number} lacks, or is not to have, {', '.join(sorted(wrong))}")
    return Point(**values)


def _short(value: object) -> object:
    """Without digits that nobody reads."""
    return float(f"{value:.5g}") if isinstance(value, float) else value
