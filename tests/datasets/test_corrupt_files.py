"""Readers promise: a file that cannot be used is named in one line, refused or left out by choice."""

from __future__ import annotations

import importlib.util
import json
import logging
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from icub_core.errors import DataError
from icub_datasets.coco import Coco
from icub_datasets.ho3d import SEQUENCES, Ho3d
from icub_datasets.image_folder import ImageFolder
from icub_datasets.reading import read_json, read_mask, read_rgb
from icub_datasets.unpickle import load_plain_pickle
from icub_datasets.ycb_video import YcbVideo

_spec = importlib.util.spec_from_file_location("dataset_layouts", Path(__file__).parent / "layouts.py")
layouts = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(layouts)


def truncate(path: Path, keep: float = 0.6) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content))])


def assert_one_line(action, file: Path) -> None:
    """Either it works, or a DataError names the file in one line; anything else fails the test."""
    message = None
    try:
        action()
    except DataError as error:
        message = str(error)
    assert message is None or (str(file) in message and "\n" not in message)


@pytest.fixture
def ycb_video(tmp_path):
    return layouts.write_ycb_video(tmp_path)


def test_a_corrupt_image_in_the_middle_is_refused_or_left_out_by_choice(ycb_video, caplog):
    broken = ycb_video / "train_real" / "000000" / "rgb" / "000011.png"
    truncate(broken)
    refusing = YcbVideo(path=ycb_video)
    with pytest.raises(DataError, match="000011.png") as error:
        list(refusing)
    assert "\n" not in str(error.value)
    assert refusing[0][0].rgb.shape == (48, 64, 3)  # the rest stays usable
    assert refusing[2][0].rgb.shape == (48, 64, 3)

    skipping = YcbVideo(path=ycb_video, on_error="skip")
    with caplog.at_level(logging.WARNING):
        samples = list(skipping)
    assert len(samples) == len(skipping) - 1
    assert str(broken) in caplog.text
    with pytest.raises(DataError, match="000011.png"):  # asking for it by number is no silent substitute
        skipping[1]


@pytest.mark.parametrize("part", ["depth", "mask_visib"])
def test_every_file_of_a_frame_is_checked(ycb_video, part):
    for file in (ycb_video / "train_real" / "000000" / part).glob("000011*"):
        truncate(file)
    with pytest.raises(DataError, match=f"{part}/000011"):
        YcbVideo(path=ycb_video)[1]


def test_a_missing_mask_and_a_mask_of_another_size_are_named(ycb_video):
    mask = ycb_video / "train_real" / "000000" / "mask_visib" / "000001_000001.png"
    layouts.write_png(mask, layouts.rectangle(0, 0, 5, 5, (20, 20)))
    with pytest.raises(DataError, match=r"000001_000001.png is 20x20; expected its image's 64x48"):
        YcbVideo(path=ycb_video)[0]
    mask.unlink()
    with pytest.raises(DataError, match="000001_000001.png: no such file"):
        YcbVideo(path=ycb_video)[0]


@pytest.mark.parametrize(
    ("file", "content", "words"),
    [
        ("scene_gt.json", "{", "scene_gt.json"),
        ("scene_gt.json", "[]", "image numbers as keys"),
        ("scene_gt.json", "{}", "no entry for image 1"),
        ("scene_gt.json", '{"1": [{"obj_id": 77}, {"obj_id": 1}, {"obj_id": 1}]}', "object 77; expected 1 to 21"),
        ("scene_gt.json", '{"1": [{"obj_id": 3}]}', "do not fit"),
        ("scene_gt_info.json", '{"1": [{}, {}, {}]}', "do not fit"),
        ("scene_camera.json", '{"1": {"cam_K": [1, 2], "depth_scale": 1}}', "cam_K"),
        ("scene_camera.json", '{"1": {"cam_K": [1, 0, 0, 0, 1, 0, 0, 0, 1]}}', "depth_scale"),
    ],
)
def test_damaged_annotations_are_named(ycb_video, file, content, words):
    (ycb_video / "train_real" / "000000" / file).write_text(content)
    with pytest.raises(DataError, match=words) as error:
        YcbVideo(path=ycb_video)[0]
    assert "\n" not in str(error.value)
    YcbVideo(path=ycb_video)[2]  # another scene


def test_ho3d_names_its_damaged_files(tmp_path):
    for name in SEQUENCES["test"]:
        layouts.write_ho3d_sequence(tmp_path / "train" / name, 2)
    dataset = Ho3d(path=tmp_path, split="test")
    first = dataset._items[0].sequence
    truncate(first / "seg" / "0000.jpg")
    with pytest.raises(DataError, match="seg/0000.jpg"):
        dataset[0]
    layouts.write_ho3d_sequence(first, 2)
    for meta in (first / "meta").glob("*.pkl"):
        meta.write_bytes(layouts.python2_pickle({"camMat": None}))
    with pytest.raises(DataError, match="gives no camMat"):
        dataset[0]


class _Evil:
    def __reduce__(self):
        return os.system, ("touch /tmp/icub_pickle_ran",)


def test_pickles_cannot_run_anything(tmp_path):
    marker = Path("/tmp/icub_pickle_ran")
    marker.unlink(missing_ok=True)
    file = tmp_path / "0000.pkl"
    for protocol in (0, 2, 4):
        file.write_bytes(pickle.dumps({"camMat": _Evil()}, protocol=protocol))
        with pytest.raises(DataError, match="names (posix|nt).system"):
            load_plain_pickle(file)
    file.write_bytes(b"cbuiltins\neval\n(S'1'\ntR.")
    with pytest.raises(DataError, match="names builtins.eval"):
        load_plain_pickle(file)
    assert not marker.exists()


def test_plain_pickles_are_read_back(tmp_path):
    file = tmp_path / "0000.pkl"
    content = {"camMat": np.eye(3), "label": np.float64(3.5), "name": "021_bleach_cleanser", "none": None}
    for protocol in (2, 3, 4, 5):
        file.write_bytes(pickle.dumps(content, protocol=protocol))
        read = load_plain_pickle(file)
        np.testing.assert_array_equal(read["camMat"], np.eye(3))
        assert read["label"] == 3.5
        assert read["name"] == content["name"]
    file.write_bytes(layouts.python2_pickle({"camMat": np.arange(9.0).reshape(3, 3)}))
    np.testing.assert_array_equal(load_plain_pickle(file)["camMat"], np.arange(9.0).reshape(3, 3))


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.data())
def test_damaged_pickles_raise_nothing_else(tmp_path, data):
    content = bytearray(pickle.dumps({"camMat": np.eye(3), "n": 3}, protocol=2))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    file = tmp_path / "x.pkl"
    file.write_bytes(bytes(content))
    assert_one_line(lambda: load_plain_pickle(file), file)


@pytest.mark.filterwarnings("ignore::UserWarning:PIL.*")
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.data())
def test_damaged_images_give_an_image_or_a_named_error(tmp_path, data):
    suffix = data.draw(st.sampled_from([".png", ".jpg", ".bmp", ".tif"]))
    file = tmp_path / f"x{suffix}"
    layouts.write_png(file, layouts.random_image(0, (12, 16)))
    content = bytearray(file.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    keep = data.draw(st.integers(0, len(content)))
    file.write_bytes(bytes(content[:keep]))

    def read():
        rgb = read_rgb(file)
        assert rgb.ndim == 3
        assert rgb.dtype == np.uint8
        read_mask(file, rgb.shape[:2])

    assert_one_line(read, file)


json_values = st.recursive(
    st.none() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)


@given(json_values)
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_any_json_in_place_of_coco_is_refused_in_one_line(tmp_path, content):
    (tmp_path / "annotations").mkdir(exist_ok=True)
    (tmp_path / "val2017").mkdir(exist_ok=True)
    (tmp_path / "annotations" / "instances_val2017.json").write_text(json.dumps(content))
    with pytest.raises(DataError, match="COCO's format"):
        Coco(path=tmp_path)


@pytest.mark.parametrize(
    "segmentation",
    [
        {"size": [48, 64], "counts": [5, 5]},
        {"size": [48, 64], "counts": [-1, 48 * 64 + 1]},
        {"size": [9, 9], "counts": "abc"},
        {"counts": "abc"},
        "abc",
        [["a", "b", 1, 2, 3, 4]],
    ],
)
def test_coco_masks_that_cannot_be_decoded_are_named(tmp_path, segmentation):
    layouts.write_coco(tmp_path)
    file = tmp_path / "annotations" / "instances_val2017.json"
    content = json.loads(file.read_text())
    content["annotations"][0]["segmentation"] = segmentation
    file.write_text(json.dumps(content))
    with pytest.raises(DataError, match="000000000139.jpg cannot be decoded") as error:
        Coco(path=tmp_path)[0]
    assert "\n" not in str(error.value)


def test_coco_image_names_cannot_leave_the_folder(tmp_path):
    layouts.write_coco(tmp_path)
    (tmp_path / "secret.jpg").write_bytes((tmp_path / "val2017" / "000000000139.jpg").read_bytes())
    file = tmp_path / "annotations" / "instances_val2017.json"
    content = json.loads(file.read_text())
    content["images"][0]["file_name"] = "../secret.jpg"
    file.write_text(json.dumps(content))
    with pytest.raises(DataError, match="val2017/secret.jpg"):
        Coco(path=tmp_path)[0]


def test_image_folder_refuses_what_does_not_fit(tmp_path):
    layouts.write_image_folder(tmp_path)
    with pytest.raises(DataError, match="expected one of all, train"):
        ImageFolder(path=tmp_path, split="trai")
    with pytest.raises(DataError, match="no split"):
        ImageFolder(path=tmp_path, split="../train")
    (tmp_path / "train.txt").write_text("kitchen\ngarden\n")
    with pytest.raises(DataError, match="'garden'"):
        ImageFolder(path=tmp_path, split="train")
    layouts.write_png(tmp_path / "masks" / "kitchen" / "cup.png", np.zeros((48, 64), np.uint8))
    with pytest.raises(DataError, match="cup.png is empty"):
        list(ImageFolder(path=tmp_path))
    (tmp_path / "masks" / "garden").mkdir()
    with pytest.raises(DataError, match="garden belongs to no image"):
        ImageFolder(path=tmp_path)


def test_json_errors_name_the_file(tmp_path):
    for content in ("", "{", "[" * 100_000):
        (tmp_path / "a.json").write_text(content)
        with pytest.raises(DataError, match=r"a\.json"):
            read_json(tmp_path / "a.json")
