"""What tests of several packages share: splats, cameras, and trained scenes where they are at hand.

A conftest.py names it: `pytest_plugins = ["core_fixtures"]`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rosplat_core.models import Model
from rosplat_core.posed_camera import PosedCamera
from rosplat_core.splats import Splats

CHECKOUT = Path(__file__).resolve().parents[2]


def _shared(variable: str, folder: str, name: str) -> Path:
    path = Path(os.environ.get(variable) or CHECKOUT.parent / "shared" / folder) / name
    if not path.exists():
        pytest.skip(f"no {name} in ${variable} or ../shared/{folder}")
    return path


@pytest.fixture
def scene() -> Callable[[str], Path]:
    """Path of a real scene by name; skips the test where it isn't there."""
    return lambda name: _shared("ROSPLAT_DATA", "data", name)


@pytest.fixture
def reference() -> Callable[[str], Path]:
    """An independent renderer's pictures of a scene; skips the test where they aren't there."""
    return lambda name: _shared("ROSPLAT_REFERENCE", "reference", name)


def random_splats(
    count: int, sh_degree: int = 3, seed: int = 0, model: Model = Model.EWA
) -> Splats:
    """Splats of all orientations within a metre or so."""
    rng = np.random.default_rng(seed)
    orientations = rng.normal(size=(count, 4))
    flat = (1, 1, model is not Model.DISC)
    return Splats(
        positions=rng.normal(size=(count, 3)).astype(np.float32),
        orientations=orientations / np.linalg.norm(orientations, axis=1, keepdims=True),
        scales=flat * np.exp(rng.uniform(-7, -1, (count, 3))),
        opacities=rng.uniform(0, 1, count).astype(np.float32),
        sh=rng.normal(size=(count, (sh_degree + 1) ** 2, 3)).astype(np.float32),
        model=model,
    )


@pytest.fixture(name="random_splats", scope="session")
def _random_splats() -> Callable[..., Splats]:
    return random_splats


@pytest.fixture
def make_camera():
    """A camera at the map's origin that looks along z, with what is given instead."""

    def make(**given) -> PosedCamera:
        values = {
            "position": (0.0, 0.0, 0.0),
            "orientation": (0.0, 0.0, 0.0, 1.0),
            "orthographic": False,
            "fx": 500.0,
            "fy": 500.0,
            "cx": 320.0,
            "cy": 240.0,
            "width": 640,
            "height": 480,
            "near_clip": 0.1,
            "far_clip": 100.0,
        }
        return PosedCamera(**(values | given))

    return make


@pytest.fixture
def few_views(monkeypatch: pytest.MonkeyPatch) -> None:
    """`simplify` with fewer and smaller views, which are enough for small scenes."""
    from rosplat_core.simplification import search, views  # takes its time

    for name, value in {"LEARNT": 24, "FRESH": 20, "ROUNDS": 1, "PIXELS": 320 * 180}.items():
        monkeypatch.setattr(search, name, value)
    monkeypatch.setattr(search, "VALUES", 3 * search.PIXELS)
    for module in (search, views):
        monkeypatch.setattr(module, "WIDTH", 320)
        monkeypatch.setattr(module, "HEIGHT", 180)
    monkeypatch.setattr(views, "FOCAL", views.FOCAL / 3)
    monkeypatch.setattr(views, "CHECKED", 20)
