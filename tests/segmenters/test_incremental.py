"""A class that comes later: the others stay as they are, or yield where they had got it wrong."""

import pytest
import torch

from icub_core.errors import CheckpointError, DataError, NotFittedError
from icub_segmenters.detection import OnlineDetector
from icub_segmenters.heads.falkon import Falkon
from icub_segmenters.heads.linear import Linear
from icub_segmenters.incremental import add_class, add_together
from icub_segmenters.minibootstrap import Minibootstrap
from icub_segmenters.normalization import Normalization
from icub_segmenters.online_segmenter import OnlineSegmenter
from icub_segmenters.region_store import Regions, RegionStore
from icub_segmenters.sampling import class_negatives

PROCEDURE = Minibootstrap(3, 300)
DIM = 24


def make_head():
    return Falkon(sigma=6.0, penalty=1e-5, n_centers=150)


def blob(center, count, seed, spread=0.5):
    generator = torch.Generator().manual_seed(seed)
    return center + spread * torch.randn(count, DIM, generator=generator)


CENTERS = 4.0 * torch.randn(5, DIM, generator=torch.Generator().manual_seed(7))


def filled_store(classes, centers=CENTERS, images=30):
    """Each image has regions of one class and some background."""
    store = RegionStore(DIM)
    for i in range(images * len(classes)):
        c = classes[i % len(classes)]
        background = 2.0 * torch.randn(20, DIM, generator=torch.Generator().manual_seed(500 + i))
        features = torch.cat([blob(centers[c], 4, i), background])
        label = torch.full((24,), -1)
        label[:4] = c
        boxes = torch.tensor([[10.0, 10.0, 40.0, 40.0]]).expand(24, 4) + torch.arange(24)[:, None] % 4
        store.append(Regions(features, boxes, torch.tensor([[10.0, 10.0, 40.0, 40.0]]).expand(24, 4), label, label))
    return store


def extended(store, c, centers=CENTERS, images=30):
    for i in range(images):
        background = 2.0 * torch.randn(20, DIM, generator=torch.Generator().manual_seed(9000 + i))
        label = torch.full((24,), -1)
        label[:4] = c
        boxes = torch.tensor([[10.0, 10.0, 40.0, 40.0]]).expand(24, 4) + torch.arange(24)[:, None] % 4
        features = torch.cat([blob(centers[c], 4, 7000 + i), background])
        store.append(Regions(features, boxes, boxes, label, label))
    return store


def detector(shared=True, head=make_head):
    return OnlineDetector(head, PROCEDURE, shared=shared, repool=False)


def trained(store, classes, **options):
    made = detector(**options)
    made.train(store, classes, torch.Generator().manual_seed(0))
    return made


@pytest.mark.parametrize("shared", [True, False])
def test_old_scores_do_not_move_by_a_bit_and_the_new_class_is_told_apart(shared):
    store = filled_store([0, 1, 2])
    made = trained(store, 3, shared=shared)
    X = made.normalization(torch.cat([blob(CENTERS[c], 50, 40 + c) for c in range(4)]))
    before, regressors = made.scores(X), dict(made.coarse.heads)
    made.add_classes(extended(store, 3), 4, torch.Generator().manual_seed(1))
    after = made.scores(X)
    own = torch.arange(4).repeat_interleave(50) < 3  # regions of old objects
    assert torch.equal(after[own, :3], before[own])
    assert (after.argmax(dim=1) == torch.arange(4).repeat_interleave(50)).float().mean() > 0.98
    assert all(made.coarse.heads[c] is head for c, head in regressors.items())
    assert set(made.coarse.heads) == {0, 1, 2, 3}


def test_an_old_class_that_takes_the_new_object_for_its_own_yields_there_and_hardly_elsewhere():
    centers = CENTERS.clone()
    centers[3] = centers[0] + 0.25 * (centers[1] - centers[0])  # looks like class 0
    store = filled_store([0, 1, 2], centers)
    made = trained(store, 3)
    new = made.normalization(blob(centers[3], 100, 60))
    old = made.normalization(torch.cat([blob(centers[c], 100, 61 + c) for c in range(3)]))
    mistaken, before = made.scores(new)[:, 0], made.scores(old)
    assert (mistaken > 0).float().mean() > 0.5
    made.add_classes(extended(store, 3, centers), 4, torch.Generator().manual_seed(1))
    assert (made.scores(new)[:, 0] < -0.5).float().mean() > 0.95
    assert (made.scores(new)[:, 3] > 0.5).float().mean() > 0.9
    after = made.scores(old)
    assert (after[:, 0] != before[:, 0]).float().mean() < 0.01
    assert torch.equal(after[:, 1:3], before[:, 1:])


def test_one_by_one_added_classes_are_found_and_a_whole_training_takes_them_in():
    store = filled_store([0])
    made = trained(store, 1)
    for c in (1, 2, 3):
        made.add_classes(extended(store, c), c + 1, torch.Generator().manual_seed(c))
    X = made.normalization(torch.cat([blob(CENTERS[c], 50, 40 + c) for c in range(4)]))
    expected = torch.arange(4).repeat_interleave(50)
    assert (made.scores(X).argmax(dim=1) == expected).float().mean() > 0.98
    made.train(store, 4, torch.Generator().manual_seed(0))
    assert made.additions == []
    assert torch.equal(made.scores(X), trained(store, 4).scores(X))


@pytest.mark.parametrize("shared", [True, False])
def test_several_classes_that_come_together_are_told_apart_and_leave_the_others(shared):
    store = filled_store([0, 1])
    made = trained(store, 2, shared=shared)
    X = made.normalization(torch.cat([blob(CENTERS[c], 50, 40 + c) for c in range(5)]))
    before = made.scores(X)
    for c in (2, 3, 4):
        extended(store, c)
    made.add_classes(store, 5, torch.Generator().manual_seed(1))
    after = made.scores(X)
    assert torch.equal(after[:100, :2], before[:100])
    assert (after.argmax(dim=1) == torch.arange(5).repeat_interleave(50)).float().mean() > 0.98


def test_a_class_added_in_the_shared_mode_is_found_as_well_as_by_algorithm_1():
    centers = CENTERS.clone()
    centers[3] = centers[0] + 0.4 * (centers[1] - centers[0])  # not easily told from class 0
    store = filled_store([0, 1, 2], centers)
    made = trained(store, 3)
    extended(store, 3, centers)
    X = made.normalization.rows_of(store.features)
    negatives = class_negatives(store, 3, PROCEDURE.budget, torch.Generator().manual_seed(1))
    faithful = add_class(3, PROCEDURE, make_head, X, store.label, negatives)
    together = add_together(3, 1, PROCEDURE, make_head, X, store.label, negatives)
    test = made.normalization(torch.cat([blob(centers[c], 200, 90 + c) for c in range(4)]))
    own = torch.arange(4).repeat_interleave(200) == 3

    def right(addition):
        return ((addition.head.decision_function(test)[:, 0] > 0) == own).float().mean()

    assert right(together) > right(faithful) - 0.02
    assert right(together) > 0.95


def test_rows_are_normalized_when_they_are_asked_for():
    X = torch.randn(30, 5, generator=torch.Generator().manual_seed(0))
    scale = Normalization.of(X)
    rows = torch.tensor([7, 3, 3, 29])
    assert torch.equal(scale.rows_of(X)[rows], scale(X)[rows])


@pytest.mark.parametrize("shared", [True, False])
def test_additions_are_saved_and_loaded(shared):
    centers = CENTERS.clone()
    centers[3] = centers[0] + 0.25 * (centers[1] - centers[0])
    store = filled_store([0, 1, 2], centers)
    made, copy = trained(store, 3, shared=shared), detector(shared)
    made.add_classes(extended(store, 3, centers), 4, torch.Generator().manual_seed(1))
    state = made.state_dict()
    copy.load_state_dict(state)
    X = made.normalization(blob(centers[3], 20, 60))
    assert torch.equal(copy.scores(X), made.scores(X))
    del state["added.3.alpha"]
    with pytest.raises(CheckpointError, match="alpha"):
        copy.load_state_dict(state)
    assert torch.equal(copy.scores(X), made.scores(X))


def test_other_heads_serve_as_well():
    store = filled_store([0, 1])
    made = trained(store, 2, head=lambda: Linear(epochs=5))
    X = made.normalization(torch.cat([blob(CENTERS[c], 30, c) for c in range(3)]))
    before = made.scores(X)
    made.add_classes(extended(store, 2), 3, torch.Generator().manual_seed(1))
    own = torch.arange(2).repeat_interleave(30)
    assert torch.equal(made.scores(X)[:60][torch.arange(60), own], before[:60][torch.arange(60), own])
    assert (made.scores(X).argmax(dim=1) == torch.arange(3).repeat_interleave(30)).all()


def test_a_new_class_without_positives_is_never_found_and_without_negatives_is():
    store = filled_store([0, 1])
    made = trained(store, 2)
    made.add_classes(store, 3, torch.Generator().manual_seed(1))
    assert (made.scores(torch.zeros(5, DIM))[:, 2] == -2).all()
    X, label = blob(CENTERS[0], 10, 1), torch.zeros(10, dtype=torch.int64)
    nothing = torch.zeros(0, dtype=torch.int64)
    alone = add_class(0, PROCEDURE, make_head, X, label, nothing)
    assert (alone.head.decision_function(X) > 0.9).all()


def test_the_segmenter_adds_a_class_and_leaves_the_others(windows, falkon, painter, teacher):
    segmenter = OnlineSegmenter(windows, falkon, composites=0)
    with pytest.raises(NotFittedError, match="call update first"):
        segmenter.add_classes()
    for frame, instances in teacher(["red", "green"]):
        segmenter.observe(frame, instances)
    segmenter.update()
    with pytest.raises(DataError, match="no class was first shown"):
        segmenter.add_classes()
    without_blue = painter([("red", 30, 30, 15), ("green", 90, 60, 18)], seed=7)[0]
    before = segmenter.segment(without_blue)
    for frame, instances in teacher(["blue"], seed=1):
        segmenter.observe(frame, instances)
    report = segmenter.add_classes()
    assert report.classes == segmenter.classes == ("red", "green", "blue")
    after = [i for i in segmenter.segment(without_blue) if i.label != "blue"]
    assert [(i.label, i.score) for i in after] == [(i.label, i.score) for i in before]
    found = segmenter.segment(painter([("red", 30, 30, 15), ("blue", 90, 60, 18)], seed=8)[0])
    assert {i.label for i in found if i.score > 0} == {"red", "blue"}
