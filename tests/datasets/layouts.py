"""Small data sets written in the exact layout of the public ones."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import cv2
import numpy as np

H, W = 48, 64


def random_image(seed: int, size: tuple[int, int] = (H, W)) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (*size, 3), dtype=np.uint8)


def rectangle(x0: int, y0: int, x1: int, y1: int, size: tuple[int, int] = (H, W)) -> np.ndarray:
    mask = np.zeros(size, dtype=np.uint8)
    mask[y0:y1, x0:x1] = 255
    return mask


def write_png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    ok, content = cv2.imencode(path.suffix, image)
    assert ok
    path.write_bytes(content.tobytes())


def write_bop_scene(folder: Path, images: list[int], object_ids: list[int], hidden: int | None = None) -> None:
    """Write a BOP scene: camera turned about z, half a meter up; object `hidden` (index) shows no pixel."""
    truth, info, cameras = {}, {}, {}
    for image in images:
        name = f"{image:06d}"
        write_png(folder / "rgb" / f"{name}.png", random_image(image))
        write_png(folder / "depth" / f"{name}.png", np.full((H, W), 5000 + image, dtype=np.uint16))
        truth[str(image)], info[str(image)] = [], []
        for number, object_id in enumerate(object_ids):
            x0 = 4 + 12 * number
            mask = rectangle(x0, 10, x0 + 8, 30) if number != hidden else np.zeros((H, W), np.uint8)
            write_png(folder / "mask_visib" / f"{name}_{number:06d}.png", mask)
            truth[str(image)].append(
                {"obj_id": object_id, "cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_m2c": [0, 0, 800]}
            )
            shown = number != hidden
            info[str(image)].append({
                "bbox_visib": [x0, 10, 8, 20] if shown else [-1, -1, -1, -1],
                "bbox_obj": [x0, 10, 8, 20], "px_count_visib": 160 if shown else 0, "visib_fract": float(shown),
            })  # fmt: skip
        cameras[str(image)] = {
            "cam_K": [106.7, 0.0, 31.3, 0.0, 106.7, 24.1, 0.0, 0.0, 1.0],
            "cam_R_w2c": [0.775038, 0.630563, -0.0416588, 0.630563, -0.766, 0.1246, 0.04667, -0.1228, -0.99133],
            "cam_t_w2c": [0.0, 0.0, 500.0], "depth_scale": 0.1,
        }  # fmt: skip
    rotation = cv2.Rodrigues(np.array([0.3, -0.2, 0.9]))[0]
    for camera in cameras.values():
        camera["cam_R_w2c"] = [round(float(v), 6) for v in rotation.ravel()]
    for name, content in (("scene_gt", truth), ("scene_gt_info", info), ("scene_camera", cameras)):
        (folder / f"{name}.json").write_text(json.dumps(content))


def write_ycb_video(root: Path) -> Path:
    """Two training scenes of 13 and 9 frames, two test scenes of 6, three key frames."""
    write_bop_scene(root / "train_real" / "000000", list(range(1, 14)), [2, 5, 21])
    write_bop_scene(root / "train_real" / "000001", list(range(1, 10)), [1, 15], hidden=1)
    write_bop_scene(root / "test" / "000048", list(range(1, 7)), [4, 9])
    write_bop_scene(root / "test" / "000049", list(range(1, 7)), [3])
    (root / "keyframe.txt").write_text("0048/000001\n0048/000005\n0049/000003\n")
    return root


def python2_pickle(content: dict) -> bytes:
    """Pickle arrays the way Python 2's numpy did: protocol 2, the old module names."""
    return pickle.dumps(content, protocol=2).replace(b"numpy._core.multiarray", b"numpy.core.multiarray")


def write_ho3d_sequence(folder: Path, frames: int, first: int = 0, without_object: int | None = None) -> None:
    for i in range(first, first + frames):
        name = f"{i:04d}"
        write_png(folder / "rgb" / f"{name}.png", random_image(i))
        units = np.uint16(4000 + i)
        depth = np.zeros((H, W, 3), np.uint8)  # written as BGR: red holds the low byte, green the high one
        depth[..., 2], depth[..., 1] = units & 255, units >> 8
        write_png(folder / "depth" / f"{name}.png", depth)
        seg = np.zeros((H // 2, W // 2, 3), np.uint8)
        seg[14:20, 6:20] = (0, 0, 255)  # hand: red
        if i != without_object:
            seg[4:14, 8:24] = (255, 0, 0)  # object: blue
        write_png(folder / "seg" / f"{name}.jpg", seg)
        meta = {"objName": "021_bleach_cleanser", "camMat": np.array([[61.4, 0, 32.0], [0, 61.4, 23.8], [0, 0, 1.0]])}
        if i == first:
            meta = {"objName": None, "camMat": None}
        (folder / "meta").mkdir(parents=True, exist_ok=True)
        (folder / "meta" / f"{name}.pkl").write_bytes(python2_pickle(meta))


def write_coco(root: Path) -> Path:
    from faster_coco_eval import mask as rle

    write_png(root / "val2017" / "000000000139.jpg", random_image(1))
    write_png(root / "val2017" / "000000000285.jpg", random_image(2)[..., 0])  # gray
    compressed = rle.encode(np.asfortranarray((rectangle(5, 6, 15, 26) > 0).astype(np.uint8)))
    counts = compressed["counts"]
    compressed["counts"] = counts.decode() if isinstance(counts, bytes) else counts
    plain = (rectangle(40, 2, 50, 12) > 0).ravel(order="F")
    edges = np.flatnonzero(np.diff(np.concatenate([[0], plain.astype(int), [0]]))).tolist()
    runs = np.diff([0, *edges, plain.size]).tolist()
    box = {"bbox": [0, 0, 1, 1], "area": 1, "iscrowd": 0}
    content = {
        "images": [
            {"id": 139, "file_name": "000000000139.jpg", "height": H, "width": W},
            {"id": 285, "file_name": "000000000285.jpg", "height": H, "width": W},
        ],
        "categories": [{"id": 3, "name": "car"}, {"id": 1, "name": "person"}],
        "annotations": [
            {"id": 1, "image_id": 139, "category_id": 1, "segmentation": [[20, 10, 30, 10, 30, 20, 20, 20]], **box},
            {"id": 2, "image_id": 139, "category_id": 3, "segmentation": compressed, **box},
            {"id": 3, "image_id": 139, "category_id": 3, "segmentation": {"size": [H, W], "counts": runs}, **box},
            {"id": 4, "image_id": 139, "category_id": 3, "segmentation": {"size": [H, W], "counts": runs},
             **box, "iscrowd": 1},
        ],
    }  # fmt: skip
    (root / "annotations").mkdir()
    (root / "annotations" / "instances_val2017.json").write_text(json.dumps(content))
    return root


def write_image_folder(root: Path) -> Path:
    """A color JPEG with two cups, a gray PNG of another size, one with alpha, one without anything in it."""
    write_png(root / "images" / "kitchen.jpg", random_image(1))
    write_png(root / "masks" / "kitchen" / "cup.png", rectangle(2, 2, 20, 20))
    write_png(root / "masks" / "kitchen" / "cup.2.png", rectangle(30, 2, 50, 20))
    write_png(root / "images" / "gray.png", random_image(2, (30, 40))[..., 0])
    write_png(root / "masks" / "gray" / "box.png", rectangle(1, 1, 9, 9, (30, 40)) // 255)
    write_png(root / "images" / "glass.png", np.dstack([random_image(3), np.full((H, W), 128, np.uint8)]))
    write_png(root / "masks" / "glass" / "box.png", np.dstack([rectangle(5, 5, 9, 9)] * 3))
    write_png(root / "images" / "nothing.png", random_image(4).astype(np.uint16) * 257)
    (root / "masks" / "nothing").mkdir()
    write_png(root / "depth" / "kitchen.png", np.full((H, W), 750, np.uint16))
    (root / "train.txt").write_text("kitchen\nnothing\n")
    return root
