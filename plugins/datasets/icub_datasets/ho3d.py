"""HO-3D, version 2: objects held by a hand in front of a fixed camera."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import ConfigError, DataError, unknown_name
from icub_datasets.base import FileDataset, OnError, Sample
from icub_datasets.reading import find_image, list_images, read_rgb, require_folder
from icub_datasets.unpickle import load_plain_pickle

HO3D_CLASSES = (
    "003_cracker_box", "004_sugar_box", "006_mustard_bottle", "010_potted_meat_can", "011_banana",
    "021_bleach_cleanser", "025_mug", "035_power_drill", "037_scissors",
)  # fmt: skip
_OBJECT_OF_PREFIX = {
    "ABF": "021_bleach_cleanser", "BB": "011_banana", "GPMF": "010_potted_meat_can", "GSF": "037_scissors",
    "MC": "003_cracker_box", "MDF": "035_power_drill", "ND": "035_power_drill", "SB": "021_bleach_cleanser",
    "ShSu": "004_sugar_box", "SiBF": "011_banana", "SiS": "004_sugar_box", "SM": "006_mustard_bottle",
    "SMu": "025_mug", "SS": "004_sugar_box",
}  # fmt: skip
"""A sequence's name is its object's letters and a number."""
Split = Literal["train", "val", "test"]
SEQUENCES: dict[Split, tuple[str, ...]] = {
    "train": (
        "ABF10", "ABF11", "ABF12", "ABF13", "BB10", "BB11", "BB12", "BB13", "GPMF10", "GPMF11", "GPMF12", "GPMF13",
        "GSF10", "GSF11", "GSF12", "GSF13", "MC1", "MC2", "MC4", "MC5", "MDF10", "MDF11", "MDF12", "MDF13", "ShSu10",
        "ShSu12", "ShSu13", "ShSu14", "SM2", "SM3", "SM4", "SMu1", "SMu40", "SMu41",
    ),
    "val": ("ABF13", "BB13", "GPMF13", "GSF13", "MC5", "MDF13", "ShSu14", "SM4", "SMu41"),
    "test": ("ABF14", "BB14", "GPMF14", "GSF14", "MC6", "MDF14", "SiS1", "SM5", "SMu42"),
}  # fmt: skip
"""Thesis, appendix B of chapter 11."""
STEP = {"train": 2, "val": 5, "test": 5}
DEPTH_UNIT = 0.00012498664727900177
"""Meters per unit of the 16-bit depth."""
OBJECT_BLUE = 100
"""Least blue of an object's pixel; the hand is red, the rest black, and JPEG blurs both."""


@dataclass(frozen=True)
class _Item:
    sequence: Path
    frame: str


class Ho3d(FileDataset[_Item]):
    """Nine hand-held objects, one in a frame; splits of the thesis.

    Layout: ``train/SEQUENCE`` with ``rgb``, ``depth``, ``meta`` (downloads ``HO3D_v2``) and ``seg``
    (``HO3D_v2_segmentations_rendered``, unpacked into the same folders). All splits come from the training sequences,
    since the evaluation ones carry no masks:

    - ``train``: every second frame of 34 sequences (20265; the thesis drops 109 of them that show no object, which
      come here without instances);
    - ``test``: every fifth of 9 other sequences (2020);
    - ``val``: every fifth of 9 training sequences (2160).

    The masks are rendered at lower resolution and enlarged linearly, as in the thesis's code. The world frame is the
    camera's.

    Args:
        path: Folder of the data set.
        split: ``"train"``, ``"val"`` or ``"test"``.
        on_error: ``"refuse"`` or ``"skip"`` frames that cannot be read, see `FileDataset`.

    Source: thesis 11.4.2 and appendix 11.11.
    """

    def __init__(self, path: Path, split: Split = "train", on_error: OnError = "refuse") -> None:
        if split not in SEQUENCES:
            raise ConfigError(unknown_name("split of ho3d", split, SEQUENCES))
        path = require_folder(path, "HO-3D v2", ["train"])
        folders = [path / "train" / name for name in sorted(SEQUENCES[split], key=str.casefold)]
        items: list[_Item] = []
        for folder in folders:
            require_folder(folder, f"one of the {len(folders)} sequences of HO-3D's split '{split}'", _PARTS)
            items += [_Item(folder, image.stem) for image in list_images(folder / "seg")]
        # the step runs on through the joined list; it does not start again in each sequence
        super().__init__(HO3D_CLASSES, items[:: STEP[split]], on_error)

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the thesis's splits."""
        return tuple(SEQUENCES)

    def _read(self, item: _Item) -> Sample:
        rgb = read_rgb(find_image(item.sequence / "rgb", item.frame))
        size = (rgb.shape[0], rgb.shape[1])
        depth = _read_depth(find_image(item.sequence / "depth", item.frame), size)
        mask = _read_object_mask(find_image(item.sequence / "seg", item.frame), size)
        instances = (Instance.from_mask(_object_of(item.sequence.name), mask),) if mask.any() else ()
        return RgbdFrame(rgb, depth, _intrinsics(item.sequence), np.eye(4)), instances


_PARTS = ("rgb", "depth", "meta", "seg")


def _object_of(sequence: str) -> str:
    match = re.fullmatch(r"([A-Za-z]+)\d+", sequence)
    if match is None or match[1] not in _OBJECT_OF_PREFIX:
        raise DataError(unknown_name("sequence family of HO-3D", sequence, _OBJECT_OF_PREFIX))
    return _OBJECT_OF_PREFIX[match[1]]


def _read_depth(path: Path, size: tuple[int, int]) -> NDArray[np.float32]:
    """Decode depth stored in a color image: low byte in red, high byte in green."""
    color = read_rgb(path).astype(np.uint32)
    if color.shape[:2] != size:
        shape = f"{color.shape[1]}x{color.shape[0]}"
        raise DataError(f"the depth image {path} is {shape}; expected its image's {size[1]}x{size[0]}")
    return (DEPTH_UNIT * (color[..., 0] + 256 * color[..., 1])).astype(np.float32)


def _read_object_mask(path: Path, size: tuple[int, int]) -> NDArray[np.bool_]:
    color = cv2.resize(read_rgb(path), (size[1], size[0]), interpolation=cv2.INTER_LINEAR).astype(np.int32)
    blue = color[..., 2]
    return np.asarray((blue >= OBJECT_BLUE) & (blue > color[..., 0]) & (blue > color[..., 1]))


@lru_cache(maxsize=256)
def _intrinsics(sequence: Path) -> NDArray[np.float64]:
    """Return the camera matrix of a sequence: the first that its annotations give (some frames have none)."""
    for file in sorted((sequence / "meta").glob("*.pkl")):
        content = load_plain_pickle(file)
        matrix = content.get("camMat") if isinstance(content, dict) else None
        if matrix is None:
            continue
        intrinsics = np.asarray(matrix, dtype=np.float64)
        if intrinsics.shape != (3, 3):
            raise DataError(f"{file}: camMat is {intrinsics.shape}; expected (3, 3)")
        intrinsics.setflags(write=False)
        return intrinsics
    raise DataError(f"{sequence / 'meta'} gives no camMat; expected at least one annotated frame of HO-3D")
