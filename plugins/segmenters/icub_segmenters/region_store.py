"""A table of described regions, which all classes share: the features of each region are kept once."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from icub_core.errors import CheckpointError, DataError

BACKGROUND = -1
PRIORITY_STREAM = 0x9E3779B9
"""Added to the seed of priorities: others seed by image number too, and a shared seed would tie the two draws."""
GROWTH = 1.25
"""A full store grows by this factor: slack memory stays under a quarter."""


@dataclass(frozen=True, eq=False)
class Regions:
    """Described regions of one image.

    Attributes:
        features: (n, d) float32.
        boxes: (n, 4) where they are, pixels.
        targets: (n, 4) the true box of a positive, anything for others.
        label: (n,) int64: number of the class of which the region is a positive, or BACKGROUND.
        near: (n,) int64: number of the class whose instance it overlaps too much to be that class's negative, or
            BACKGROUND. Every positive is near its own class.
    """

    features: torch.Tensor
    boxes: torch.Tensor
    targets: torch.Tensor
    label: torch.Tensor
    near: torch.Tensor

    def __len__(self) -> int:
        return len(self.features)

    def take(self, rows: torch.Tensor) -> Regions:
        """Return the named rows."""
        return Regions(self.features[rows], self.boxes[rows], self.targets[rows], self.label[rows], self.near[rows])


_COLUMNS = ("features", "boxes", "targets", "label", "near", "image", "priority")


class RegionStore:
    """A growing table of regions; row numbers are what classes, batches and buffers refer to.

    Each row gets a random number when it comes, its priority. The rows of lowest priority among any group are a
    uniform sample of that group, whatever other rows are dropped later (see `sampling`).
    """

    def __init__(self, dim: int, seed: int = 0) -> None:
        """Start empty for features of `dim` numbers; `seed` and an image's number decide its rows' priorities."""
        self.dim, self.seed = dim, seed
        self.images = 0
        self._size = 0
        self._table = {
            "features": torch.empty(0, dim),
            "boxes": torch.empty(0, 4),
            "targets": torch.empty(0, 4),
            "label": torch.empty(0, dtype=torch.int64),
            "near": torch.empty(0, dtype=torch.int64),
            "image": torch.empty(0, dtype=torch.int64),
            "priority": torch.empty(0, dtype=torch.float64),
        }

    def __len__(self) -> int:
        return self._size

    @property
    def features(self) -> torch.Tensor:
        """(n, dim) features: a view, not to be changed."""
        return self._table["features"][: self._size]

    @property
    def boxes(self) -> torch.Tensor:
        """(n, 4) boxes."""
        return self._table["boxes"][: self._size]

    @property
    def targets(self) -> torch.Tensor:
        """(n, 4) true boxes of positives."""
        return self._table["targets"][: self._size]

    @property
    def label(self) -> torch.Tensor:
        """(n,) class of which a row is a positive, or BACKGROUND."""
        return self._table["label"][: self._size]

    @property
    def near(self) -> torch.Tensor:
        """(n,) class of which a row must not be a negative, or BACKGROUND."""
        return self._table["near"][: self._size]

    @property
    def image(self) -> torch.Tensor:
        """(n,) number of the image a row comes from."""
        return self._table["image"][: self._size]

    @property
    def priority(self) -> torch.Tensor:
        """(n,) float64 uniform in 0..1, drawn when the row came."""
        return self._table["priority"][: self._size]

    @property
    def nbytes(self) -> int:
        """Memory of the whole table, slack included."""
        return sum(column.nbytes for column in self._table.values())

    def append(self, regions: Regions) -> torch.Tensor:
        """Add the regions of one more image, which may be none, and return their row numbers (n,)."""
        if regions.features.shape[1:] != (self.dim,):
            raise DataError(f"regions have features {tuple(regions.features.shape)}; expected (n, {self.dim})")
        if not bool(torch.isfinite(regions.features).all()):
            raise DataError(f"the features of image {self.images} are not finite; it is left out")
        count = len(regions)
        self._reserve(self._size + count)
        rows = slice(self._size, self._size + count)
        for name in ("features", "boxes", "targets", "label", "near"):
            self._table[name][rows] = getattr(regions, name)
        self._table["image"][rows] = self.images
        generator = torch.Generator().manual_seed(PRIORITY_STREAM + self.seed * 1_000_003 + self.images)
        self._table["priority"][rows] = torch.rand(count, generator=generator, dtype=torch.float64)
        self._size += count
        self.images += 1
        return torch.arange(rows.start, rows.stop)

    def keep(self, rows: torch.Tensor) -> None:
        """Keep these rows alone, numbered anew in their order, without unused memory."""
        self._table = {name: column[rows] for name, column in self._table.items()}
        self._size = len(rows)

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return every column and the number of images."""
        state = {name: column[: self._size].clone() for name, column in self._table.items()}
        return {**state, "images": torch.tensor(self.images)}

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Load what `state_dict` returned; CheckpointError, and nothing changes, for anything else."""
        if set(state) != {*_COLUMNS, "images"}:
            raise CheckpointError(f"the region store has columns {sorted(state)}; expected {sorted(_COLUMNS)}")
        n = len(state["label"])
        for name, column in self._table.items():
            if state[name].shape != (n, *column.shape[1:]) or state[name].dtype != column.dtype:
                raise CheckpointError(
                    f"column '{name}' of the region store is {tuple(state[name].shape)} {state[name].dtype}; "
                    f"expected {(n, *column.shape[1:])} {column.dtype}"
                )
        self._table = {name: state[name].clone() for name in _COLUMNS}
        self._size, self.images = n, int(state["images"])

    def _reserve(self, size: int) -> None:
        capacity = len(self._table["label"])
        if size <= capacity:
            return
        capacity = max(size, int(GROWTH * capacity))
        for name, column in self._table.items():
            grown = column.new_empty(capacity, *column.shape[1:])
            grown[: self._size] = column[: self._size]
            self._table[name] = grown
