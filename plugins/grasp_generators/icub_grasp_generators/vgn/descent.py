"""Gradient steps for a given time, over any number of calls: the loop of both of VGN's trainings."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import nn

from icub_grasp_generators.vgn.checkpoints import restore, save


def descend(
    network: nn.Module,
    optimizer: torch.optim.Optimizer,
    checkpoint: Path,
    seconds: float,
    loss_of_step: Callable[[int], torch.Tensor],
    progress: Callable[[float, str], None],
    *,
    save_every: float,
    largest_gradient: float | None = None,
) -> None:
    """Train for `seconds` over all calls, going on from the checkpoint; the rate falls to zero along a cosine.

    Args:
        network: Trained in place.
        optimizer: Of its parameters; its rate is the one to begin with.
        checkpoint: File that is gone on from and kept.
        seconds: For all calls together; one step is done at least.
        loss_of_step: Called with the number of the step.
        progress: Told the finished share and the running loss.
        save_every: Seconds between two checkpoints.
        largest_gradient: Norm that gradients are clipped to; None leaves them.
    """
    step, spent = restore(checkpoint, network, optimizer)
    begun = saved = time.monotonic()
    running = np.nan
    while (used := spent + time.monotonic() - begun) < seconds or step == 0:
        share = min(used / seconds, 1.0)
        for group in optimizer.param_groups:
            group["lr"] = optimizer.defaults["lr"] * 0.5 * (1 + np.cos(np.pi * share))
        loss = loss_of_step(step)
        optimizer.zero_grad()
        loss.backward()
        if largest_gradient is not None:
            nn.utils.clip_grad_norm_(network.parameters(), largest_gradient)
        optimizer.step()
        step += 1
        running = loss.item() if np.isnan(running) else 0.98 * running + 0.02 * loss.item()
        progress(share, f"step {step}, loss {running:.3f}")
        if time.monotonic() - saved > save_every:
            save(checkpoint, network, optimizer, step, used)
            saved = time.monotonic()
    save(checkpoint, network, optimizer, step, max(spent, used))
