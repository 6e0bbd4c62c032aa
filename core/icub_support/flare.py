"""The stack of image features that tasks show and policies keep in memory (Flare, thesis reference 177)."""

from __future__ import annotations

import torch

HISTORY = 3
"""Images in a stack."""


def flare(features: torch.Tensor) -> torch.Tensor:
    """Stack features (..., 3, F) of t-2, t-1, t: (..., 5 F) = f(t-2), f(t-2)-f(t-1), f(t-1), f(t-1)-f(t), f(t).

    The differences are older minus newer, as in the released code.
    """
    oldest, older, newest = features.unbind(dim=-2)
    return torch.cat([oldest, oldest - older, older, older - newest, newest], dim=-1)
