"""Files of weights and of training checkpoints: safetensors with JSON beside the tensors, written in one step.

A file holds named tensors and a header, entries of JSON by name. What made weights, from what and how good they are,
stands on a card: a JSON file beside them. Nothing is ever pickled.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import nn

from icub_core.errors import CheckpointError, IcubError, WeightsError
from icub_core.files import write_atomically, write_text_atomically

Tensors = dict[str, torch.Tensor]


def write_tensors(path: Path, tensors: Mapping[str, torch.Tensor], header: Mapping[str, str] | None = None) -> None:
    """Write tensors and a header of texts to a safetensors file.

    Raises:
        CheckpointError: The file cannot be written; an older one stays as it was.
    """
    content = {name: tensor.detach().contiguous() for name, tensor in tensors.items()}

    def write(temporary: Path) -> None:
        try:
            save_file(content, temporary, None if header is None else dict(header))
        except SafetensorError as error:  # the library reports a full disk as an error of its own
            raise OSError(str(error)) from error

    write_atomically(path, write)


def read_tensors(path: Path, error: type[IcubError] = CheckpointError) -> tuple[Tensors, dict[str, str]]:
    """Return the tensors and the header of a safetensors file; raises `error` for a missing or truncated one."""
    if not path.is_file():
        raise error(f"there is no file {path}")
    try:
        with safe_open(path, framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except (OSError, SafetensorError, ValueError) as cause:
        raise error(f"{path} is truncated or not a safetensors file ({cause})") from cause


def entry(header: Mapping[str, str], name: str, path: Path, error: type[IcubError] = CheckpointError) -> Any:
    """Return a JSON entry of a header; raises `error` when it is missing or no JSON."""
    try:
        return json.loads(header[name])
    except (KeyError, ValueError) as cause:
        raise error(f"{path} was written by something else: its header has no entry '{name}'") from cause


def with_prefix(prefix: str, tensors: Mapping[str, torch.Tensor]) -> Tensors:
    """Put ``prefix.`` before every name."""
    return {f"{prefix}.{name}": tensor for name, tensor in tensors.items()}


def part(tensors: Mapping[str, torch.Tensor], prefix: str) -> Tensors:
    """Return the tensors whose names begin with ``prefix.``, without it."""
    start = f"{prefix}."
    return {name.removeprefix(start): tensor for name, tensor in tensors.items() if name.startswith(start)}


def fill(
    module: nn.Module, tensors: Mapping[str, torch.Tensor], origin: str, error: type[IcubError] = WeightsError
) -> None:
    """Copy tensors, of any floating type, into a module that has the same names and shapes.

    Raises:
        IcubError: Of the class `error`, naming `origin` and the first tensor that is missing, unknown or misshapen.
    """
    own = {k: v for k, v in module.state_dict().items() if not k.endswith("num_batches_tracked")}
    given = {k: v for k, v in tensors.items() if not k.endswith("num_batches_tracked")}
    for name, value in own.items():
        if name not in given:
            raise error(f"{origin} lacks '{name}' {tuple(value.shape)}: it is of another architecture")
        if given[name].shape != value.shape:
            raise error(
                f"{origin}: '{name}' has shape {tuple(given[name].shape)}, expected {tuple(value.shape)}: "
                "it is of another architecture"
            )
        if not torch.isfinite(given[name]).all():
            raise error(f"{origin}: '{name}' holds NaN or infinite values")
    surplus = sorted(given.keys() - own.keys())
    if surplus:
        raise error(f"{origin} holds '{surplus[0]}', which this architecture lacks")
    module.load_state_dict({k: v.to(own[k].dtype) for k, v in given.items()}, strict=False)


def adam_state(optimizer: torch.optim.Optimizer) -> Tensors:
    """Return the step and the moments of Adam or AdamW as ``NUMBER.NAME``, by the number of the parameter."""
    state = optimizer.state_dict()["state"]
    return {f"{number}.{name}": value for number, memory in state.items() for name, value in memory.items()}


def load_adam_state(optimizer: torch.optim.Optimizer, tensors: Mapping[str, torch.Tensor]) -> None:
    """Load what `adam_state` returned."""
    for number, parameter in enumerate(p for group in optimizer.param_groups for p in group["params"]):
        # the moments get the memory layout of their parameter, as the fused optimizer wants it
        memory = {
            name: torch.empty_like(parameter).copy_(value).detach() if value.ndim else value.clone()
            for name, value in part(tensors, str(number)).items()
        }
        if memory:
            optimizer.state[parameter] = memory


def write_card(path: Path, card: Mapping[str, Any]) -> None:
    """Write the card of weights as JSON."""
    write_text_atomically(path, json.dumps(card, indent=2) + "\n")


def read_card(path: Path) -> dict[str, Any]:
    """Return the card of weights; raises WeightsError when there is none."""
    if not path.is_file():
        raise WeightsError(f"there is no card {path}")
    card: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return card
