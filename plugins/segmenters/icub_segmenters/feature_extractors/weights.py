"""Reads weight files of several formats; errors say in one line what is wrong with a file."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import torch

from icub_core.errors import WeightsError
from icub_support.weights import read_tensors

SHIPPED = Path(__file__).resolve().parent.parent / "weights"


def shipped_names() -> list[str]:
    """Names of the weights that come with the package."""
    return sorted(path.stem for path in SHIPPED.glob("*.safetensors"))


def weights_file(name: str) -> Path:
    """Return the file of shipped weights, or `name` itself where it is a path."""
    return SHIPPED / f"{name}.safetensors" if name == Path(name).stem else Path(name)


def read_safetensors(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """Read tensors and header of a safetensors file.

    Raises:
        WeightsError: When the file is missing, truncated or not safetensors; names the weights that are shipped.
    """
    if not path.is_file():
        raise WeightsError(f"no weight file {path}; shipped weights: {', '.join(shipped_names()) or 'none'}")
    return read_tensors(path, WeightsError)


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
