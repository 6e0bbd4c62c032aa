"""COCO: instances in photographs, also for any set that is written in COCO's format."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import DataError
from icub_core.geometry import pinhole
from icub_datasets.base import FileDataset, OnError, Sample
from icub_datasets.reading import read_json, read_rgb, require_folder

UNKNOWN_FOVY = 0.741
"""Vertical field of view that stands in for the unknown one of a photograph (depth is 0, so nothing depends on it)."""


@dataclass(frozen=True)
class _Item:
    image: Path
    size: tuple[int, int]
    annotations: tuple[tuple[str, Any], ...]  # label, segmentation as it stands in the file


class Coco(FileDataset[_Item]):
    """Photographs with polygons or run lengths; no depth.

    Layout: ``annotations/instances_SPLIT.json`` and the images in a folder named like the split, such as ``val2017``.
    Crowds (``iscrowd``) and annotations whose polygon covers no pixel are left out. Classes are the categories by
    rising id.

    Args:
        path: Folder of the data set.
        split: Such as ``"train2017"`` or ``"val2017"``.
        on_error: ``"refuse"`` or ``"skip"`` frames that cannot be read, see `FileDataset`.
    """

    def __init__(self, path: Path, split: str = "val2017", on_error: OnError = "refuse") -> None:
        path = require_folder(path, "COCO", ["annotations"])
        file = path / "annotations" / f"instances_{split}.json"
        if not file.is_file():
            known = ", ".join(_splits(path)) or "none"
            raise DataError(f"{path} has no split '{split}'; expected {file.name}. Found: {known}")
        require_folder(path, f"COCO's split '{split}'", [split])
        content = read_json(file)
        try:
            categories = {int(c["id"]): str(c["name"]) for c in sorted(content["categories"], key=lambda c: c["id"])}
            by_image: dict[int, list[tuple[str, Any]]] = defaultdict(list)
            for annotation in content["annotations"]:
                if not annotation.get("iscrowd", 0):
                    label = categories[int(annotation["category_id"])]
                    by_image[int(annotation["image_id"])].append((label, annotation["segmentation"]))
            items = [
                _Item(
                    path / split / Path(image["file_name"]).name,
                    (int(image["height"]), int(image["width"])),
                    tuple(by_image[int(image["id"])]),
                )
                for image in content["images"]
            ]
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise DataError(f"{file} is not in COCO's format: {type(error).__name__} {error}") from error
        super().__init__(tuple(categories.values()), items, on_error)
        self._path = path

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the annotation files."""
        return _splits(self._path)

    def _read(self, item: _Item) -> Sample:
        rgb = read_rgb(item.image)
        size = (rgb.shape[0], rgb.shape[1])
        if size != item.size:
            raise DataError(f"{item.image} is {size[1]}x{size[0]}; expected {item.size[1]}x{item.size[0]}")
        instances = []
        for label, segmentation in item.annotations:
            mask = _decode(segmentation, size, item.image)
            if mask.any():
                instances.append(Instance.from_mask(label, mask))
        frame = RgbdFrame(rgb, np.zeros(size, np.float32), pinhole(size[1], size[0], UNKNOWN_FOVY), np.eye(4))
        return frame, tuple(instances)


def _splits(path: Path) -> tuple[str, ...]:
    files = sorted((path / "annotations").glob("instances_*.json"))
    return tuple(file.stem.removeprefix("instances_") for file in files)


def _decode(segmentation: Any, size: tuple[int, int], image: Path) -> NDArray[np.bool_]:
    """Turn polygons, or compressed or plain run lengths, into a mask (H, W)."""
    from faster_coco_eval import mask as rle

    height, width = size
    try:
        if isinstance(segmentation, list):
            polygons = [[float(v) for v in p] for p in segmentation if len(p) >= 6]
            if not polygons:
                return np.zeros(size, dtype=np.bool_)
            encoded = rle.merge(rle.frPyObjects(polygons, height, width))
        else:
            if [int(v) for v in segmentation["size"]] != [height, width]:
                raise ValueError(f"run lengths of size {segmentation['size']}")
            counts = segmentation["counts"]
            if isinstance(counts, list):
                if sum(counts) != height * width or min(counts, default=0) < 0:
                    raise ValueError("run lengths that do not fill the image")
                values = np.arange(len(counts)) % 2 == 1
                return np.repeat(values, counts).reshape((height, width), order="F")
            encoded = {"size": [height, width], "counts": counts}
        return np.asarray(rle.decode(encoded)).reshape(height, width).astype(np.bool_)
    except Exception as error:  # the library raises many types for malformed run lengths
        raise DataError(f"the annotation of {image} cannot be decoded: {type(error).__name__} {error}") from error
