"""The models by which splats become pixels. A map is right in the one by which it was trained."""

from __future__ import annotations

from enum import IntEnum


class Model(IntEnum):
    """As in rosplat_msgs/GaussianArray, which describes them."""

    EWA = 0
    EWA_ANTIALIASED = 1
    RAY = 2
    DISC = 3

    @classmethod
    def of(cls, value: int | str) -> Model:
        """A model by its number, or by its name, such as "ray". Raises ValueError for others."""
        if not isinstance(value, str):
            return cls(value)
        if value not in map(str, cls):
            raise ValueError(f"model is '{value}', expected one of {', '.join(map(str, cls))}")
        return cls[value.upper()]

    def __str__(self) -> str:
        return self.name.lower()
