"""Images, depth, masks and JSON from files that may be anything, with one clear line where they cannot be used."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from icub_core.errors import DataError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
_BROKEN = (OSError, SyntaxError, ValueError, EOFError, IndexError, KeyError, TypeError, MemoryError,
           struct.error, zlib.error, Image.DecompressionBombError)  # fmt: skip
"""What decoders are seen to raise for files that are not what they claim to be."""


def require_folder(path: Path, dataset: str, expected: Sequence[str]) -> Path:
    """Return `path` when it is a folder with all entries `expected`; DataError says what was expected otherwise."""
    path = Path(path).expanduser()
    layout = f"expected the folder of {dataset}" + (f" with {', '.join(expected)}" if expected else "")
    if not path.is_dir():
        raise DataError(f"{path} is not a folder; {layout}")
    missing = [name for name in expected if not (path / name).exists()]
    if missing:
        raise DataError(f"{path} has no {missing[0]}; {layout}")
    return path


def read_json(path: Path) -> Any:
    """Parse a JSON file; DataError names it when it is missing, truncated or not JSON."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"cannot read {path}: {_reason(error)}; expected JSON") from error


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """Decode an image of any size and mode to (H, W, 3) uint8.

    Gray is repeated, alpha and palettes are dropped, 16 bits become 8. A rotation in the EXIF data is not applied:
    annotations count the stored pixels.

    Raises:
        DataError: Missing, truncated, or no image.
    """
    try:
        with Image.open(path) as image:
            image.load()
            if image.mode.startswith("I") or image.mode == "F":  # PIL would clip these to 255 instead of scaling
                gray = np.asarray(image).astype(np.float64)
                if image.mode != "F":
                    gray = gray / 257.0
                rgb = np.repeat(np.clip(gray, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
            else:
                rgb = np.array(image.convert("RGB"))
    except _BROKEN as error:
        raise DataError(f"cannot read {path}: {_reason(error)}; expected an image") from error
    return rgb


def read_channel(path: Path) -> NDArray[np.generic]:
    """Decode a one-channel image (mask, index, 16-bit depth) to (H, W), values untouched; further channels are dropped.

    Raises:
        DataError: Missing, truncated, or no image.
    """
    try:
        with Image.open(path) as image:
            image.load()
            values = np.array(image)
    except _BROKEN as error:
        raise DataError(f"cannot read {path}: {_reason(error)}; expected an image") from error
    return values[..., 0] if values.ndim == 3 else values


def read_mask(path: Path, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Decode a mask (H, W) bool, true where the image is not 0.

    Raises:
        DataError: Unreadable, or not of `size` (H, W), the size of the image it belongs to.
    """
    mask = read_channel(path) != 0
    if mask.shape != size:
        raise DataError(f"the mask {path} is {mask.shape[1]}x{mask.shape[0]}; expected its image's {size[1]}x{size[0]}")
    return np.asarray(mask)


def read_depth(path: Path, scale: float, size: tuple[int, int]) -> NDArray[np.float32]:
    """Decode a depth image (H, W) float32 meters, `scale` meters per unit.

    Raises:
        DataError: Unreadable, or not of `size` (H, W).
    """
    depth = np.asarray(read_channel(path), dtype=np.float64) * scale
    if depth.shape != size:
        shape = f"{depth.shape[1]}x{depth.shape[0]}"
        raise DataError(f"the depth image {path} is {shape}; expected its image's {size[1]}x{size[0]}")
    return depth.astype(np.float32)


def find_image(folder: Path, stem: str) -> Path:
    """Return the image called `stem` with any known suffix; DataError names what was looked for."""
    for suffix in IMAGE_SUFFIXES:
        if (folder / f"{stem}{suffix}").exists():
            return folder / f"{stem}{suffix}"
    raise DataError(
        f"{folder} has no image '{stem}'; expected one of {', '.join(stem + s for s in IMAGE_SUFFIXES[:2])}"
    )


def list_images(folder: Path) -> list[Path]:
    """Return the images of a folder, sorted by name; no subfolders."""
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith("."))


def _reason(error: BaseException) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror.lower()
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__
