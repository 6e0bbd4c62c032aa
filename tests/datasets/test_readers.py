"""Readers promise: the layout of the public sets and the thesis's splits."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from icub_core.errors import ConfigError, DataError
from icub_datasets.coco import Coco
from icub_datasets.ho3d import HO3D_CLASSES, SEQUENCES, Ho3d
from icub_datasets.image_folder import ImageFolder
from icub_datasets.ycb_video import YCB_VIDEO_CLASSES, YcbVideo

_spec = importlib.util.spec_from_file_location("dataset_layouts", Path(__file__).parent / "layouts.py")
layouts = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(layouts)


@pytest.fixture
def ycb_video(tmp_path):
    return layouts.write_ycb_video(tmp_path)


@pytest.fixture
def ho3d(tmp_path):
    for split in ("train", "test"):
        for i, name in enumerate(SEQUENCES[split]):
            layouts.write_ho3d_sequence(
                tmp_path / "train" / name, 3 + (i == 0), without_object=1 if name == "BB10" else None
            )
    return tmp_path


def test_ycb_video_splits(ycb_video):
    train, test, val = (YcbVideo(path=ycb_video, split=s) for s in ("train", "test", "val"))
    # every tenth of the joined list of 13 + 9 frames: 0/1, 0/11, 1/8
    assert [(i.scene.name, i.image) for i in train._items] == [("000000", 1), ("000000", 11), ("000001", 8)]
    assert [(i.scene.name, i.image) for i in test._items] == [("000048", 1), ("000048", 5), ("000049", 3)]
    assert len(val) == 12 - 3
    assert not set(val._items) & set(test._items)
    assert train.classes == test.classes == YCB_VIDEO_CLASSES
    assert len(YCB_VIDEO_CLASSES) == 21


def test_ycb_video_frame(ycb_video):
    frame, instances = YcbVideo(path=ycb_video)[2]
    np.testing.assert_array_equal(frame.rgb, layouts.random_image(8)[..., ::-1])  # written as BGR
    assert frame.depth[0, 0] == pytest.approx(0.5008)  # 5008 units of 0.1 mm
    assert frame.intrinsics[0, 0] == pytest.approx(106.7)
    # the camera looks along z of a world that is 0.5 m before it: its center is where w2c gives 0
    import cv2

    rotation = cv2.Rodrigues(np.array([0.3, -0.2, 0.9]))[0]
    np.testing.assert_allclose(frame.T_world_camera[:3, 3], -rotation.T @ [0, 0, 0.5], atol=1e-5)
    # the second object shows no pixel
    assert [(i.label, i.box.tolist()) for i in instances] == [("002_master_chef_can", [4, 10, 12, 30])]


def test_ycb_video_also_reads_the_key_frame_list_of_the_released_code(ycb_video):
    (ycb_video / "keyframe.txt").unlink()
    (ycb_video / "test" / "keyframe.txt").write_text("000048 000002\n")
    assert [(i.scene.name, i.image) for i in YcbVideo(path=ycb_video, split="test")._items] == [("000048", 2)]


def test_ho3d_splits_and_frame(ho3d):
    train, val, test = (Ho3d(path=ho3d, split=s) for s in ("train", "val", "test"))
    # 34 sequences of 3 frames, the first of 4; 9 of 3, the first of 4 (test)
    assert len(train) == -(-103 // 2)
    assert len(val) == -(-27 // 5)
    assert len(test) == -(-28 // 5)
    # the step runs on across sequences
    assert [(i.sequence.name, i.frame) for i in test._items][:3] == [
        ("ABF14", "0000"),
        ("BB14", "0001"),
        ("GSF14", "0000"),
    ]
    assert train.classes == HO3D_CLASSES
    assert set(SEQUENCES["val"]) <= set(SEQUENCES["train"])
    assert not set(SEQUENCES["test"]) & set(SEQUENCES["train"])

    frame, instances = test[0]
    assert frame.depth[3, 3] == pytest.approx(4000 * 0.00012498664727900177)
    assert frame.intrinsics[0, 2] == pytest.approx(32.0)  # the first frame is not annotated; the second gives it
    (instance,) = instances
    assert instance.label == "021_bleach_cleanser"
    truth = np.zeros((48, 64), bool)
    truth[8:28, 16:48] = True
    overlap = (instance.mask & truth).sum() / (instance.mask | truth).sum()
    assert overlap > 0.9  # JPEG and enlargement blur the rim
    assert not instance.mask[32:40, 12:40].any()  # the hand is no part of it


def test_ho3d_frames_that_show_no_object_have_no_instance(ho3d):
    train = Ho3d(path=ho3d)
    empty = [i for i, (_, instances) in enumerate(train) if not instances]
    assert [(train._items[i].sequence.name, train._items[i].frame) for i in empty] == [("BB10", "0001")]


def test_coco_decodes_every_kind_of_annotation(tmp_path):
    dataset = Coco(path=layouts.write_coco(tmp_path))
    assert dataset.classes == ("person", "car")
    frame, instances = dataset[0]
    assert not frame.depth.any()
    assert [i.label for i in instances] == ["person", "car", "car"]  # the crowd is left out
    assert instances[0].box == pytest.approx([20, 10, 30, 20], abs=1)
    assert instances[1].box.tolist() == [5, 6, 15, 26]
    assert instances[2].box.tolist() == [40, 2, 50, 12]
    gray, nothing = dataset[1]
    assert nothing == ()
    assert (gray.rgb[..., 0] == gray.rgb[..., 2]).all()


def test_image_folder_reads_any_image(tmp_path):
    dataset = ImageFolder(path=layouts.write_image_folder(tmp_path))
    assert dataset.classes == ("box", "cup")
    samples = {item.image.stem: sample for item, sample in zip(dataset._items, dataset, strict=True)}
    frame, instances = samples["kitchen"]
    assert [i.label for i in instances] == ["cup", "cup"]
    assert frame.depth[0, 0] == pytest.approx(0.75)
    assert samples["gray"][0].rgb.shape == (30, 40, 3)
    assert samples["gray"][1][0].box.tolist() == [1, 1, 9, 9]  # masks of 0 and 1 count too
    np.testing.assert_array_equal(samples["glass"][0].rgb, layouts.random_image(3)[..., ::-1])
    np.testing.assert_array_equal(samples["nothing"][0].rgb, layouts.random_image(4)[..., ::-1])  # 16 bits
    assert samples["nothing"][1] == ()
    train = ImageFolder(path=tmp_path, split="train")
    assert [i.image.stem for i in train._items] == ["kitchen", "nothing"]
    assert train.classes == dataset.classes


def test_image_folder_camera(tmp_path):
    layouts.write_image_folder(tmp_path)
    (tmp_path / "camera.json").write_text('{"cam_K": [300, 0, 32, 0, 300, 24, 0, 0, 1], "depth_scale": 0.1}')
    dataset = ImageFolder(path=tmp_path, split="train")
    assert dataset[0][0].depth[0, 0] == pytest.approx(0.075)
    assert dataset[0][0].intrinsics[0, 0] == 300
    (tmp_path / "camera.json").write_text('{"cam_K": [300]}')
    with pytest.raises(DataError, match="cam_K"):
        ImageFolder(path=tmp_path)


@pytest.mark.parametrize(
    ("reader", "split", "words"),
    [
        (YcbVideo, "train", "train_real"),
        (YcbVideo, "test", "has no test"),
        (Ho3d, "train", "HO-3D v2"),
        (Coco, "val2017", "annotations"),
        (ImageFolder, "all", "images, masks"),
    ],
)
def test_a_foreign_folder_is_named_with_what_was_expected(reader, split, words, tmp_path):
    (tmp_path / "holiday.txt").write_text("sun")
    with pytest.raises(DataError, match=words) as error:
        reader(path=tmp_path, split=split)
    assert str(tmp_path) in str(error.value)
    assert "\n" not in str(error.value)
    with pytest.raises(DataError, match="not a folder"):
        reader(path=tmp_path / "absent", split=split)


def test_unknown_splits_and_choices_name_the_nearest(ycb_video):
    with pytest.raises(ConfigError, match="Did you mean 'train'"):
        YcbVideo(path=ycb_video, split="trian")
    with pytest.raises(ConfigError, match="Did you mean 'test'"):
        Ho3d(path=ycb_video, split="tests")
    with pytest.raises(ConfigError, match="Did you mean 'skip'"):
        YcbVideo(path=ycb_video, on_error="skipp")


def test_a_partial_download_is_recognized(ycb_video):
    (ycb_video / "test" / "000049" / "rgb" / "000003.png").unlink()
    with pytest.raises(DataError, match="lacks 1 of 3 key frames, first 000049/000003"):
        YcbVideo(path=ycb_video, split="test")


def test_missing_keyframes_and_sequences_are_named(ycb_video, tmp_path_factory):
    (ycb_video / "keyframe.txt").write_text("0048/000001\nhello\n")
    with pytest.raises(DataError, match="line 2: 'hello'"):
        YcbVideo(path=ycb_video, split="test")
    (ycb_video / "keyframe.txt").unlink()
    with pytest.raises(DataError, match="keyframe.txt"):
        YcbVideo(path=ycb_video, split="val")
    other = tmp_path_factory.mktemp("ho3d")
    layouts.write_ho3d_sequence(other / "train" / "ABF14", 1)
    with pytest.raises(DataError, match="BB14"):
        Ho3d(path=other, split="test")
