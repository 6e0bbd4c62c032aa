"""Float32 matrix products by the fastest library on the machine.

On AMD processors the MKL that torch ships takes its slower AVX2 path and reaches less than half of what oneDNN does at
the same accuracy. The only public way to oneDNN is torch's matmul precision "medium", which also allows bfloat16 on
processors with matrix units: so it is switched on only where a probe shows full float32 accuracy.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator
from pathlib import Path

import torch

PROBE_ACCURACY = 2e-6
"""Relative error that a float32 product may have; bfloat16 would give 2e-3."""


def _is_intel() -> bool:
    try:
        return "GenuineIntel" in Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return True  # not Linux: leave torch's choice alone


@functools.cache
def onednn_is_better() -> bool:
    """Return True if float32 products should go through oneDNN on this machine: deterministic, measured by accuracy."""
    if _is_intel() or not torch.backends.mkldnn.is_available():
        return False
    generator = torch.Generator().manual_seed(0)
    A, B = torch.randn(256, 256, generator=generator), torch.randn(256, 256, generator=generator)
    exact = A.double() @ B.double()
    with product_precision("medium"):
        error = torch.linalg.norm((A @ B).double() - exact) / torch.linalg.norm(exact)
    return bool(error < PROBE_ACCURACY)


@contextlib.contextmanager
def product_precision(name: str) -> Iterator[None]:
    """Within this context torch's float32 matmul precision is `name`: ``"highest"``, ``"high"`` or ``"medium"``."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(name)
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


@contextlib.contextmanager
def fast_products(device: torch.device | str = "cpu") -> Iterator[None]:
    """Within this context float32 products are exact to float32 and as fast as the machine allows.

    On a GPU TensorFloat-32 is off: kernel distances cannot bear its 10 bits.
    """
    name = "medium" if torch.device(device).type == "cpu" and onednn_is_better() else "highest"
    with product_precision(name), torch.no_grad():
        yield
