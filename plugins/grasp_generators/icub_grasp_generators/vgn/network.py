"""The network of VGN: a signed distance field in, quality, rotation and width for every voxel out.

Layer names and shapes are those of the original, so that its weight file fits.

Source: Breyer et al. 2020, "Volumetric Grasping Network", and its released code.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import nn
from torch.nn import functional

from icub_core.errors import WeightsError, unknown_name
from icub_core.files import write_atomically
from icub_grasp_generators.vgn.classifier import GraspClassifier
from icub_grasp_generators.vgn.volume import RESOLUTION

SHIPPED = Path(__file__).resolve().parent / "weights"
GRIPPER, HAND = "gripper", "hand"
"""What a voxel's rotation belongs to: a parallel-jaw gripper, or the palm point of the iCub's right hand."""
_HEADER = "icub"
CLASSIFIER = "judge."
"""What the names of the grasp-quality classifier's tensors begin with."""


@dataclass(frozen=True)
class Meaning:
    """What the outputs of trained weights mean.

    Attributes:
        pose: ``"gripper"`` or ``"hand"``.
    """

    pose: str = GRIPPER


class _Encoder(nn.Module):
    """Halves the grid three times."""

    def __init__(self, channels: tuple[int, ...], kernels: tuple[int, ...]) -> None:
        super().__init__()
        self.conv1, self.conv2, self.conv3 = (
            nn.Conv3d(channels[i], channels[i + 1], kernels[i], stride=2, padding=kernels[i] // 2) for i in range(3)
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        for conv in (self.conv1, self.conv2, self.conv3):
            x = functional.relu(conv(x))
        return x


class _Decoder(nn.Module):
    """Doubles it twice; the last doubling is the heads'."""

    def __init__(self, channels: tuple[int, ...], kernels: tuple[int, ...]) -> None:
        super().__init__()
        self.conv1, self.conv2, self.conv3 = (
            nn.Conv3d(channels[i], channels[i + 1], kernels[i], padding=kernels[i] // 2) for i in range(3)
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return features (B, 16, 20, 20, 20) of (B, 64, 5, 5, 5)."""
        return functional.relu(doubled(self.middle(x), *folded(*_of(self.conv3))))

    def middle(self, x: torch.Tensor) -> torch.Tensor:
        """Return features (B, 32, 10, 10, 10) of (B, 64, 5, 5, 5)."""
        x = functional.interpolate(functional.relu(self.conv1(x)), RESOLUTION // 4)
        return functional.relu(self.conv2(x))


class VgnNetwork(nn.Module):
    """313,238 parameters."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = _Encoder((1, 16, 32, 64), (5, 3, 3))
        self.decoder = _Decoder((64, 64, 32, 16), (3, 3, 5))
        self.conv_qual = nn.Conv3d(16, 1, 5, padding=2)
        self.conv_rot = nn.Conv3d(16, 4, 5, padding=2)
        self.conv_width = nn.Conv3d(16, 1, 5, padding=2)

    def forward(self, tsdf: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return quality (B, 1, 40, 40, 40) in 0..1, unit quaternions xyzw (B, 4, ...), widths (B, 1, ...) in voxels.

        Args:
            tsdf: (B, 1, 40, 40, 40).
        """
        out = doubled(self.decoder(self.encoder(tsdf)), *folded(*self.heads()))
        return torch.sigmoid(out[:, :1]), functional.normalize(out[:, 1:5], dim=1), out[:, 5:]

    def heads(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return weight (6, 16, 5, 5, 5) and bias (6,) of the three heads together: logit, quaternion, width."""
        heads = (self.conv_qual, self.conv_rot, self.conv_width)
        return torch.cat([h.weight for h in heads]), torch.cat([h.bias for h in heads if h.bias is not None])

    def at_voxels(self, tsdf: torch.Tensor, scene: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
        """Return logit, raw quaternion and width (G, 6) of single voxels: all that training needs, and cheaper.

        The last convolution of the decoder is only computed in the box around the voxels, the heads only at them.

        Args:
            tsdf: (B, 1, 40, 40, 40).
            scene: (G,) which of the B.
            index: (G, 3) voxels.
        """
        x = self.decoder.middle(self.encoder(tsdf))
        low = (index.amin(dim=0) - 2).clamp_min(0) // 4
        high = ((index.amax(dim=0) + 2) // 4 + 1).clamp_max(RESOLUTION // 4)
        di, dj, dk = (slice(int(lo), int(hi) + 2) for lo, hi in zip(low, high, strict=True))  # with a border
        x = functional.pad(x, 6 * (1,))[:, :, di, dj, dk]
        x = functional.relu(doubled(x, *folded(*_of(self.decoder.conv3)), padding=0))
        x = functional.pad(x, 6 * (1,)).permute(0, 2, 3, 4, 1)
        i, j, k = ((index // 2 - 2 * low)[:, :, None] + torch.arange(3)).unbind(dim=1)
        patch = x[scene[:, None, None, None], i[:, :, None, None], j[:, None, :, None], k[:, None, None, :]]
        weight, bias = folded(*self.heads())
        parity = (index % 2) @ torch.tensor([4, 2, 1])
        weight = weight.permute(0, 2, 3, 4, 1).reshape(8, 6, -1)[parity]
        return torch.bmm(weight, patch.flatten(1)[:, :, None])[:, :, 0] + bias[:6]


_TAPS = torch.tensor(
    [
        [[1.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.0, 1.0]],
        [[1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0, 1.0]],
    ]
)
"""By parity of the output: which of three coarse cells the five taps of a kernel on the doubled grid fall on."""


def folded(weight: torch.Tensor, bias: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Fold a kernel (O, C, 5, 5, 5) for a grid that repeats every cell twice into eight for the grid itself.

    Where cells repeat, five taps fall on three cells, and which ones depends on the output's parity alone: the same
    numbers for a fifth of the arithmetic.

    Returns:
        (8 O, C, 3, 3, 3), output parities (i, j, k) slowest, and (8 O,).
    """
    taps = _TAPS.to(weight.dtype)
    eight = torch.einsum("pai,qbj,rdk,ocijk->pqrocabd", taps, taps, taps, weight)
    return eight.flatten(0, 3), bias.repeat(8)


def doubled(x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor, padding: int = 1) -> torch.Tensor:
    """Convolve the doubled grid of `x` (B, C, D, H, W) with folded kernels: (B, O, 2 D, 2 H, 2 W)."""
    out = functional.conv3d(x, weight, bias, padding=padding)
    batch, channels, d, h, w = out.shape
    out = out.reshape(batch, 2, 2, 2, channels // 8, d, h, w).permute(0, 4, 5, 1, 6, 2, 7, 3)
    return out.reshape(batch, channels // 8, 2 * d, 2 * h, 2 * w)


def _of(conv: nn.Module) -> tuple[torch.Tensor, torch.Tensor]:
    assert isinstance(conv, nn.Conv3d)
    assert conv.bias is not None
    return conv.weight, conv.bias


def save_network(path: Path, network: VgnNetwork, meaning: Meaning, classifier: GraspClassifier | None = None) -> None:
    """Write weights and what they mean to one safetensors file, in one step, with a hand's classifier, if any."""
    tensors = {name: value.detach().contiguous() for name, value in network.state_dict().items()}
    if classifier is not None:
        tensors |= {CLASSIFIER + name: value.detach().contiguous() for name, value in classifier.state_dict().items()}
    header = {_HEADER: json.dumps(asdict(meaning))}
    write_atomically(path, lambda temporary: save_file(tensors, temporary, header))


def load_network(weights: str) -> tuple[VgnNetwork, Meaning, GraspClassifier | None]:
    """Read a network for inference, with the grasp-quality classifier of hand poses where the file has one.

    Args:
        weights: Name of shipped weights, the path of a safetensors file of this project, or the path of the original
            weight file (``.pth``, a dictionary of tensors; nothing else in it is executed).

    Raises:
        WeightsError: Missing, truncated or foreign weights.
    """
    path = Path(weights)
    if weights == path.stem:
        path = SHIPPED / f"{weights}.safetensors"
        if not path.is_file():
            names = sorted(p.stem for p in SHIPPED.glob("*.safetensors"))
            raise WeightsError(unknown_name("shipped VGN weights", weights, names))
    if not path.is_file():
        raise WeightsError(f"there is no VGN weight file {path}")
    tensors, meaning = _read_safetensors(path) if path.suffix == ".safetensors" else (_read_pickle(path), Meaning())
    network, classifier = VgnNetwork(), None
    _fill(network, tensors, path)
    if any(name.startswith(CLASSIFIER) for name in tensors):
        classifier = GraspClassifier()
        _fill(classifier, {n.removeprefix(CLASSIFIER): v for n, v in tensors.items() if n.startswith(CLASSIFIER)}, path)
    return network, meaning, classifier


def _fill(network: nn.Module, tensors: Mapping[str, torch.Tensor], path: Path) -> None:
    own = network.state_dict()
    for name, value in own.items():
        found = tensors.get(name)
        if not isinstance(found, torch.Tensor) or found.shape != value.shape:
            shape = tuple(found.shape) if isinstance(found, torch.Tensor) else None
            raise WeightsError(f"{path}: tensor '{name}' has shape {shape}; expected {tuple(value.shape)}")
    network.load_state_dict({name: tensors[name] for name in own})
    network.eval().requires_grad_(False)


def _read_safetensors(path: Path) -> tuple[Mapping[str, torch.Tensor], Meaning]:
    try:
        with safe_open(path, framework="pt") as file:
            header = json.loads((file.metadata() or {})[_HEADER])
            return {key: file.get_tensor(key) for key in file.keys()}, Meaning(**header)  # noqa: SIM118 - not a dict
    except (SafetensorError, KeyError, TypeError, json.JSONDecodeError, OSError) as error:
        raise WeightsError(f"{path} is not a readable VGN weight file of this project: {error}") from error


def _read_pickle(path: Path) -> Mapping[str, torch.Tensor]:
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # the unpickler raises whatever the bytes lead to
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise WeightsError(f"{path} is not a readable PyTorch weight file: {reason}") from error
    if not isinstance(content, Mapping):
        raise WeightsError(f"{path} holds a {type(content).__name__}; expected a dictionary of tensors")
    return content
