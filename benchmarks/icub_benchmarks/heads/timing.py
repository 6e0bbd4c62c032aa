"""Time and memory of calls, for `icub benchmark heads`."""

from __future__ import annotations

import contextlib
import ctypes
import time
from collections.abc import Callable
from pathlib import Path

import torch

from icub_segmenters.heads.products import product_precision

REPETITIONS = 5


def best_product_rate(size: int) -> float:
    """Return the best float32 rate, in operations per second, on square matrices: torch has both MKL and oneDNN."""
    A, B = torch.rand(size, size), torch.rand(size, size)
    rate = 0.0
    for precision in ("highest", "medium"):
        with product_precision(precision):
            rate = max(rate, 2 * size**3 / min(seconds(lambda: A @ B, 5)))
    return rate


def seconds(call: Callable[[], object], repetitions: int = REPETITIONS) -> list[float]:
    """Return the durations of repeated calls after one that does not count."""
    call()
    times = []
    for _ in range(repetitions):
        begun = time.perf_counter()
        call()
        times.append(time.perf_counter() - begun)
    return times


def once(call: Callable[[], object]) -> float:
    """Return the seconds of one call."""
    begun = time.perf_counter()
    call()
    return time.perf_counter() - begun


def peak_memory(call: Callable[[], object]) -> dict[str, float]:
    """Return what a call adds to the resident memory at most, in bytes, under "bytes"; nothing outside of Linux.

    What the process holds but does not use is given back first; the rest of it would not be counted, so this is a lower
    bound.
    """
    status = Path("/proc/self/status")

    def resident(what: str) -> float:
        line = next(line for line in status.read_text().splitlines() if line.startswith(what))
        return 1024.0 * float(line.split()[1])

    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)  # glibc only
    try:
        Path("/proc/self/clear_refs").write_text("5")  # resets the high-water mark
        before = resident("VmRSS")
        call()
        return {"bytes": resident("VmHWM") - before}
    except OSError:
        return {}
