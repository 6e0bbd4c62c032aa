"""The extractors and the FEATURE-TASK keep the contracts of their kinds."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from torchvision.models.detection import maskrcnn_resnet50_fpn

from icub_datasets.feature_task import cache
from icub_datasets.feature_task.renderer import LabeledImage
from icub_datasets.feature_task.task import FeatureTask
from icub_segmenters.feature_extractors.compact import CompactMaskRcnn
from icub_segmenters.feature_extractors.resnet_c4 import ResNet50C4
from icub_segmenters.feature_extractors.resnet_fpn import ResNet50Fpn
from icub_testing.contracts import DatasetContract, FeatureExtractorContract


class TestCompact(FeatureExtractorContract):
    @pytest.fixture
    def make_plugin(self):
        torch.set_num_threads(1)
        return CompactMaskRcnn


@pytest.fixture(scope="module")
def fpn_file(tmp_path_factory):
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("fpn") / "random.pth"
    torch.save(maskrcnn_resnet50_fpn(weights=None, weights_backbone=None).state_dict(), path)
    return path


@pytest.fixture(scope="module")
def c4_file(tmp_path_factory):
    spec = importlib.util.spec_from_file_location("d2_layout", Path(__file__).with_name("detectron_layout.py"))
    layout = sys.modules["d2_layout"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(layout)
    path = tmp_path_factory.mktemp("c4") / "random.pth"
    torch.manual_seed(0)
    tensors = layout.c4()
    for name in tensors:
        if "bbox_pred" in name:
            tensors[name] = 0.01 * torch.as_tensor(tensors[name])  # as Detectron starts: boxes are hardly moved
    torch.save(tensors, path)
    return path


@pytest.mark.slow
class TestResNet50Fpn(FeatureExtractorContract):
    @pytest.fixture
    def make_plugin(self, fpn_file):
        return lambda: ResNet50Fpn(str(fpn_file), image_size=[120, 160])


@pytest.mark.slow
class TestResNet50C4(FeatureExtractorContract):
    @pytest.fixture
    def make_plugin(self, c4_file):
        return lambda: ResNet50C4(str(c4_file), shorter_side=120, proposals=50)


@pytest.mark.pybullet
class TestFeatureTask(DatasetContract):
    @pytest.fixture
    def make_plugin(self, tmp_path, monkeypatch):
        """Two shards of drawn frames in the place of rendered ones."""
        monkeypatch.setattr(cache, "SHARD_FRAMES", 3)
        rng = np.random.default_rng(0)
        for shard in range(2):
            frames = []
            for _ in range(3):
                instances = np.zeros((240, 320), np.uint8)
                instances[20:90, 30:120], instances[150:200, 200:300] = 1, 2
                rgb = rng.integers(0, 256, (240, 320, 3), dtype=np.uint8)
                frames.append(LabeledImage(rgb, instances, np.array([3, 150])))
            cache._write_shard(cache._shard_path(tmp_path, "train", shard), frames)
        return lambda: FeatureTask(tmp_path, frames=6)


@pytest.mark.pybullet
def test_class_names_are_in_the_order_of_labels():
    names = FeatureTask().classes
    assert len(set(names)) == len(names) == FeatureTask().label_count
    assert all(isinstance(name, str) for name in names)
