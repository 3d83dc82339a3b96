"""Numbers as users type them."""

from __future__ import annotations

UNITS = {"k": 10**3, "m": 10**6, "g": 10**9}


def whole_number(text: str) -> int:
    """A whole number, as 20k, 1.5M or 20G too. Raises ValueError."""
    unit = UNITS.get(text[-1:].lower(), 1)
    try:
        return round(float(text if unit == 1 else text[:-1]) * unit)
    except (ValueError, OverflowError):  # OverflowError: inf
        raise ValueError(f"'{text}' is no whole number, such as 20k or 5M") from None
