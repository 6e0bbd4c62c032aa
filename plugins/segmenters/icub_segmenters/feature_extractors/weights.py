"""Reads weight files and says in one line what is wrong with one."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from torch import nn

from icub_core.errors import WeightsError

SHIPPED = Path(__file__).resolve().parent.parent / "weights"


def shipped_names() -> list[str]:
    """Names of the weights that come with the package."""
    return sorted(path.stem for path in SHIPPED.glob("*.safetensors"))


def read_safetensors(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """Read tensors and metadata of a safetensors file.

    Raises:
        WeightsError: When the file is missing, truncated or not safetensors.
    """
    if not path.is_file():
        raise WeightsError(f"no weight file {path}; shipped weights: {', '.join(shipped_names()) or 'none'}")
    try:
        with safe_open(path, framework="pt") as file:
            return {key: file.get_tensor(key) for key in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except (OSError, SafetensorError, ValueError) as error:
        raise WeightsError(f"{path} is truncated or not a safetensors file ({error})") from error


def read_any(path: Path) -> dict[str, torch.Tensor]:
    """Read a safetensors file, a ``torch.save`` file, or a Detectron2 ``.pkl``, without running pickled code.

    Checkpoints that hold the state dictionary under "model" or "state_dict" are unwrapped.

    Raises:
        WeightsError: When the file is missing, truncated, or holds anything but tensors.
    """
    if path.suffix == ".safetensors":
        return read_safetensors(path)[0]
    if not path.is_file():
        raise WeightsError(f"no weight file {path}; expected a .safetensors or .pth file")
    try:
        if path.suffix == ".pkl":
            content = _plain_pickle(path)
        else:
            content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch.load raises many unrelated types for a damaged file
        line = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise WeightsError(f"{path} is truncated or not a file of tensors ({line})") from error
    for key in ("model", "state_dict"):
        if isinstance(content, dict) and isinstance(content.get(key), dict):
            content = content[key]
    if not isinstance(content, dict) or not all(isinstance(value, torch.Tensor) for value in content.values()):
        raise WeightsError(f"{path} does not hold a state dictionary of tensors")
    return dict(content)


class _ArraysOnly(pickle.Unpickler):
    """Builds containers and numpy arrays; refuses every other name."""

    _allowed = frozenset(
        {("numpy", "ndarray"), ("numpy", "dtype"), ("_codecs", "encode")}
        | {(f"numpy.{core}.multiarray", "_reconstruct") for core in ("core", "_core")}
        | {(f"numpy.{core}.numeric", "_frombuffer") for core in ("core", "_core")}
    )

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in self._allowed:
            raise pickle.UnpicklingError(f"it names {module}.{name}")
        return super().find_class(module.replace("numpy.core", "numpy._core"), name)


def _plain_pickle(path: Path) -> Any:
    """Read nested dictionaries of numpy arrays, as Detectron2's model zoo has them; arrays become tensors."""
    with path.open("rb") as file:
        content = _ArraysOnly(file, encoding="latin1").load()
    model = content.get("model", content) if isinstance(content, dict) else content
    if not isinstance(model, dict):
        return model
    return {k: torch.from_numpy(np.array(v)) if isinstance(v, np.ndarray) else v for k, v in model.items()}


def fill(module: nn.Module, tensors: Mapping[str, torch.Tensor], origin: str) -> None:
    """Copy tensors into a module; every parameter and statistic must be there in the right shape.

    Args:
        module: What is filled.
        tensors: By the names of the module's state dictionary, any floating type.
        origin: File or source, for the message.

    Raises:
        WeightsError: Naming the first missing, unknown or wrongly shaped tensor.
    """
    own = {k: v for k, v in module.state_dict().items() if not k.endswith("num_batches_tracked")}
    given = {k: v for k, v in tensors.items() if not k.endswith("num_batches_tracked")}
    for key, value in own.items():
        if key not in given:
            raise WeightsError(f"{origin} lacks '{key}' {tuple(value.shape)}: it is of another architecture")
        if given[key].shape != value.shape:
            raise WeightsError(
                f"{origin}: '{key}' has shape {tuple(given[key].shape)}, expected {tuple(value.shape)}: "
                "it is of another architecture"
            )
        if not torch.isfinite(given[key]).all():
            raise WeightsError(f"{origin}: '{key}' holds NaN or infinite values")
    surplus = sorted(given.keys() - own.keys())
    if surplus:
        raise WeightsError(f"{origin} holds '{surplus[0]}', which this architecture lacks")
    module.load_state_dict({k: v.to(own[k].dtype) for k, v in given.items()}, strict=False)
