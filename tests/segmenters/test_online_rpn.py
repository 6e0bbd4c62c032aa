"""What region proposals that are learned on-line promise, one classifier an anchor type or one for all of a cell."""

import numpy as np
import pytest
import torch

from icub_core.errors import CheckpointError, NotFittedError
from icub_core.interfaces.feature_extractor import RpnCells
from icub_segmenters import shared_rpn
from icub_segmenters.faithful_rpn import FaithfulRpn, label_anchors
from icub_segmenters.feature_extractors.proposals import best_overlaps, recall
from icub_segmenters.heads.falkon import Falkon
from icub_segmenters.heads.linear import Linear
from icub_segmenters.minibootstrap import Minibootstrap
from icub_segmenters.online_rpn import Rows
from icub_segmenters.online_segmenter import OnlineSegmenter
from icub_segmenters.shared_rpn import SharedRpn
from icub_testing.tiny import tiny_class
from icub_testing.tiny.things import draw_frame

SIZE = (160, 224)
STRIDE, SIDES = 8, (24.0, 48.0)
WAYS = {"faithful": FaithfulRpn, "shared": SharedRpn}


def make_head():
    return Falkon(sigma=20.0, penalty=1e-5, n_centers=300)


def picture(seed, objects=2, size=SIZE):
    """Cells that see how much of the surroundings is object; anchors are squares and wide boxes of two sizes."""
    generator = torch.Generator().manual_seed(seed)
    height, width = size
    truth = []
    for _ in range(objects):
        w, h = (float(v) for v in 20 + 40 * torch.rand(2, generator=generator))
        x, y = (float(v) for v in torch.rand(2, generator=generator) * torch.tensor([width - w, height - h]))
        truth.append([x, y, x + w, y + h])
    truth = torch.tensor(truth).reshape(-1, 4)
    covered = torch.zeros(height, width)
    for x0, y0, x1, y1 in truth.int().tolist():
        covered[y0:y1, x0:x1] = 1.0
    rows, columns = torch.meshgrid(torch.arange(height // STRIDE), torch.arange(width // STRIDE), indexing="ij")
    x, y = STRIDE * columns.flatten() + STRIDE / 2, STRIDE * rows.flatten() + STRIDE / 2
    coarse = torch.nn.functional.avg_pool2d(covered[None, None], STRIDE)
    features = torch.nn.functional.unfold(coarse, 7, padding=3)[0].T
    features = features + 0.02 * torch.randn(features.shape, generator=generator)
    shapes = [(s * r, s / r) for s in SIDES for r in (0.7, 1.0, 1.4)]
    anchors = torch.stack([torch.stack([x - w / 2, y - h / 2, x + w / 2, y + h / 2], dim=1) for w, h in shapes], dim=1)
    types = torch.arange(len(shapes)).repeat(len(features), 1)
    return RpnCells(features, anchors, types), truth


def taught(way, seeds=range(40), procedure=None):
    rpn = WAYS[way](make_head, procedure or Minibootstrap(4, 500), proposals=20)
    for seed in seeds:
        cells, truth = picture(seed)
        rpn.observe(cells, truth, SIZE, torch.Generator().manual_seed(seed))
    return rpn


def recall_of(rpn, iou, seeds=range(900, 920)):
    pictures = [picture(seed) for seed in seeds]
    proposals = [rpn.propose(cells, SIZE)[0].double().numpy() for cells, _ in pictures]
    return recall(best_overlaps([truth.double().numpy() for _, truth in pictures], proposals, 20), iou)


@pytest.fixture(scope="module")
def trained():
    made = {}
    for way in WAYS:
        made[way] = taught(way)
        made[way].train(torch.Generator().manual_seed(0))
    return made


@pytest.mark.parametrize("way", WAYS)
def test_what_was_taught_is_proposed_in_other_images(trained, way):
    assert recall_of(trained[way], 0.5) > 0.9
    cells, _ = picture(7)
    boxes, scores = trained[way].propose(cells, SIZE)
    assert len(boxes) <= 20
    assert (scores.diff() <= 0).all()
    assert (boxes >= 0).all()
    assert (boxes[:, 2] <= SIZE[1]).all()
    assert (boxes[:, 3] <= SIZE[0]).all()


def test_anchors_are_labeled_by_overlap_and_only_inside_the_image():
    truth = torch.tensor([[10.0, 10.0, 50.0, 50.0], [100.0, 10.0, 110.0, 60.0]])
    anchors = torch.tensor(
        [
            [12.0, 10.0, 50.0, 50.0],  # 0.95 of the first
            [16.0, 10.0, 56.0, 50.0],  # 0.74: a positive, too
            [18.0, 10.0, 58.0, 50.0],  # 0.67: only a regressor's
            [30.0, 10.0, 70.0, 50.0],  # 0.33: nothing
            [150.0, 50.0, 190.0, 90.0],  # far from all
            [80.0, 10.0, 120.0, 60.0],  # 0.25, the best that the second has: a positive, and far from all
            [-5.0, 10.0, 50.0, 50.0],  # leaves the image
        ]
    )
    labels = label_anchors(anchors, truth, (100, 200))
    assert labels.positive.tolist() == [0, 1, 5]
    assert labels.regressed.tolist() == [0, 1, 2, 5]
    assert labels.negative.tolist() == [4, 5]
    assert labels.truth.tolist() == truth[[0, 0, 0, 1]].tolist()
    nothing = label_anchors(anchors, torch.zeros(0, 4), (100, 200))
    assert nothing.negative.tolist() == [0, 1, 2, 3, 4, 5]
    assert len(nothing.positive) == len(nothing.regressed) == 0


def test_what_was_thinned_out_on_the_way_does_not_change_which_cells_are_kept(monkeypatch):
    procedure = Minibootstrap(1, 60)
    thinned = taught("shared", procedure=procedure)
    monkeypatch.setattr(shared_rpn, "SURPLUS", 1e9)
    batch = taught("shared", procedure=procedure)
    for name in ("near", "far"):
        assert sum(map(len, thinned.tables[name])) < 0.8 * sum(map(len, batch.tables[name]))
    for rpn in (thinned, batch):
        rpn.train(torch.Generator().manual_seed(0))
    for name in ("near", "far"):
        a, b = Rows.joined(thinned.tables[name]), Rows.joined(batch.tables[name])
        assert torch.equal(a.features, b.features)
        assert torch.equal(a.values, b.values)


@pytest.mark.parametrize("way", WAYS)
def test_images_share_the_budget_of_negatives(way):
    rpn = taught(way, procedure=Minibootstrap(2, 50))
    rpn.train(torch.Generator().manual_seed(0))
    rows = Rows.joined(rpn.tables["far" if way == "shared" else "negatives"])
    for kind in rows.types.unique():
        counts = torch.bincount(rows.image[rows.types == kind], minlength=40)
        assert counts.max() <= 3  # 100 over 40 images


@pytest.mark.parametrize("way", WAYS)
def test_saved_and_loaded_it_proposes_the_same_and_learns_on(trained, way):
    rpn, copy = trained[way], trained[way].fresh()
    state = rpn.state_dict()
    copy.load_state_dict({name: tensor.clone() for name, tensor in state.items()})
    cells, truth = picture(11)
    for a, b in zip(rpn.propose(cells, SIZE), copy.propose(cells, SIZE), strict=True):
        assert torch.equal(a, b)
    copy.observe(cells, truth, SIZE, torch.Generator().manual_seed(0))
    copy.train(torch.Generator().manual_seed(0))
    assert copy.images == rpn.images + 1
    del state["mean_norm"]
    with pytest.raises(CheckpointError, match="mean_norm"):
        copy.load_state_dict(state)
    assert copy.images == rpn.images + 1


@pytest.mark.parametrize("way", WAYS)
def test_without_objects_nothing_is_proposed_and_learning_goes_on(way):
    rpn = WAYS[way](make_head, Minibootstrap(2, 200), proposals=20)
    cells, _ = picture(0, objects=0)
    for wrong in (lambda: rpn.train(torch.Generator()), lambda: rpn.propose(cells, SIZE)):
        with pytest.raises(NotFittedError):
            wrong()
    rpn.observe(cells, torch.zeros(0, 4), SIZE, torch.Generator().manual_seed(0))
    rpn.train(torch.Generator().manual_seed(0))
    assert rpn.propose(cells, SIZE)[0].shape == (0, 4)
    for seed in range(10):
        rpn.observe(*picture(seed), SIZE, torch.Generator().manual_seed(seed))
    rpn.train(torch.Generator().manual_seed(0))
    assert len(rpn.propose(cells, SIZE)[0]) > 0


@pytest.mark.parametrize(
    ("options", "head", "expected"),
    [
        ({}, make_head, SharedRpn),
        ({"mode": "faithful"}, make_head, FaithfulRpn),
        ({}, lambda: Linear(epochs=5), FaithfulRpn),  # a softmax allows a cell one anchor type only
    ],
)
def test_the_segmenter_finds_what_was_taught_in_regions_of_its_own(options, head, expected):
    segmenter = OnlineSegmenter(tiny_class("feature_extractor")(), head, composites=0, proposals="online", **options)
    for color in ("red", "blue"):
        for i in range(4):
            segmenter.observe(*draw_frame({color: (45 + 15 * i, 45 + 9 * i, 16)}, seed=i))
    assert segmenter.update().parts["rpn"] > 0
    assert type(segmenter.rpn) is expected
    found = segmenter.segment(draw_frame({"red": (60, 60, 17)}, seed=9)[0])
    assert found[0].label == "red"
    assert np.isfinite([i.score for i in found]).all()
