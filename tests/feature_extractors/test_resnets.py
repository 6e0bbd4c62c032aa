"""ResNet-50 extractors read torchvision's and Detectron2's checkpoints and compute what those libraries compute."""

import importlib.util
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch.nn import functional
from torchvision.models.detection import maskrcnn_resnet50_fpn
from torchvision.ops import roi_align

from icub_core.errors import ConfigError, WeightsError
from icub_segmenters.feature_extractors.compact import CompactMaskRcnn
from icub_segmenters.feature_extractors.resnet_c4 import ResNet50C4, cell_anchors
from icub_segmenters.feature_extractors.resnet_fpn import TORCHVISION_FILE, ResNet50Fpn, find_torchvision_weights

_spec = importlib.util.spec_from_file_location("detectron_layout", Path(__file__).with_name("detectron_layout.py"))
detectron_layout = importlib.util.module_from_spec(_spec)
sys.modules["detectron_layout"] = detectron_layout
_spec.loader.exec_module(detectron_layout)

BOXES = torch.tensor([[10.0, 12.0, 60.0, 70.0], [40.0, 5.0, 120.0, 90.0]])
BGR_MEAN = torch.tensor([103.530, 116.280, 123.675])[:, None, None]


@pytest.fixture(scope="module")
def image():
    torch.set_num_threads(1)
    return np.random.default_rng(0).integers(0, 256, (96, 128, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def c4_tensors():
    return detectron_layout.c4(classes=5)


@pytest.fixture(scope="module")
def c4_file(tmp_path_factory, c4_tensors):
    path = tmp_path_factory.mktemp("c4") / "model_final.pth"
    torch.save({"model": c4_tensors, "__author__": "a test"}, path)
    return path


@pytest.fixture(scope="module")
def c4(c4_file):
    return ResNet50C4(str(c4_file), shorter_side=96, proposals=40)


def test_c4_has_the_dimensions_of_the_thesis(c4, image):
    assert (c4.region_dim, c4.mask_dim, c4.mask_size) == (2048, 256, 14)
    features = c4.extract(image)
    assert features.proposals.shape[0] <= 40
    assert c4.region_features(features, BOXES).shape == (2, 2048)
    assert c4.mask_features(features, BOXES).shape == (2, 14, 14, 256)
    assert c4.mask_probabilities(features, BOXES).shape == (2, 14, 14)
    cells = c4.rpn_cells(features)
    assert cells.features.shape == (6 * 8, 1024)
    assert cells.anchors.shape == (6 * 8, 15, 4)
    assert cells.types[0].tolist() == list(range(15))


def test_c4_computes_what_the_checkpoint_means(c4, c4_tensors, image):
    """Against the same network written as plain arithmetic on the checkpoint's own tensors."""
    bgr = torch.from_numpy(image).permute(2, 0, 1).flip(0).float() - BGR_MEAN
    trunk = detectron_layout.run_trunk(c4_tensors, "backbone.", bgr[None])[-1]
    pooled = roi_align(trunk, [BOXES], 14, 1 / 16, 0, aligned=True)
    head = detectron_layout.run_stage(c4_tensors, "roi_heads.", 5, pooled)
    features = c4.extract(image)
    got = c4.region_features(features, BOXES)
    assert torch.allclose(got, head.mean((2, 3)), rtol=1e-3, atol=1e-3 * float(head.abs().max()))
    deconv = functional.conv_transpose2d(
        head,
        c4_tensors["roi_heads.mask_head.deconv.weight"],
        c4_tensors["roi_heads.mask_head.deconv.bias"],
        stride=2,
    ).relu()
    masks = c4.mask_features(features, BOXES).permute(0, 3, 1, 2)
    assert torch.allclose(masks, deconv, rtol=1e-3, atol=1e-3 * float(deconv.abs().max()))


def test_c4_proposals_follow_the_anchors_of_the_layout(c4, c4_tensors, image):
    """The best-scored cell's box, decoded by hand."""
    bgr = torch.from_numpy(image).permute(2, 0, 1).flip(0).float() - BGR_MEAN
    trunk = detectron_layout.run_trunk(c4_tensors, "backbone.", bgr[None])[-1]
    name = "proposal_generator.rpn_head"
    rpn = functional.conv2d(trunk, c4_tensors[f"{name}.conv.weight"], c4_tensors[f"{name}.conv.bias"], padding=1).relu()
    scores, deltas = (
        functional.conv2d(rpn, c4_tensors[f"{name}.{part}.weight"], c4_tensors[f"{name}.{part}.bias"])[0]
        for part in ("objectness_logits", "anchor_deltas")
    )
    anchor, y, x = np.unravel_index(int(scores.argmax()), scores.shape)
    size, ratio = (32, 64, 128, 256, 512)[anchor // 3], (0.5, 1.0, 2.0)[anchor % 3]
    width, height = size / ratio**0.5, size * ratio**0.5
    dx, dy, dw, dh = (float(v) for v in deltas[4 * anchor : 4 * anchor + 4, y, x])
    cx, cy = 16 * x + dx * width, 16 * y + dy * height
    width, height = width * np.exp(min(dw, np.log(1000 / 16))), height * np.exp(min(dh, np.log(1000 / 16)))
    expected = np.array([cx - width / 2, cy - height / 2, cx + width / 2, cy + height / 2])
    expected = np.clip(expected, 0, [128, 96, 128, 96])
    features = c4.extract(image)
    assert np.allclose(features.proposals[0].numpy(), expected, atol=0.1)
    assert features.scores[0] == pytest.approx(float(scores.max().sigmoid()), abs=1e-4)


def test_c4_anchors_have_their_areas_and_ratios():
    anchors = cell_anchors()
    sides = anchors[:, 2:] - anchors[:, :2]
    assert torch.allclose(sides.prod(1).sqrt(), torch.tensor([32.0, 64, 128, 256, 512]).repeat_interleave(3))
    assert torch.allclose(sides[:, 1] / sides[:, 0], torch.tensor([0.5, 1.0, 2.0]).repeat(5))
    assert torch.allclose(anchors[:, :2], -anchors[:, 2:])


@pytest.mark.slow
def test_detectron_pickles_are_read_without_running_them(tmp_path, c4_tensors, c4, image):
    content = {"model": {k: v.numpy() for k, v in c4_tensors.items()}, "__author__": "a test"}
    path = tmp_path / "model_final.pkl"
    path.write_bytes(pickle.dumps(content))
    read = ResNet50C4(str(path), shorter_side=96, proposals=40)
    assert torch.equal(read.extract(image).proposals, c4.extract(image).proposals)


def test_a_pickle_that_runs_code_is_refused(tmp_path):
    class Evil:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "touched",))

    path = tmp_path / "evil.pkl"
    path.write_bytes(pickle.dumps({"model": Evil()}))
    with pytest.raises(WeightsError, match=r"evil\.pkl"):
        ResNet50C4(str(path))
    assert not (tmp_path / "touched").exists()


def test_c4_refuses_other_checkpoints(tmp_path, c4_tensors):
    with pytest.raises(WeightsError, match="no weight file"):
        ResNet50C4(str(tmp_path / "none.pth"))
    small = {k: v for k, v in c4_tensors.items() if "rpn_head" in k}
    foreign = small | {"backbone.res9.0.conv1.weight": torch.zeros(1)}
    save_file(foreign, tmp_path / "foreign.safetensors")
    with pytest.raises(WeightsError, match=r"backbone\.res9.*no tensor of"):
        ResNet50C4(str(tmp_path / "foreign.safetensors"))
    save_file({"rpn.head.conv.weight": torch.zeros(1)}, tmp_path / "other.safetensors")
    with pytest.raises(WeightsError, match="does not have the names"):
        ResNet50C4(str(tmp_path / "other.safetensors"))


@pytest.mark.slow
def test_c4_names_a_wrong_shape(tmp_path, c4_tensors):
    wrong = dict(c4_tensors)
    wrong["roi_heads.mask_head.deconv.bias"] = torch.zeros(7)
    torch.save(wrong, tmp_path / "wrong.pth")
    with pytest.raises(WeightsError, match=r"'deconv.bias' has shape \(7,\), expected \(256,\)"):
        ResNet50C4(str(tmp_path / "wrong.pth"))


# FPN ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def torchvision_model():
    torch.manual_seed(0)
    model = maskrcnn_resnet50_fpn(weights=None, weights_backbone=None, num_classes=6).eval()
    for module in model.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.eps = 0.0  # as torchvision does for its COCO weights
            module.running_mean.normal_(0, 0.05)
            module.running_var.uniform_(0.8, 1.2)
    return model


@pytest.fixture(scope="module")
def torchvision_file(tmp_path_factory, torchvision_model):
    path = tmp_path_factory.mktemp("tv") / TORCHVISION_FILE
    torch.save(torchvision_model.state_dict(), path)
    return path


def test_fpn_equals_torchvision(torchvision_file, torchvision_model, image):
    extractor = ResNet50Fpn(str(torchvision_file), image_size=[96, 128], proposals=50)
    features = extractor.extract(image)
    mean, std = (torch.tensor(v)[:, None, None] for v in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
    pixels = (torch.from_numpy(image).permute(2, 0, 1) / 255 - mean) / std
    heads = torchvision_model.roi_heads
    with torch.no_grad():
        maps = torchvision_model.backbone(pixels[None])
        pooled = heads.box_head(heads.box_roi_pool(maps, [BOXES], [(96, 128)]))
        deep = heads.mask_head(heads.mask_roi_pool(maps, [BOXES], [(96, 128)]))
        deep = heads.mask_predictor.relu(heads.mask_predictor.conv5_mask(deep))
    got, masks = extractor.region_features(features, BOXES), extractor.mask_features(features, BOXES)
    assert torch.allclose(got, pooled, rtol=1e-3, atol=1e-4 * float(pooled.max()))
    assert torch.allclose(masks, deep.permute(0, 2, 3, 1), rtol=1e-3, atol=1e-4 * float(deep.max()))
    assert extractor.mask_probabilities(features, BOXES).shape == (2, 28, 28)
    from torchvision.models.detection.image_list import ImageList

    torchvision_model.rpn._post_nms_top_n["testing"] = 50
    with torch.no_grad():
        boxes, _ = torchvision_model.rpn(ImageList(pixels[None], [(96, 128)]), maps)
    assert torch.allclose(features.proposals, boxes[0], atol=0.05)
    cells = extractor.rpn_cells(features)
    assert cells.features.shape[1] == 256
    assert cells.types.max() == 14


def test_coco_is_found_in_torch_hubs_folder(tmp_path, monkeypatch, torchvision_file, image):
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    with pytest.raises(WeightsError, match=f"not at hand: put {TORCHVISION_FILE}") as error:
        CompactMaskRcnn(weights="coco")
    assert "\n" not in str(error.value)
    folder = tmp_path / "checkpoints"
    folder.mkdir()
    (folder / TORCHVISION_FILE).symlink_to(torchvision_file)
    assert find_torchvision_weights() == folder / TORCHVISION_FILE
    extractor = CompactMaskRcnn(weights="coco", image_size=[96, 128])
    assert extractor.region_dim == 1024
    assert extractor.region_features(extractor.extract(image), BOXES).shape == (2, 1024)


@pytest.mark.slow
def test_fpn_reads_names_from_before_torchvision_013(tmp_path, torchvision_model, image):
    old = {}
    for key, value in torchvision_model.state_dict().items():
        new = key.replace("rpn.head.conv.0.0.", "rpn.head.conv.")
        for i in range(4):
            new = new.replace(f"fpn.inner_blocks.{i}.0.", f"fpn.inner_blocks.{i}.")
            new = new.replace(f"fpn.layer_blocks.{i}.0.", f"fpn.layer_blocks.{i}.")
            new = new.replace(f"roi_heads.mask_head.{i}.0.", f"roi_heads.mask_head.mask_fcn{i + 1}.")
        old[new] = value
    torch.save(old, tmp_path / "old.pth")
    extractor = ResNet50Fpn(str(tmp_path / "old.pth"), image_size=[96, 128])
    assert extractor.region_features(extractor.extract(image), BOXES).shape == (2, 1024)


def test_fpn_computes_what_a_detectron_checkpoint_means(tmp_path, image):
    tensors = detectron_layout.fpn(classes=5)
    torch.save({"model": tensors}, tmp_path / "d2.pth")
    extractor = ResNet50Fpn(str(tmp_path / "d2.pth"), image_size=[96, 128], proposals=50)
    features = extractor.extract(image)
    bgr = torch.from_numpy(image).permute(2, 0, 1).flip(0).float() - BGR_MEAN
    stages = detectron_layout.run_trunk(tensors, "backbone.bottom_up.", bgr[None])
    stages.append(detectron_layout.run_stage(tensors, "backbone.bottom_up.", 5, stages[-1]))

    def conv(name, x):
        weight = tensors[f"{name}.weight"]
        return functional.conv2d(x, weight, tensors[f"{name}.bias"], padding=weight.shape[-1] // 2)

    inner = conv("backbone.fpn_lateral5", stages[3])
    for level in (4, 3, 2):
        inner = conv(f"backbone.fpn_lateral{level}", stages[level - 2]) + functional.interpolate(inner, scale_factor=2)
    finest = conv("backbone.fpn_output2", inner)  # both boxes are small enough for stride 4
    x = roi_align(finest, [BOXES], 7, 1 / 4, 0, aligned=True).flatten(1)
    for name in ("fc1", "fc2"):
        head = f"roi_heads.box_head.{name}"
        x = functional.linear(x, tensors[f"{head}.weight"], tensors[f"{head}.bias"]).relu()
    got = extractor.region_features(features, BOXES)
    assert torch.allclose(got, x, rtol=1e-3, atol=1e-3 * float(x.abs().max()))
    predictor = extractor.network._model.roi_heads.box_predictor
    assert torch.equal(predictor.cls_score.weight[0], tensors["roi_heads.box_predictor.cls_score.weight"][-1])
    assert torch.equal(predictor.cls_score.weight[1:], tensors["roi_heads.box_predictor.cls_score.weight"][:-1])
    assert torch.equal(predictor.bbox_pred.weight[4:], tensors["roi_heads.box_predictor.bbox_pred.weight"])


def test_sizes_that_make_no_sense_are_refused(torchvision_file):
    with pytest.raises(ConfigError, match="proposals=0"):
        ResNet50Fpn(str(torchvision_file), proposals=0)
    with pytest.raises(ConfigError, match="at least 32"):
        ResNet50C4("x.pth", shorter_side=4)
