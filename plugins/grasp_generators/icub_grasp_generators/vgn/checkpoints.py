"""Checkpoints of a training: network, optimizer, step and time spent, in one safetensors file."""

from __future__ import annotations

from pathlib import Path

import torch
from safetensors.torch import load_file, save_file
from torch import nn

from icub_core.files import write_atomically


def save(path: Path, network: nn.Module, optimizer: torch.optim.Optimizer, step: int, spent: float) -> None:
    """Write where a training stands, in one step.

    Args:
        path: Of the file.
        network: Its weights.
        optimizer: Adam or AdamW.
        step: Steps done.
        spent: Seconds used, over all calls.
    """
    tensors = {f"network.{k}": v.detach().contiguous() for k, v in network.state_dict().items()}
    for i, entry in optimizer.state_dict()["state"].items():
        tensors |= {f"adam.{i}.{k}": v.detach().clone().contiguous() for k, v in entry.items()}
    tensors |= {"step": torch.tensor(step), "spent": torch.tensor(spent)}
    write_atomically(path, lambda temporary: save_file(tensors, temporary))


def restore(path: Path, network: nn.Module, optimizer: torch.optim.Optimizer) -> tuple[int, float]:
    """Bring network and optimizer to where `save` left them; returns steps done and seconds used, 0 without a file."""
    if not path.exists():
        return 0, 0.0
    tensors = load_file(path)
    network.load_state_dict({k.removeprefix("network."): v for k, v in tensors.items() if k.startswith("network.")})
    state = optimizer.state_dict()
    for key, value in tensors.items():
        if key.startswith("adam."):
            _, number, name = key.split(".", 2)
            state["state"].setdefault(int(number), {})[name] = value
    optimizer.load_state_dict(state)
    return int(tensors["step"]), float(tensors["spent"])


def restored_steps(path: Path) -> int:
    """Return the steps done at a checkpoint."""
    return int(load_file(path)["step"])
