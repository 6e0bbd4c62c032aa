"""Files of tensors and JSON, written atomically, never pickled."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from icub_core.errors import CheckpointError, WeightsError
from icub_core.files import write_atomically

HEADER = "icub"


def write_tensors(path: Path, tensors: dict[str, torch.Tensor], header: dict[str, Any]) -> None:
    """Write tensors and a JSON header to one safetensors file; what stood there stays unless all is written.

    Raises:
        CheckpointError: The file cannot be written (a full disk, no permission).
    """

    def write(temporary: Path) -> None:
        try:
            save_file({k: v.detach().contiguous() for k, v in tensors.items()}, temporary, {HEADER: json.dumps(header)})
        except SafetensorError as error:  # the library reports a full disk as its own error
            raise OSError(str(error)) from error

    write_atomically(path, write)


def read_tensors(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Read what `write_tensors` wrote.

    Raises:
        CheckpointError: Missing, truncated, or not one of our files.
    """
    if not path.is_file():
        raise CheckpointError(f"there is no file {path}")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 - not a dict
            return tensors, json.loads(metadata[HEADER])
    except (SafetensorError, KeyError, json.JSONDecodeError, OSError) as error:
        raise CheckpointError(f"{path} is not a readable checkpoint of this project: {error}") from error


def load_into(module: torch.nn.Module, tensors: dict[str, torch.Tensor], prefix: str, path: Path) -> None:
    """Copy the tensors named `prefix`... into a module; WeightsError names the first that is missing or misshapen."""
    own = module.state_dict()
    for name, value in own.items():
        found = tensors.get(prefix + name)
        if found is None or found.shape != value.shape:
            shape = None if found is None else tuple(found.shape)
            raise WeightsError(f"{path}: tensor '{prefix}{name}' has shape {shape}; expected {tuple(value.shape)}")
    module.load_state_dict({name: tensors[prefix + name] for name in own})


def adam_state(optimizer: torch.optim.Optimizer, prefix: str) -> dict[str, torch.Tensor]:
    """Return an Adam optimizer's moments as tensors."""
    state = optimizer.state_dict()["state"]
    return {f"{prefix}{i}.{name}": value for i, entry in state.items() for name, value in entry.items()}


def load_adam_state(optimizer: torch.optim.Optimizer, tensors: dict[str, torch.Tensor], prefix: str) -> None:
    """Restore what `adam_state` returned."""
    state = optimizer.state_dict()
    state["state"] = {}
    for key, value in tensors.items():
        if key.startswith(prefix):
            index, _, name = key.removeprefix(prefix).partition(".")
            state["state"].setdefault(int(index), {})[name] = value
    optimizer.load_state_dict(state)
