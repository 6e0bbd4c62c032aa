"""Anybody's images with masks, in a plain folder."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import DataError
from icub_core.geometry import pinhole
from icub_datasets.base import FileDataset, OnError, Sample
from icub_datasets.reading import list_images, read_depth, read_json, read_mask, read_rgb, require_folder

UNKNOWN_FOVY = 0.741
"""Vertical field of view of the iCub's camera (42.46 degrees), where no camera.json says better."""
MILLIMETRE = 1e-3


@dataclass(frozen=True)
class _Item:
    image: Path
    masks: tuple[tuple[str, Path], ...]


class ImageFolder(FileDataset[_Item]):
    """A folder of images and of one mask file per instance, named by its class.

    Layout::

        images/kitchen_01.jpg             any size; gray and alpha are fine
        masks/kitchen_01/cup.png          0 outside the object; the image's size
        masks/kitchen_01/cup.2.png        a second cup
        masks/kitchen_02/                 empty or absent: nothing in this image
        depth/kitchen_01.png              optional, 16 bits
        camera.json                       optional: {"cam_K": [9 numbers], "depth_scale": millimeters per unit}
        train.txt, test.txt, ...          optional: image names without suffix, one per line

    Args:
        path: The folder.
        split: ``"all"``, or the name of a list such as ``"train"`` for ``train.txt``.
        on_error: ``"refuse"`` or ``"skip"`` frames that cannot be read, see `FileDataset`.
    """

    def __init__(self, path: Path, split: str = "all", on_error: OnError = "refuse") -> None:
        path = require_folder(path, "images with masks", ["images", "masks"])
        by_name = {image.stem: image for image in list_images(path / "images")}
        if not by_name:
            raise DataError(f"{path / 'images'} holds no images; expected png, jpg, bmp, tif or webp files")
        all_items = {name: _Item(image, _masks_of(path / "masks" / name)) for name, image in by_name.items()}
        orphans = sorted({p.name for p in (path / "masks").iterdir() if p.is_dir()} - set(by_name))
        if orphans:
            raise DataError(f"{path / 'masks' / orphans[0]} belongs to no image; expected images/{orphans[0]}.*")
        # classes come from all images, so that every split of a folder has the same
        classes = sorted({label for item in all_items.values() for label, _ in item.masks})
        if not classes:
            raise DataError(f"{path / 'masks'} holds no mask; expected masks/IMAGE/LABEL.png")
        items = list(all_items.values()) if split == "all" else [all_items[n] for n in _names(path, split, by_name)]
        super().__init__(classes, items, on_error)
        self._path = path
        self._camera = _read_camera(path / "camera.json")

    @property
    def splits(self) -> tuple[str, ...]:
        """``"all"``, and the names of the lists in the folder."""
        return _splits(self._path)

    def _read(self, item: _Item) -> Sample:
        rgb = read_rgb(item.image)
        size = (rgb.shape[0], rgb.shape[1])
        depth_file = self._path / "depth" / f"{item.image.stem}.png"
        matrix, unit = self._camera
        depth = read_depth(depth_file, unit, size) if depth_file.exists() else np.zeros(size, dtype=np.float32)
        intrinsics = pinhole(size[1], size[0], UNKNOWN_FOVY) if matrix is None else matrix
        instances = []
        for label, file in item.masks:
            mask = read_mask(file, size)
            if not mask.any():
                raise DataError(f"the mask {file} is empty; expected the pixels of '{label}' to be other than 0")
            instances.append(Instance.from_mask(label, mask))
        return RgbdFrame(rgb, depth, intrinsics, np.eye(4)), tuple(instances)


def _masks_of(folder: Path) -> tuple[tuple[str, Path], ...]:
    if not folder.is_dir():
        return ()
    return tuple((re.sub(r"\.\d+$", "", file.stem), file) for file in list_images(folder))


def _splits(path: Path) -> tuple[str, ...]:
    return "all", *sorted(file.stem for file in path.glob("*.txt"))


def _names(path: Path, split: str, known: dict[str, Path]) -> list[str]:
    file = path / f"{split}.txt"
    if Path(split).name != split or not file.is_file():
        splits = ", ".join(_splits(path))
        raise DataError(
            f"{path} has no split '{split}'; expected one of {splits} (a list NAME.txt makes the split NAME)"
        )
    names = file.read_text(encoding="utf-8", errors="replace").split()
    for name in names:
        if name not in known:
            raise DataError(f"{file} names '{name}', which is not in {path / 'images'}")
    return names


def _read_camera(file: Path) -> tuple[NDArray[np.float64] | None, float]:
    """Return intrinsics (None when unknown) and meters per depth unit (1 mm when unknown)."""
    if not file.exists():
        return None, MILLIMETRE
    content: Any = read_json(file)
    try:
        return np.array(content["cam_K"], dtype=np.float64).reshape(3, 3), MILLIMETRE * float(content["depth_scale"])
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{file}: expected cam_K (9 numbers) and depth_scale (millimeters per unit)") from error
