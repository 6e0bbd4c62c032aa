"""Minimal perception plugins: colors of sliding windows, ridge regression, nearest mean color."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import CheckpointError, DataError, NotFittedError
from icub_core.files import write_text_atomically
from icub_core.interfaces.feature_extractor import FeatureExtractor, ImageFeatures, RpnCells
from icub_core.interfaces.online_head import OnlineHead
from icub_core.interfaces.segmenter import Segmenter, UpdateReport
from icub_core.renames import renamed

GRID = 4
"""Side of the grid of colors that describes a region."""


class TinyFeatureExtractor(FeatureExtractor):
    """Regions are described by a grid of mean colors, their pixels by color and place; windows slide over the image.

    Args:
        mask_size: Side of a region's grid of mask pixels.
    """

    def __init__(self, mask_size: int = 14) -> None:
        self._mask_size = mask_size

    @property
    def region_dim(self) -> int:
        """Length of a region's feature vector."""
        return 3 * GRID * GRID

    @property
    def mask_dim(self) -> int:
        """Length of a mask pixel's feature vector: color, place."""
        return 5

    @property
    def mask_size(self) -> int:
        """Side of a region's grid of mask pixels."""
        return self._mask_size

    def extract(self, rgb: NDArray[np.uint8]) -> ImageFeatures:
        """Propose windows, the most contrasting first."""
        height, width = rgb.shape[:2]
        image = torch.from_numpy(rgb.astype(np.float32) / 255).permute(2, 0, 1)
        boxes = _windows(height, width)
        contrast = self._crop(image, boxes, GRID).flatten(1).std(dim=1)
        order = torch.argsort(contrast, descending=True, stable=True)
        return ImageFeatures(image, (height, width), boxes[order], contrast[order])

    def region_features(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Return the grid of colors of each box."""
        return self._crop(features.maps, boxes, GRID).flatten(1)

    def mask_features(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Return color and place of each pixel of each box."""
        colors = self._crop(features.maps, boxes, self._mask_size).permute(0, 2, 3, 1)
        line = torch.linspace(-1, 1, self._mask_size)
        y, x = torch.meshgrid(line, line, indexing="ij")
        place = torch.stack([x, y], dim=-1).expand(len(boxes), -1, -1, -1)
        return torch.cat([colors, place], dim=-1)

    def rpn_cells(self, features: ImageFeatures) -> RpnCells:
        """Return every window as a location with one anchor."""
        boxes = _windows(*features.image_size)
        sizes = (boxes[:, 2] - boxes[:, 0]).round(decimals=2).unique(return_inverse=True)[1]
        colors = self._crop(features.maps, boxes, GRID).flatten(1)
        return RpnCells(colors, boxes[:, None], sizes[:, None])

    def _crop(self, image: torch.Tensor, boxes: torch.Tensor, size: int) -> torch.Tensor:
        """Sample boxes (N, 4) of an image (3, H, W) on a grid: (N, 3, size, size)."""
        if len(boxes) == 0:
            return torch.zeros((0, 3, size, size))
        height, width = image.shape[1:]
        steps = (torch.arange(size) + 0.5) / size
        x = boxes[:, 0:1] + (boxes[:, 2:3] - boxes[:, 0:1]) * steps  # (N, size)
        y = boxes[:, 1:2] + (boxes[:, 3:4] - boxes[:, 1:2]) * steps
        gx = (2 * x / width - 1)[:, None, :].expand(-1, size, -1)
        gy = (2 * y / height - 1)[:, :, None].expand(-1, -1, size)
        batch = image.expand(len(boxes), -1, -1, -1)
        return F.grid_sample(batch, torch.stack([gx, gy], dim=-1), align_corners=False, padding_mode="border")


def _windows(height: int, width: int) -> torch.Tensor:
    """Return boxes (P, 4) of three sizes, half overlapping."""
    boxes = []
    for share in (0.2, 0.35, 0.6):
        side = share * min(height, width)
        for y in np.arange(0, height - side + 1, side / 2):
            for x in np.arange(0, width - side + 1, side / 2):
                boxes.append([x, y, x + side, y + side])
    return torch.tensor(boxes, dtype=torch.float32)


class TinyHead(OnlineHead):
    """Ridge regression with a constant.

    Args:
        penalty: Weight of the squared norm.
    """

    def __init__(self, penalty: float = 1e-3) -> None:
        self._penalty = penalty
        self._weights: torch.Tensor | None = None

    def fit(self, X: torch.Tensor, Y: torch.Tensor, sample_weight: torch.Tensor | None = None) -> None:
        """Solve the normal equations."""
        if not (torch.isfinite(X).all() and torch.isfinite(Y).all()):
            raise DataError("the samples hold NaN or infinite numbers; expected finite features and targets")
        A = _with_constant(X).double()
        scaled = A if sample_weight is None else A * sample_weight.double()[:, None]
        normal = scaled.T @ A + self._penalty * torch.eye(A.shape[1], dtype=torch.float64)
        self._weights = torch.linalg.solve(normal, scaled.T @ Y.double())

    def decision_function(self, X: torch.Tensor) -> torch.Tensor:
        """Return the scores."""
        if not torch.isfinite(X).all():
            raise DataError("the samples hold NaN or infinite numbers; expected finite features")
        return (_with_constant(X).double() @ self._fitted()).float()

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return the weights."""
        return {"weights": self._fitted().clone()}

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Take the weights."""
        if set(state) != {"weights"} or state["weights"].ndim != 2:
            raise CheckpointError(f"a tiny head's state has the keys {sorted(state)}; expected one matrix 'weights'")
        self._weights = state["weights"].clone()

    def _fitted(self) -> torch.Tensor:
        if self._weights is None:
            raise NotFittedError("the tiny head was not fitted; call fit first")
        return self._weights


def _with_constant(X: torch.Tensor) -> torch.Tensor:
    return torch.cat([X, torch.ones((len(X), 1), dtype=X.dtype)], dim=1)


@renamed(least_pixels="min_pixels")
class TinySegmenter(Segmenter):
    """A pixel belongs to the class whose mean color is nearest, if that is near enough.

    Args:
        tolerance: Distance between colors, each 0..1.
        min_pixels: Smaller masks are not reported.
    """

    def __init__(self, tolerance: float = 0.12, min_pixels: int = 20) -> None:
        self._tolerance = tolerance
        self._min_pixels = min_pixels
        self._observed: dict[str, list[NDArray[np.float64]]] = {}
        self._known: dict[str, NDArray[np.float64]] = {}

    def observe(self, frame: RgbdFrame, instances: Sequence[Instance]) -> None:
        """Remember the mean color of every mask."""
        for instance in instances:
            color = frame.rgb[instance.mask].mean(axis=0) / 255
            self._observed.setdefault(instance.label, []).append(color)

    def update(self) -> UpdateReport:
        """Average the colors."""
        start = perf_counter()
        self._known = {label: np.mean(colors, axis=0) for label, colors in self._observed.items()}
        samples = {label: len(colors) for label, colors in self._observed.items()}
        return UpdateReport(perf_counter() - start, {}, self.classes, samples)

    def segment(self, frame: RgbdFrame) -> tuple[Instance, ...]:
        """Compare every pixel with every class."""
        if not self._known:
            raise NotFittedError("the tiny segmenter knows nothing yet; call observe and update first")
        found = []
        for label, color in self._known.items():
            distance = np.linalg.norm(frame.rgb / 255.0 - color, axis=-1)
            mask = distance < self._tolerance
            if mask.sum() >= self._min_pixels:
                found.append(Instance.from_mask(label, mask, score=float(1 - distance[mask].mean())))
        return tuple(sorted(found, key=lambda instance: -instance.score))

    @property
    def classes(self) -> tuple[str, ...]:
        """Classes known since the last update."""
        return tuple(self._known)

    def save(self, path: Path) -> None:
        """Write the colors as JSON."""
        content = {label: list(color) for label, color in self._known.items()}
        write_text_atomically(Path(path) / "colors.json", json.dumps(content))

    def load(self, path: Path) -> None:
        """Read the colors."""
        try:
            content = json.loads((Path(path) / "colors.json").read_text(encoding="utf-8"))
            known = {str(label): np.array(color, dtype=np.float64).reshape(3) for label, color in content.items()}
        except (OSError, ValueError, AttributeError) as cause:
            raise CheckpointError(f"{path} holds no colors of a tiny segmenter: {cause}") from cause
        self._known = known
        self._observed = {label: [color] for label, color in known.items()}
