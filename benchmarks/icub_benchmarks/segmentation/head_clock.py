"""How much of a segmenter's time per frame is spent in its on-line heads."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Iterator, Sequence
from typing import Any

from icub_core import registry
from icub_core.data import RgbdFrame
from icub_core.interfaces.segmenter import Segmenter


@contextlib.contextmanager
def clocked_heads() -> Iterator[list[float]]:
    """Within this context the first item of the list that is given sums the seconds in any head's decision function."""
    total = [0.0]
    originals: list[tuple[type, Any]] = []
    for name in registry.available("online_head"):
        cls = registry.load("online_head", name)
        original = cls.__dict__.get("decision_function")
        if original is None:
            continue

        @functools.wraps(original)
        def clocked(*arguments: Any, original: Any = original, **named: Any) -> Any:
            start = time.perf_counter()
            try:
                return original(*arguments, **named)
            finally:
                total[0] += time.perf_counter() - start

        originals.append((cls, original))
        setattr(cls, "decision_function", clocked)  # noqa: B010
    try:
        yield total
    finally:
        for cls, original in originals:
            setattr(cls, "decision_function", original)  # noqa: B010


def heads_share(segmenter: Segmenter, frames: Sequence[RgbdFrame]) -> float:
    """Return the share of the time of finding objects in `frames` that passes in on-line heads, 0 to 1."""
    segmenter.segment(frames[0])  # the first call pays for what is prepared once
    with clocked_heads() as total:
        start = time.perf_counter()
        for frame in frames:
            segmenter.segment(frame)
        return total[0] / (time.perf_counter() - start)
