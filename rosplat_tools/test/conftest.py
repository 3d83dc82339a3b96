"""What tests share: see rosplat_tools.testing; and real trained scenes where they are at hand."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

pytest_plugins = ["rosplat_tools.testing"]

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
