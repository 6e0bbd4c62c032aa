"""Files of policies and of their trainings: tensors, and one JSON header."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from icub_support import weights

HEADER = "icub"


def write_tensors(path: Path, tensors: Mapping[str, torch.Tensor], header: Mapping[str, Any]) -> None:
    """Write tensors and a JSON header; CheckpointError, and what stood there stays, where that fails."""
    weights.write_tensors(path, tensors, {HEADER: json.dumps(header)})


def read_tensors(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Read what `write_tensors` wrote; CheckpointError for a file that is missing, truncated or another's."""
    tensors, header = weights.read_tensors(path)
    stated: dict[str, Any] = weights.entry(header, HEADER, path)
    return tensors, stated
