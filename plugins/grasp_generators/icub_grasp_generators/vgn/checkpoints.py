"""Checkpoints of a training: network, optimizer, step and time spent, in one safetensors file."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import nn

from icub_support.weights import adam_state, fill, load_adam_state, part, read_tensors, with_prefix, write_tensors


def save(path: Path, network: nn.Module, optimizer: torch.optim.Optimizer, step: int, spent: float) -> None:
    """Write where a training stands, in one step.

    Args:
        path: Of the file.
        network: Its weights.
        optimizer: Adam or AdamW.
        step: Steps done.
        spent: Seconds used, over all calls.
    """
    tensors = {**with_prefix("network", network.state_dict()), **with_prefix("adam", adam_state(optimizer))}
    write_tensors(path, {**tensors, "step": torch.tensor(step), "spent": torch.tensor(spent)})


def restore(path: Path, network: nn.Module, optimizer: torch.optim.Optimizer) -> tuple[int, float]:
    """Bring network and optimizer to where `save` left them; returns steps done and seconds used, 0 without a file."""
    if not path.exists():
        return 0, 0.0
    tensors, _ = read_tensors(path)
    fill(network, part(tensors, "network"), str(path))
    load_adam_state(optimizer, part(tensors, "adam"))
    return int(tensors["step"]), float(tensors["spent"])


def restored_steps(path: Path) -> int:
    """Return the steps done at a checkpoint."""
    return int(read_tensors(path)[0]["step"])
