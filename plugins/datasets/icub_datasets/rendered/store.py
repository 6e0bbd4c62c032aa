"""Rendered frames kept on disk, under a name that changes with everything they depend on."""

from __future__ import annotations

import hashlib
import logging
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import CheckpointError
from icub_core.files import cache_dir, write_atomically

logger = logging.getLogger(__name__)

DEPTH_UNIT = 1e-4
"""Meters a unit of the stored depth; 16 bits reach 6.5 m, what lies farther counts as not measured."""
_MAX_UNITS = 65535


def digest(*parts: Any) -> str:
    """Hash numbers, texts, arrays, containers, dataclasses, and files (by content) to 24 hexadecimal digits."""
    hasher = hashlib.sha256()

    def add(part: Any) -> None:
        if isinstance(part, np.ndarray):
            raw = f"{part.dtype}{part.shape}".encode() + np.ascontiguousarray(part).tobytes()
        elif isinstance(part, Path):
            raw = part.read_bytes()
        elif is_dataclass(part):
            add(type(part).__name__)
            for member in fields(part):
                add(getattr(part, member.name))
            return
        elif isinstance(part, (tuple, list)):
            add(f"sequence of {len(part)}")
            for member in part:
                add(member)
            return
        elif part is None or isinstance(part, (bool, int, float, str, bytes)):
            raw = repr(part).encode()
        else:
            raise TypeError(f"cannot hash a {type(part).__name__}")
        hasher.update(len(raw).to_bytes(8, "little") + raw)

    add(parts)
    return hasher.hexdigest()[:24]


@dataclass(frozen=True, eq=False)
class StoredFrame:
    """One rendering in the form in which it is kept.

    Attributes:
        rgb: (H, W, 3) uint8.
        depth: (H, W) uint16, `DEPTH_UNIT` meters.
        segmentation: (H, W) uint8, 0 background, k the k-th of `labels`.
        labels: Names of the instances.
        intrinsics: (3, 3).
        T_world_camera: (4, 4).
        stamp: Seconds.
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.uint16]
    segmentation: NDArray[np.uint8]
    labels: tuple[str, ...]
    intrinsics: NDArray[np.float64]
    T_world_camera: NDArray[np.float64]
    stamp: float

    @classmethod
    def pack(cls, frame: RgbdFrame, segmentation: NDArray[np.uint8], labels: tuple[str, ...]) -> StoredFrame:
        """Round the depth of a fresh rendering, so that reading it back from disk gives the same numbers."""
        units = np.round(frame.depth / DEPTH_UNIT)
        units[~np.isfinite(units) | (units > _MAX_UNITS)] = 0
        return cls(
            frame.rgb, units.astype(np.uint16), segmentation, labels, frame.intrinsics, frame.T_world_camera,
            frame.stamp,
        )  # fmt: skip

    def unpack(self) -> tuple[RgbdFrame, tuple[Instance, ...]]:
        """Return the frame and its instances."""
        depth = (self.depth * DEPTH_UNIT).astype(np.float32)
        frame = RgbdFrame(self.rgb, depth, self.intrinsics, self.T_world_camera, self.stamp)
        instances = tuple(Instance.from_mask(n, self.segmentation == k) for k, n in enumerate(self.labels, start=1))
        return frame, instances


class FrameStore:
    """A folder of frames, one file each; frames of other settings lie in other folders.

    Two processes may fill it at once. A file that cannot be read back is rendered again; where nothing can be written
    (full disk, read-only home) frames are rendered each time, with one warning.
    """

    def __init__(self, key: str) -> None:
        self._folder = cache_dir() / "rendered" / key
        self._writable = True

    def get(self, index: int) -> StoredFrame | None:
        """Read a frame, or None when it is not there or damaged."""
        path = self._path(index)
        try:
            with np.load(path, allow_pickle=False) as content:
                return StoredFrame(
                    rgb=np.ascontiguousarray(_decode(content["rgb"])[..., ::-1]),
                    depth=_decode(content["depth"]),
                    segmentation=_decode(content["segmentation"]),
                    labels=tuple(str(name) for name in content["labels"]),
                    intrinsics=content["intrinsics"],
                    T_world_camera=content["T_world_camera"],
                    stamp=float(content["stamp"]),
                )
        except FileNotFoundError:
            return None
        except Exception as error:  # a damaged archive raises many types; none of them is worth stopping for
            logger.warning("rendering again what cannot be read back: %s (%s)", path, error)
            return None

    def put(self, index: int, frame: StoredFrame) -> None:
        """Keep a frame; a failure is logged once and otherwise ignored."""
        if not self._writable:
            return

        def write(temporary: Path) -> None:
            with temporary.open("wb") as file:
                np.savez(
                    file,
                    rgb=_encode(frame.rgb[..., ::-1]),
                    depth=_encode(frame.depth),
                    segmentation=_encode(frame.segmentation),
                    labels=np.array(frame.labels, dtype=np.str_),
                    intrinsics=frame.intrinsics,
                    T_world_camera=frame.T_world_camera,
                    stamp=np.float64(frame.stamp),
                )

        try:
            write_atomically(self._path(index), write)
        except CheckpointError as error:
            self._writable = False
            logger.warning("rendered frames are not kept: %s", error)

    def _path(self, index: int) -> Path:
        return self._folder / f"{index:06d}.npz"


def _encode(image: NDArray[Any]) -> NDArray[np.uint8]:
    ok, content = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not ok:
        raise OSError("PNG encoding failed")
    return content.ravel()


def _decode(content: NDArray[np.uint8]) -> NDArray[Any]:
    image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError("not a PNG image")
    return image
