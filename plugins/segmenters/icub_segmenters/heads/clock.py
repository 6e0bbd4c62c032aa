"""Seconds spent in the scores of on-line heads, for benchmarks: nothing is measured outside of `seconds_in_heads`."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TypeVar

import torch

Head = TypeVar("Head")


@dataclass
class Clock:
    """Sum of the seconds in `decision_function` of all heads."""

    seconds: float = 0.0


_running: ContextVar[Clock | None] = ContextVar("running", default=None)


@contextlib.contextmanager
def seconds_in_heads() -> Iterator[Clock]:
    """Within this context the clock that is given runs while a head computes scores."""
    clock = Clock()
    token = _running.set(clock)
    try:
        yield clock
    finally:
        _running.reset(token)


def clocked(scores: Callable[[Head, torch.Tensor], torch.Tensor]) -> Callable[[Head, torch.Tensor], torch.Tensor]:
    """Decorate the `decision_function` of a head so that its time is counted where somebody measures."""

    @functools.wraps(scores)
    def timed(head: Head, X: torch.Tensor) -> torch.Tensor:
        clock = _running.get()
        if clock is None:
            return scores(head, X)
        start = time.perf_counter()
        try:
            return scores(head, X)
        finally:
            clock.seconds += time.perf_counter() - start

    return timed
