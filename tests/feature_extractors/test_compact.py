"""The compact extractor: promised shapes, repeatable numbers, useful proposals, clear refusals."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from icub_core.errors import CheckpointError, ConfigError, DataError, WeightsError
from icub_segmenters.feature_extractors import training
from icub_segmenters.feature_extractors.compact import CompactMaskRcnn
from icub_segmenters.feature_extractors.compact_regions import (
    BLOCKS,
    CENTER,
    SCALE,
    CompactRegions,
    fold_batch_norm,
    load_compact,
)
from icub_segmenters.feature_extractors.evaluation import paste
from icub_segmenters.feature_extractors.network import CompactNetwork
from icub_segmenters.feature_extractors.weights import SHIPPED
from icub_support.weights import read_card


@pytest.fixture(scope="module")
def extractor():
    torch.set_num_threads(1)
    return CompactMaskRcnn()


def picture(height=240, width=320):
    """A drawn scene: gray table, a striped box and a can; returns the image and the two boxes."""
    y, x = np.mgrid[0:240, 0:320]
    image = np.stack([120 + y // 8, 110 + y // 8, 100 + x // 16], axis=-1).astype(np.uint8)
    cv2.rectangle(image, (60, 80), (119, 169), (200, 40, 40), -1)
    cv2.rectangle(image, (60, 110), (119, 130), (240, 230, 200), -1)
    cv2.ellipse(image, (220, 140), (28, 40), 0, 0, 360, (40, 90, 200), -1)
    boxes = np.array([[60, 80, 120, 170], [192, 100, 249, 181]], float)
    scale = np.array([width / 320, height / 240] * 2)
    return cv2.resize(image, (width, height)), torch.tensor(boxes * scale, dtype=torch.float32)


def iou(a, b):
    low, high = torch.maximum(a[:, None, :2], b[None, :, :2]), torch.minimum(a[:, None, 2:], b[None, :, 2:])
    inter = (high - low).clamp(min=0).prod(-1)
    area = [(x[:, 2:] - x[:, :2]).prod(-1) for x in (a, b)]
    return inter / (area[0][:, None] + area[1][None] - inter)


@pytest.mark.parametrize("size", [(240, 320), (480, 640), (320, 240), (97, 300), (33, 40)])
def test_shapes_and_ranges_for_images_of_any_size(extractor, size):
    image, boxes = picture(*size)
    features = extractor.extract(image)
    assert features.image_size == size
    proposals = features.proposals
    assert proposals.ndim == 2
    assert 0 < len(proposals) <= 100
    assert (proposals >= -1e-3).all()
    assert (proposals[:, [0, 2]] <= size[1] + 1e-3).all()
    assert (proposals[:, [1, 3]] <= size[0] + 1e-3).all()
    assert (features.scores[1:] <= features.scores[:-1]).all()
    assert ((features.scores >= 0) & (features.scores <= 1)).all()
    regions = extractor.region_features(features, boxes)
    assert regions.shape == (2, extractor.region_dim)
    assert regions.dtype == torch.float32
    assert torch.isfinite(regions).all()
    masks = extractor.mask_features(features, boxes)
    assert masks.shape == (2, extractor.mask_size, extractor.mask_size, extractor.mask_dim)
    shapes = extractor.mask_probabilities(features, boxes)
    assert shapes.shape == (2, extractor.mask_size, extractor.mask_size)
    assert ((shapes >= 0) & (shapes <= 1)).all()
    refined = extractor.refined_boxes(features, boxes)
    assert refined.shape == (2, 4)
    assert (refined[:, 2] <= size[1]).all()
    assert (refined[:, 3] <= size[0]).all()


def test_the_same_image_gives_the_same_numbers_and_nothing_is_changed(extractor):
    image, boxes = picture()
    kept = image.copy()
    first, second = extractor.extract(image), extractor.extract(image)
    assert np.array_equal(image, kept)
    assert torch.equal(first.proposals, second.proposals)
    assert torch.equal(extractor.region_features(first, boxes), extractor.region_features(second, boxes))
    assert torch.equal(extractor.mask_features(first, boxes), extractor.mask_features(second, boxes))


def test_a_region_does_not_depend_on_its_dependencies(extractor):
    image, boxes = picture()
    features = extractor.extract(image)
    together = extractor.region_features(features, torch.cat([boxes, features.proposals]))[:2]
    assert torch.allclose(together, extractor.region_features(features, boxes), atol=1e-4)


def test_no_boxes_give_no_features(extractor):
    features = extractor.extract(picture()[0])
    none = torch.zeros(0, 4)
    assert extractor.region_features(features, none).shape == (0, extractor.region_dim)
    side = extractor.mask_size
    assert extractor.mask_features(features, none).shape == (0, side, side, extractor.mask_dim)
    assert extractor.mask_probabilities(features, none).shape == (0, side, side)
    assert extractor.refined_boxes(features, none).shape == (0, 4)


def test_grey_images_and_alpha_are_understood(extractor):
    image, boxes = picture()
    gray = image[..., 0]
    expected = extractor.region_features(extractor.extract(np.repeat(gray[..., None], 3, axis=2)), boxes)
    for variant in (gray, gray[..., None]):
        assert torch.equal(extractor.region_features(extractor.extract(variant), boxes), expected)
    alpha = np.concatenate([image, np.zeros_like(image[..., :1])], axis=2)
    assert torch.equal(extractor.extract(alpha).proposals, extractor.extract(image).proposals)


@pytest.mark.parametrize(
    "image",
    [np.zeros((10, 10, 3), np.float32), np.zeros((10, 10, 2), np.uint8), np.zeros((0, 10, 3), np.uint8), [[1]]],
)
def test_other_images_are_refused_in_one_line(extractor, image):
    with pytest.raises(DataError, match="expected") as error:
        extractor.extract(image)
    assert "\n" not in str(error.value)


def test_boxes_that_are_none_are_refused(extractor):
    features = extractor.extract(picture()[0])
    with pytest.raises(DataError, match="expected \\(N, 4\\)"):
        extractor.region_features(features, torch.zeros(3, 5))
    with pytest.raises(DataError, match="NaN"):
        extractor.region_features(features, torch.full((1, 4), float("nan")))


def test_proposals_cover_objects_that_were_never_seen(extractor):
    image, boxes = picture()
    best = iou(boxes, extractor.extract(image).proposals).max(dim=1).values
    assert (best > 0.5).all(), best


def test_the_pretrained_mask_separates_an_object_from_its_surroundings(extractor):
    image, boxes = picture()
    wide = boxes + torch.tensor([-12.0, -12.0, 12.0, 12.0])
    masks = extractor.mask_probabilities(extractor.extract(image), wide)
    side = masks.shape[1]
    center = masks[:, side // 2 - 3 : side // 2 + 3, side // 2 - 3 : side // 2 + 3].mean((1, 2))
    rim = torch.cat([masks[:, 0], masks[:, -1], masks[:, :, 0], masks[:, :, -1]], dim=1).mean(1)
    assert (center > 0.6).all()
    assert (rim < 0.4).all()


def test_the_refinement_moves_a_loose_box_towards_its_object(extractor):
    image, boxes = picture()
    loose = boxes + torch.tensor([-8.0, 6.0, 9.0, 8.0])
    refined = extractor.refined_boxes(extractor.extract(image), loose)
    assert iou(refined, boxes).diagonal().mean() > iou(loose, boxes).diagonal().mean()


def test_proposals_and_mask_size_follow_the_configuration():
    small = CompactMaskRcnn(proposals=20, mask_size=14)
    image, boxes = picture()
    features = small.extract(image)
    assert len(features.proposals) == 20
    assert small.mask_features(features, boxes).shape == (2, 14, 14, 64)
    assert small.mask_probabilities(features, boxes).shape == (2, 14, 14)


@pytest.mark.parametrize("wrong", [{"proposals": 0}, {"mask_size": 20}, {"image_size": [240]}, {"image_size": [8, 8]}])
def test_sizes_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ConfigError, match="expected"):
        CompactMaskRcnn(**wrong)


def test_folding_batch_normalization_changes_nothing():
    network = load_compact(SHIPPED / "compact.safetensors")[0].eval()
    image = torch.from_numpy(picture()[0]).permute(2, 0, 1)[None].float()
    with torch.no_grad():
        before, low = network.backbone(network.normalize(image))
        after, low_after = fold_batch_norm(network).backbone(network.normalize(image))
    assert not any(isinstance(m, torch.nn.BatchNorm2d) for m in network.modules())
    for name in before:
        assert torch.allclose(before[name], after[name], atol=1e-3)
    assert torch.allclose(low, low_after, atol=1e-4)


def test_every_block_of_region_features_weighs_the_same(extractor):
    features = extractor.extract(picture()[0])
    norms = [
        block.norm(dim=1).mean() for block in extractor.region_features(features, features.proposals).split(BLOCKS, 1)
    ]
    assert len(norms) == 5
    assert max(norms) / min(norms) < 4


def test_cells_describe_every_anchor_once(extractor):
    image, _ = picture(480, 640)
    features = extractor.extract(image)
    cells = extractor.rpn_cells(features)
    locations = 30 * 40 + 15 * 20 + 8 * 10
    assert cells.features.shape == (locations, 128)
    assert cells.anchors.shape == (locations, 6, 4)
    assert cells.types.shape == (locations, 6)
    assert cells.types.unique().tolist() == list(range(18))
    sides = (cells.anchors[..., 2:] - cells.anchors[..., :2]).prod(-1).sqrt()
    for kind in range(18):
        chosen = sides[cells.types == kind]
        assert chosen.std() < 2.0, "all anchors of a type have one size"
    # anchors are in pixels of the original image: twice those of the working size
    assert sides.min() == pytest.approx(32, rel=0.1)
    assert sides.max() == pytest.approx(240, rel=0.1)


# weight files ---------------------------------------------------------------------------------------------------


def test_shipped_weights_are_small_and_have_a_card():
    file = SHIPPED / "compact.safetensors"
    assert file.stat().st_size <= 25_000_000
    card = read_card(SHIPPED / "compact.json")
    assert {"command", "seed", "data", "training_seconds", "machine", "figures"} <= card.keys()
    assert str(Path.home()) not in json.dumps(card)


def test_missing_weights_are_named_with_what_there_is(tmp_path):
    with pytest.raises(WeightsError, match=r"no weight file.*compact"):
        CompactMaskRcnn("copmact")
    with pytest.raises(WeightsError, match="no weight file"):
        CompactMaskRcnn(str(tmp_path / "none.safetensors"))


def test_a_truncated_file_is_refused(tmp_path):
    whole = (SHIPPED / "compact.safetensors").read_bytes()
    for length in (0, 7, 100, len(whole) // 2, len(whole) - 1):
        cut = tmp_path / "cut.safetensors"
        cut.write_bytes(whole[:length])
        with pytest.raises(WeightsError, match=r"cut\.safetensors is truncated"):
            CompactMaskRcnn(str(cut))


META = {"architecture": "compact", "classes": "180"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.pop("rpn.head.cls_logits.weight"), "lacks 'rpn.head.cls_logits.weight'"),
        (lambda t: t.update({"roi_heads.box_head.fc7.weight": torch.zeros(3, 3)}), r"shape \(3, 3\), expected \(256"),
        (lambda t: t.update(surplus=torch.zeros(1)), "holds 'surplus'"),
        (lambda t: t.update({"roi_heads.box_head.fc7.bias": torch.full((256,), float("nan"))}), "NaN"),
        (lambda t: t.pop(CENTER), "'statistics.center' is nothing"),
        (lambda t: t.update({SCALE: torch.ones(5)}), r"'statistics.scale' is \(5,\)"),
    ],
)
def test_foreign_weights_are_refused_naming_the_tensor(tmp_path, change, message):
    tensors = load_file(SHIPPED / "compact.safetensors")
    change(tensors)
    save_file(tensors, tmp_path / "odd.safetensors", META)
    with pytest.raises(WeightsError, match=message):
        CompactMaskRcnn(str(tmp_path / "odd.safetensors"))


def test_another_architecture_is_refused(tmp_path):
    save_file({"x": torch.zeros(1)}, tmp_path / "other.safetensors", {"architecture": "vit"})
    with pytest.raises(WeightsError, match="'vit', expected 'compact'"):
        CompactMaskRcnn(str(tmp_path / "other.safetensors"))


# training -------------------------------------------------------------------------------------------------------


class DrawnTask:
    """An image with two labeled objects, moved about; no renderer."""

    label_count = 2

    def sample(self, rng):
        image, boxes = picture()
        instances = np.zeros(image.shape[:2], np.uint8)
        for i, (x0, y0, x1, y1) in enumerate(boxes.int().tolist(), start=1):
            instances[y0:y1, x0:x1] = i
        shift = rng.integers(-20, 20, size=2)
        move = lambda a: np.ascontiguousarray(np.roll(a, shift, axis=(0, 1)))  # noqa: E731

        class Sample:
            rgb, labels = move(image), np.array([1, 2])

        Sample.instances = move(instances)
        return Sample


def test_learning_rate_warms_up_and_falls():
    rates = [training.learning_rate(s, 10_000) for s in np.linspace(0, 1, 11)]
    assert rates == sorted(rates, reverse=True)
    assert rates[-1] == pytest.approx(0.01 * training.LEARNING_RATE)
    assert training.learning_rate(0.0, 0) < 0.01 * training.LEARNING_RATE


def step(trainer, task, share=0.2):
    trainer.gradients(task, 0)
    trainer.exchange(0.0, 0)
    trainer.apply(training.learning_rate(share, trainer.state.step), 0)
    trainer.state.step += 1


def test_a_resumed_training_equals_an_uninterrupted_one(tmp_path, monkeypatch):
    monkeypatch.setattr(training, "BATCH", 1)
    task, state = DrawnTask(), lambda: training.TrainingState(3, 1, 2)
    whole = training._Trainer(state())
    for _ in range(3):
        step(whole, task)
    first = training._Trainer(state())
    for _ in range(2):
        step(first, task)
    first.save(tmp_path / "c.safetensors")
    second = training._Trainer(state())
    second.load(tmp_path / "c.safetensors")
    step(second, task)
    assert second.state.step == whole.state.step == 3
    for part in ("network", "average"):
        a, b = getattr(whole, part).state_dict(), getattr(second, part).state_dict()
        assert all(torch.equal(a[key], b[key]) for key in a), part


def test_a_checkpoint_of_another_run_is_refused(tmp_path):
    training._Trainer(training.TrainingState(3, 1, 2)).save(tmp_path / "c.safetensors")
    with pytest.raises(CheckpointError, match="seed=3, asked for 4"):
        training._Trainer(training.TrainingState(4, 1, 2)).load(tmp_path / "c.safetensors")


def test_a_damaged_checkpoint_is_named(tmp_path):
    file = tmp_path / "checkpoint.safetensors"
    file.write_bytes(b"12345678 nonsense")
    with pytest.raises(CheckpointError, match=r"checkpoint\.safetensors is truncated"):
        training.read_checkpoint(file)


@pytest.mark.slow
def test_two_workers_learn_export_and_resume(tmp_path):
    reports = []
    checkpoint = training.fit(
        DrawnTask(), tmp_path, training.Budget(images=480), seed=1, workers=2, progress=reports.append
    )
    assert reports[-1]["mask"] < reports[0]["mask"]
    state = training.export(checkpoint, tmp_path / "w.safetensors", DrawnTask(), images=2)
    assert state.images == 480
    extractor = CompactMaskRcnn(str(tmp_path / "w.safetensors"))
    image, boxes = picture()
    assert iou(boxes, extractor.extract(image).proposals).max(dim=1).values.min() > 0.4
    training.fit(DrawnTask(), tmp_path, training.Budget(images=496), seed=1, workers=2)
    assert training.read_checkpoint(checkpoint)[1].images == 496
    with pytest.raises(CheckpointError, match="seed=1, asked for 2"):
        training._Trainer(training.TrainingState(2, 2, 2)).load(checkpoint)


# evaluation -----------------------------------------------------------------------------------------------------


def test_a_pasted_mask_fills_its_box_and_nothing_else():
    mask = np.zeros((28, 28), np.float32)
    mask[:, 14:] = 1.0
    out = paste(mask, np.array([10.0, 20.0, 50.0, 60.0]), (100, 120))
    assert out.sum() == pytest.approx(20 * 40, rel=0.06)
    rows, columns = np.nonzero(out)
    assert rows.min() == 20
    assert rows.max() == 59
    assert columns.min() == pytest.approx(30, abs=1)
    assert columns.max() == 49


def test_a_box_outside_the_image_pastes_nothing():
    assert not paste(np.ones((28, 28), np.float32), np.array([-50.0, -50.0, -10.0, -10.0]), (40, 40)).any()


def test_an_untrained_network_has_the_shipped_layout():
    shipped = load_file(SHIPPED / "compact.safetensors")
    fresh = {k for k in CompactNetwork(180).state_dict() if not k.endswith("num_batches_tracked")}
    assert fresh | {CENTER, SCALE} == set(shipped)
    assert CompactRegions.region_dim == sum(BLOCKS) == 816
