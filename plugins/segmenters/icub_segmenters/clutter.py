"""Copy-paste augmentation: taught objects are pasted into images of clutter.

An object that is shown in front of one background under one lamp would be learned together with both. Here its pixels
are pasted, rotated, resized and re-lit, into images of other things: positives get more backgrounds, and regions of the
clutter become negatives.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from icub_core.data import tight_boxes
from icub_core.errors import DataError
from icub_segmenters.procedure import STANDARD

DEFAULT_FOLDER = Path(__file__).with_name("assets") / "clutter"
REMEMBERED = 12
"""Cut-outs kept of each taught object, to be pasted beside others."""
SIDE_SHARES, DISTRACTORS_SIDE_SHARES = (0.12, 0.75), (0.1, 0.4)
"""Longest side of a pasted cut-out over the image's height."""
MIN_SIDE = 14
"""A cut-out is not shrunk below this many pixels."""
VISIBLE_SHARE = 0.5
"""A composite has no instance of which less than this share is visible."""


@dataclass(frozen=True, eq=False)
class Cutout:
    """An object's pixels: rgb (h, w, 3) uint8, mask (h, w) bool; the label of a distractor is ""."""

    label: str
    rgb: NDArray[np.uint8]
    mask: NDArray[np.bool_]

    @classmethod
    def of(cls, label: str, rgb: NDArray[np.uint8], mask: NDArray[np.bool_]) -> Cutout:
        """Cut the tight box of a not empty `mask` (H, W) out of `rgb` (H, W, 3)."""
        left, top, right, bottom = tight_boxes(mask[None])[0].astype(int)
        box = slice(top, bottom), slice(left, right)
        return cls(label, rgb[box].copy(), mask[box].copy())


@dataclass(frozen=True, eq=False)
class Composite:
    """A composite image.

    Attributes:
        rgb: (H, W, 3) uint8.
        instances: Visible parts of the taught objects, (label, (H, W) bool) each.
        distractors: Visible parts of other objects, (H, W) bool each: hard negatives.
    """

    rgb: NDArray[np.uint8]
    instances: tuple[tuple[str, NDArray[np.bool_]], ...]
    distractors: tuple[NDArray[np.bool_], ...] = ()


@dataclass(frozen=True, eq=False)
class ClutterPicture:
    """rgb (H, W, 3) uint8 and the number of the object at each pixel, objects (H, W) uint8, 0 for none."""

    rgb: NDArray[np.uint8]
    objects: NDArray[np.uint8]


class Compositor:
    """Makes images of a taught object among clutter, at times beside objects that were taught before."""

    def __init__(self, images: list[ClutterPicture], look_alikes: float = STANDARD.look_alikes) -> None:
        """Take images that show no taught object; their objects are pasted as distractors.

        Args:
            images: Backgrounds, with the objects on them.
            look_alikes: Share of the distractors that take on the taught object's colors, so that color alone does not
                decide.
        """
        if not images:
            raise DataError("there are no clutter images; expected at least one")
        self.images, self.look_alikes = images, look_alikes
        self.distractors = [
            Cutout.of("", image.rgb, image.objects == number)
            for image in images
            for number in np.unique(image.objects[image.objects > 0])
            if np.count_nonzero(image.objects == number) >= MIN_SIDE**2
        ]
        self.remembered: dict[str, list[Cutout]] = {}

    @classmethod
    def from_folder(cls, folder: Path | None = None, look_alikes: float = STANDARD.look_alikes) -> Compositor:
        """Read the JPEG images of a folder; None takes those that come with the package.

        A PNG of the same name holds the objects in an image: 0 for none, else the object's number.
        """
        folder = DEFAULT_FOLDER if folder is None else Path(folder)
        files = sorted(p for p in folder.glob("*") if p.suffix.lower() in (".jpg", ".jpeg"))
        if not files:
            raise DataError(f"no JPEG image in {folder}; expected images of clutter")
        images = []
        for file in files:
            rgb = np.ascontiguousarray(_read(file, cv2.IMREAD_COLOR)[:, :, ::-1])
            objects, numbers = np.zeros(rgb.shape[:2], np.uint8), file.with_suffix(".png")
            if numbers.exists():
                objects = _read(numbers, cv2.IMREAD_GRAYSCALE)
                if objects.shape != rgb.shape[:2]:
                    raise DataError(f"{numbers} is {objects.shape}; expected the image's {rgb.shape[:2]}")
            images.append(ClutterPicture(rgb, objects))
        return cls(images, look_alikes)

    def remember(self, cutout: Cutout, rng: np.random.Generator) -> None:
        """Keep a cut-out for later images; of each label a few are kept at random."""
        known = self.remembered.setdefault(cutout.label, [])
        if len(known) < REMEMBERED:
            known.append(cutout)
        elif rng.random() < 0.3:
            known[int(rng.integers(REMEMBERED))] = cutout

    def compose(self, cutout: Cutout, size: tuple[int, int], rng: np.random.Generator) -> Composite:
        """Paste `cutout`, up to two other remembered objects and some distractors into an image of (height, width)."""
        height, width = size
        image = self.images[int(rng.integers(len(self.images)))]
        background = cv2.resize(image.rgb, (width, height)).astype(np.uint8)
        objects = cv2.resize(image.objects, (width, height), interpolation=cv2.INTER_NEAREST)
        if rng.random() < 0.5:
            background, objects = background[:, ::-1], objects[:, ::-1]
        canvas = relit(background, rng)
        layers = [("", objects == number) for number in np.unique(objects[objects > 0])]
        areas = [int(mask.sum()) for _, mask in layers]
        for piece in self._drawn(cutout, rng):
            canvas, mask = _paste(canvas, transformed(piece, size, rng), rng)
            layers = [(label, seen & ~mask) for label, seen in layers] + [(piece.label, mask)]  # the newer is on top
            areas.append(int(mask.sum()))
        visible = [
            (label, mask)
            for (label, mask), area in zip(layers, areas, strict=True)
            if mask.sum() >= max(VISIBLE_SHARE * area, MIN_SIDE**2 / 2)
        ]
        return Composite(
            canvas,
            tuple((label, mask) for label, mask in visible if label),
            tuple(mask for label, mask in visible if not label),
        )

    def _drawn(self, cutout: Cutout, rng: np.random.Generator) -> list[Cutout]:
        """Choose what is pasted with `cutout`, in the order of pasting."""
        drawn = [cutout]
        others = [label for label in self.remembered if label != cutout.label]
        for label in rng.permutation(others)[: int(rng.integers(0, 3))]:
            drawn.append(self.remembered[label][int(rng.integers(len(self.remembered[label])))])
        if self.distractors:
            for i in rng.integers(0, len(self.distractors), int(rng.integers(1, 5))):
                distractor = self.distractors[i]
                drawn.append(in_colors_of(cutout, distractor, rng) if rng.random() < self.look_alikes else distractor)
        return [drawn[i] for i in rng.permutation(len(drawn))]


def _read(file: Path, flags: int) -> NDArray[np.uint8]:
    image = cv2.imread(str(file), flags)
    if image is None:
        raise DataError(f"{file} cannot be read as an image")
    return image.astype(np.uint8)


def relit(rgb: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Change brightness, contrast and tint of an image at random."""
    gain = rng.uniform(0.6, 1.35) * rng.normal(1.0, 0.05, 3)
    shift = rng.uniform(-12, 12)
    return np.clip(rgb.astype(np.float32) * gain + shift, 0, 255).astype(np.uint8)


def in_colors_of(model: Cutout, distractor: Cutout, rng: np.random.Generator) -> Cutout:
    """Repaint a distractor: its dark and bright parts take colors of two random pixels of the model."""
    palette = model.rgb[model.mask]
    dark, bright = palette[rng.integers(0, len(palette), 2)].astype(np.float32)
    gray = distractor.rgb.astype(np.float32).mean(axis=2)
    low, high = np.percentile(gray[distractor.mask], [5, 95])
    share = np.clip((gray - low) / max(high - low, 1.0), 0, 1)[:, :, None]
    if rng.random() < 0.5:  # one color, with the distractor's own light and shade
        painted = bright * (0.6 + 0.6 * share)
    else:
        painted = dark + (bright - dark) * share
    return Cutout(distractor.label, np.clip(painted, 0, 255).astype(np.uint8), distractor.mask)


def shaded(rgb: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Darken an image towards one side, as a lamp on the other side would."""
    height, width = rgb.shape[:2]
    angle, strength = rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.5)
    x, y = np.linspace(-1, 1, width), np.linspace(-1, 1, height)[:, None]
    light = 1 + strength * (np.cos(angle) * x + np.sin(angle) * y)
    return np.clip(rgb * light[:, :, None], 0, 255).astype(np.uint8)


def transformed(cutout: Cutout, size: tuple[int, int], rng: np.random.Generator) -> Cutout:
    """Rotate, resize and re-light a cut-out for an image of (height, width)."""
    h, w = cutout.mask.shape
    longest = max(rng.uniform(*(SIDE_SHARES if cutout.label else DISTRACTORS_SIDE_SHARES)) * size[0], MIN_SIDE)
    scale = longest / max(h, w)
    flags = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    w, h = max(round(scale * w), 2), max(round(scale * h), 2)
    rgb = cv2.resize(shaded(relit(cutout.rgb, rng), rng), (w, h), interpolation=flags)
    mask = cv2.resize(cutout.mask.astype(np.float32), (w, h), interpolation=flags)
    matrix = cv2.getRotationMatrix2D((w / 2, h / 2), float(rng.uniform(-40, 40)), 1.0)
    new_w, new_h = (int(np.ceil(v)) for v in np.abs(matrix[:, :2]) @ np.array([w, h]))
    matrix[:, 2] = matrix[:, 2] + np.array([new_w - w, new_h - h]) / 2
    rgb = cv2.warpAffine(rgb, matrix, (new_w, new_h), borderMode=cv2.BORDER_REPLICATE)
    mask = cv2.warpAffine(mask, matrix, (new_w, new_h))
    return Cutout(cutout.label, rgb.astype(np.uint8), mask > 0.5)


def _paste(
    canvas: NDArray[np.uint8], piece: Cutout, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Lay `piece` on `canvas` (H, W, 3) at a random place, at most a third outside; return it and the mask (H, W)."""
    height, width = canvas.shape[:2]
    h, w = piece.mask.shape
    top = int(rng.integers(-h // 6, max(height - h + h // 6, 1)))
    left = int(rng.integers(-w // 6, max(width - w + w // 6, 1)))
    rows = slice(max(top, 0), min(top + h, height))
    columns = slice(max(left, 0), min(left + w, width))
    inner = slice(rows.start - top, rows.stop - top), slice(columns.start - left, columns.stop - left)
    mask = np.zeros((height, width), dtype=np.bool_)
    mask[rows, columns] = piece.mask[inner]
    # soft edges: a hard seam would be a feature of every pasted object
    alpha = cv2.GaussianBlur(piece.mask.astype(np.float32), (0, 0), 0.7)[inner][:, :, None]
    result = canvas.copy()
    blend = alpha * piece.rgb[inner] + (1 - alpha) * canvas[rows, columns]
    result[rows, columns] = blend.astype(np.uint8)
    return result, mask
