"""YCB-Video in the layout of the BOP challenge."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import ConfigError, DataError, unknown_name
from icub_core.geometry import invert, is_rigid, make_transform
from icub_datasets.base import FileDataset, OnError, Sample
from icub_datasets.reading import find_image, list_images, read_depth, read_json, read_mask, read_rgb, require_folder

YCB_VIDEO_CLASSES = (
    "002_master_chef_can", "003_cracker_box", "004_sugar_box", "005_tomato_soup_can", "006_mustard_bottle",
    "007_tuna_fish_can", "008_pudding_box", "009_gelatin_box", "010_potted_meat_can", "011_banana", "019_pitcher_base",
    "021_bleach_cleanser", "024_bowl", "025_mug", "035_power_drill", "036_wood_block", "037_scissors",
    "040_large_marker", "051_large_clamp", "052_extra_large_clamp", "061_foam_brick",
)  # fmt: skip
"""By BOP object number, from 1."""
Split = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = get_args(Split)
TRAIN_STEP = 10
VALIDATION_FRAMES = 1000
VALIDATION_SEED = 0
KEYFRAME_FILES = ("keyframe.txt", "test/keyframe.txt", "image_sets/keyframe.txt")
MILLIMETRE = 1e-3


@dataclass(frozen=True)
class _Item:
    scene: Path
    image: int


class YcbVideo(FileDataset[_Item]):
    """21 table-top objects with occlusion; splits of the thesis.

    Layout: ``train_real/SSSSSS``, ``test/SSSSSS`` with ``rgb``, ``depth``, ``mask_visib``, ``scene_gt.json``,
    ``scene_gt_info.json``, ``scene_camera.json`` (the downloads ``ycbv_train_real`` and ``ycbv_test_all``), and the
    list ``keyframe.txt`` (lines like ``0048/000001`` or ``000048 000001``) of the original data set, at the top or in
    ``test``.

    - ``train``: every tenth frame of the training sequences in order (11320).
    - ``test``: the key frames (2949).
    - ``val``: 1000 frames drawn from the test sequences outside the key frames. The thesis's own draw is not
      published in its text; here it is numpy's generator with seed 0.

    Instances are the visible parts; an object that is hidden entirely is left out. The world frame is the one the
    sequence's camera poses refer to; without such poses it is the camera's.

    Args:
        path: Folder of the data set.
        split: ``"train"``, ``"val"`` or ``"test"``.
        on_error: ``"refuse"`` or ``"skip"`` frames that cannot be read, see `FileDataset`.

    Source: thesis 10.4.1 and 11.4.2; BOP data set format.
    """

    def __init__(self, path: Path, split: Split = "train", on_error: OnError = "refuse") -> None:
        if split not in SPLITS:
            raise ConfigError(unknown_name("split of ycb_video", split, SPLITS))
        folder = "train_real" if split == "train" else "test"
        self._path = require_folder(path, "YCB-Video in BOP layout", [folder])
        frames = _all_frames(self._path / folder)
        if split == "train":
            items = frames[::TRAIN_STEP]
        else:
            keyframes = _read_keyframes(self._path)
            _check_present(keyframes, frames, self._path / folder)
            items = keyframes
            if split == "val":
                chosen = set(keyframes)
                others = [f for f in frames if f not in chosen]
                order = np.random.default_rng(VALIDATION_SEED).permutation(len(others))[:VALIDATION_FRAMES]
                items = [others[i] for i in sorted(order)]
        super().__init__(YCB_VIDEO_CLASSES, items, on_error)

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the thesis's splits."""
        return SPLITS

    def _read(self, item: _Item) -> Sample:
        scene = _scene(item.scene)
        name = f"{item.image:06d}"
        rgb = read_rgb(find_image(item.scene / "rgb", name))
        size = (rgb.shape[0], rgb.shape[1])
        camera = scene.camera(item)
        depth = read_depth(find_image(item.scene / "depth", name), camera.depth_scale, size)
        instances = []
        for number, label, visible in scene.objects(item):
            if not visible:
                continue
            mask = read_mask(item.scene / "mask_visib" / f"{name}_{number:06d}.png", size)
            if mask.any():
                instances.append(Instance.from_mask(label, mask))
        frame = RgbdFrame(rgb, depth, camera.intrinsics, camera.T_world_camera)
        return frame, tuple(instances)


@dataclass(frozen=True)
class _Camera:
    intrinsics: NDArray[np.float64]
    T_world_camera: NDArray[np.float64]
    depth_scale: float  # meters per unit


class _Scene:
    """The three JSON files of one scene."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._truth = _of_images(folder / "scene_gt.json")
        self._info = _of_images(folder / "scene_gt_info.json")
        self._cameras = _of_images(folder / "scene_camera.json")

    def objects(self, item: _Item) -> list[tuple[int, str, bool]]:
        """Return number, class and whether anything is visible, for each object of an image."""
        truth, info = (_entry(d, item.image, self._folder / f) for d, f in (
            (self._truth, "scene_gt.json"), (self._info, "scene_gt_info.json"),
        ))  # fmt: skip
        try:
            found = []
            for number, (entry, more) in enumerate(zip(truth, info, strict=True)):
                object_id = int(entry["obj_id"])
                if not 1 <= object_id <= len(YCB_VIDEO_CLASSES):
                    raise DataError(
                        f"{self._folder / 'scene_gt.json'}: image {item.image} has object {object_id}; expected 1 to "
                        f"{len(YCB_VIDEO_CLASSES)} of YCB-Video"
                    )
                visible = int(more.get("px_count_visib", 1)) > 0 and min(more["bbox_visib"][2:]) > 0
                found.append((number, YCB_VIDEO_CLASSES[object_id - 1], visible))
            return found
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise DataError(
                f"{self._folder}: scene_gt.json and scene_gt_info.json do not fit for image {item.image}; expected "
                "lists of equal length with obj_id and bbox_visib"
            ) from error

    def camera(self, item: _Item) -> _Camera:
        """Return intrinsics, pose and depth unit of an image."""
        file = self._folder / "scene_camera.json"
        entry = _entry(self._cameras, item.image, file)
        try:
            intrinsics = np.array(entry["cam_K"], dtype=np.float64).reshape(3, 3)
            T_world_camera = np.eye(4)
            if "cam_R_w2c" in entry:
                rotation = np.array(entry["cam_R_w2c"], dtype=np.float64).reshape(3, 3)
                left, _, right = np.linalg.svd(rotation)  # printed with few digits: the nearest true rotation
                translation = MILLIMETRE * np.array(entry["cam_t_w2c"], dtype=np.float64).reshape(3)
                T_world_camera = invert(make_transform(left @ right, translation))
            scale = MILLIMETRE * float(entry["depth_scale"])
        except (KeyError, TypeError, ValueError, np.linalg.LinAlgError) as error:
            raise DataError(f"{file}: image {item.image} needs cam_K (9 numbers) and depth_scale") from error
        if not is_rigid(T_world_camera):
            raise DataError(f"{file}: cam_R_w2c of image {item.image} is no rotation")
        return _Camera(intrinsics, T_world_camera, scale)


@lru_cache(maxsize=8)
def _scene(folder: Path) -> _Scene:
    """Frames are mostly read in order: a few scenes in memory (tens of megabytes each) suffice."""
    return _Scene(folder)


def _of_images(file: Path) -> dict[int, Any]:
    content = read_json(file)
    try:
        return {int(image): entry for image, entry in content.items()}
    except (AttributeError, ValueError) as error:
        raise DataError(f"{file}: expected an object with image numbers as keys") from error


def _entry(content: dict[int, Any], image: int, file: Path) -> Any:
    if image not in content:
        raise DataError(f"{file} has no entry for image {image}")
    return content[image]


def _all_frames(folder: Path) -> list[_Item]:
    """List the frames of every scene in order."""
    scenes = sorted(p for p in folder.iterdir() if p.is_dir() and p.name.isdigit())
    frames = []
    for scene in scenes:
        if not (scene / "rgb").is_dir():
            raise DataError(f"{scene} has no rgb; expected a scene of YCB-Video in BOP layout")
        frames += [_Item(scene, int(image.stem)) for image in list_images(scene / "rgb") if image.stem.isdigit()]
    if not frames:
        raise DataError(f"{folder} holds no images; expected {folder.name}/SSSSSS/rgb/IIIIII.png (BOP layout)")
    return frames


def _read_keyframes(root: Path) -> list[_Item]:
    file = next((root / name for name in KEYFRAME_FILES if (root / name).exists()), None)
    if file is None:
        raise DataError(f"{root} has no keyframe.txt; expected the key-frame list of YCB-Video at the top or in test")
    items = []
    for number, line in enumerate(file.read_text(encoding="utf-8", errors="replace").splitlines(), start=1):
        if not line.strip():
            continue
        match = re.fullmatch(r"\s*(\d+)[/\s]+(\d+)\s*", line)
        if match is None:
            raise DataError(f"{file}, line {number}: '{line[:40]}' is no key frame; expected scene/image numbers")
        items.append(_Item(root / "test" / f"{int(match[1]):06d}", int(match[2])))
    return items


def _check_present(keyframes: list[_Item], frames: list[_Item], folder: Path) -> None:
    present = set(frames)
    missing = [k for k in keyframes if k not in present]
    if missing:
        first = f"{missing[0].scene.name}/{missing[0].image:06d}"
        raise DataError(
            f"{folder} lacks {len(missing)} of {len(keyframes)} key frames, first {first}; expected the download "
            "'ycbv_test_all'"
        )
