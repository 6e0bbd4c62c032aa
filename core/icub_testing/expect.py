"""Comparisons that fail with a ContractError saying what was expected and what was got."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from icub_core.errors import ContractError, IcubError


def expect(condition: object, expected: str, got: object) -> None:
    """Raise ContractError unless `condition` holds."""
    if not condition:
        raise ContractError(f"expected {expected}; got {got}")


def expect_raises(
    error: type[Exception] | tuple[type[Exception], ...], call: Callable[[], Any], when: str
) -> Exception:
    """Raise ContractError unless `call` raises `error`; returns what was raised."""
    kinds = error if isinstance(error, tuple) else (error,)
    names = " or ".join(kind.__name__ for kind in kinds)
    try:
        result = call()
    except kinds as raised:
        if isinstance(raised, IcubError):
            expect(
                str(raised).strip() and "\n" not in str(raised).strip(),
                f"one line of explanation {when}",
                repr(str(raised)),
            )
        return raised
    except Exception as raised:
        raise ContractError(f"expected {names} {when}; got {type(raised).__name__}: {raised}") from raised
    raise ContractError(f"expected {names} {when}; got {' '.join(repr(result).split())[:80]}")


def expect_same(first: Any, second: Any, what: str) -> None:
    """Raise ContractError unless two arrays, tensors, or plain values are exactly equal."""
    if isinstance(first, torch.Tensor):
        first, second = first.detach().cpu().numpy(), second.detach().cpu().numpy()
    if isinstance(first, np.ndarray):
        expect(first.shape == second.shape, f"{what} with the same shape", f"{first.shape} and {second.shape}")
        if not np.array_equal(first, second, equal_nan=first.dtype.kind == "f"):
            difference = np.abs(np.asarray(first, dtype=np.float64) - np.asarray(second, dtype=np.float64)).max()
            raise ContractError(f"expected {what} to be identical; got a largest difference of {difference:.3g}")
        return
    expect(first == second, f"{what} to be identical", f"{first!r} and {second!r}")


def expect_close(first: Any, second: Any, tolerance: float, what: str) -> None:
    """Raise ContractError unless two arrays or tensors differ by `tolerance` at most."""
    first, second = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    expect(first.shape == second.shape, f"{what} with the same shape", f"{first.shape} and {second.shape}")
    if first.size:
        difference = np.abs(first - second).max()
        expect(difference <= tolerance, f"{what} within {tolerance:g}", f"a largest difference of {difference:.3g}")


def expect_tensor(value: Any, shape: tuple[int, ...], what: str) -> None:
    """Raise ContractError unless `value` is a finite float32 tensor of `shape` without gradient."""
    expect(isinstance(value, torch.Tensor), f"{what} to be a torch.Tensor", type(value).__name__)
    expect(tuple(value.shape) == shape, f"{what} of shape {shape}", tuple(value.shape))
    expect(value.dtype == torch.float32, f"{what} of type float32", value.dtype)
    expect(not value.requires_grad, f"{what} without a gradient", "requires_grad=True")
    expect(bool(torch.isfinite(value).all()), f"{what} to be finite", "NaN or infinite numbers")
