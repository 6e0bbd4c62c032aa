"""Bounds of a constructor's parameter, written into its annotation and checked when a run is composed.

def __init__(self, penalty: Annotated[float, above(0)] = 1e-3, frames: Annotated[int, at_least(1)] = 60): ...
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Bounds:
    """Lowest and highest value; `low` itself is allowed unless `open_low`. NaN never is."""

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False

    def check(self, value: Any) -> None:
        """Raise TypeError with what was expected for a value out of bounds, and for any such member of a list."""
        for number in value if isinstance(value, (list, tuple)) else (value,):
            if number is None:
                continue
            low = number > self.low if self.open_low else number >= self.low
            if not (low and number <= self.high):
                raise TypeError(f"is out of bounds; expected {self}")

    def __str__(self) -> str:
        """Return the bounds in words."""
        low = "" if self.low == -math.inf else f"{'above' if self.open_low else 'at least'} {self.low:g}"
        high = "" if self.high == math.inf else f"at most {self.high:g}"
        return " and ".join(part for part in (low, high) if part)


def above(low: float) -> Bounds:
    """Return the bounds of numbers greater than `low`."""
    return Bounds(low=low, open_low=True)


def at_least(low: float) -> Bounds:
    """Return the bounds of numbers not less than `low`."""
    return Bounds(low=low)


def between(low: float, high: float) -> Bounds:
    """Return the bounds of numbers from `low` to `high`, both included."""
    return Bounds(low=low, high=high)
