"""The parts of the segmenter, each against an independent account of what it should do."""

import math

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torchvision.ops import box_iou

from icub_core.errors import DataError
from icub_segmenters.boxes import clip, decode, encode, iou, jittered, paired_iou
from icub_segmenters.clutter import Compositor, Cutout, relit
from icub_segmenters.detection import NEVER, BoxRegressors, Detections, OnlineDetector, suppressed, voted
from icub_segmenters.heads.falkon import Falkon
from icub_segmenters.heads.linear import Linear
from icub_segmenters.mask_geometry import boxes_of_masks, crop_masks, paste_masks
from icub_segmenters.minibootstrap import Minibootstrap, one_vs_rest
from icub_segmenters.normalization import Normalization
from icub_segmenters.region_store import Regions, RegionStore
from icub_segmenters.regions import assign, describe

coordinate = st.floats(0, 100)
box = st.tuples(coordinate, coordinate, st.floats(1, 60), st.floats(1, 60)).map(
    lambda b: [b[0], b[1], b[0] + b[2], b[1] + b[3]]
)


@given(a=st.lists(box, min_size=1, max_size=6), b=st.lists(box, min_size=1, max_size=6))
def test_iou_agrees_with_torchvision(a, b):
    a, b = torch.tensor(a), torch.tensor(b)
    torch.testing.assert_close(iou(a, b), box_iou(a, b), atol=1e-5, rtol=1e-4)
    n = min(len(a), len(b))
    torch.testing.assert_close(paired_iou(a[:n], b[:n]), iou(a[:n], b[:n]).diagonal(), atol=1e-5, rtol=1e-4)


def test_iou_of_boxes_without_area_is_zero():
    line = torch.tensor([[3.0, 3.0, 3.0, 9.0]])
    assert iou(line, line).item() == 0
    assert iou(torch.zeros(0, 4), line).shape == (0, 1)


@given(a=box, b=box)
def test_decoding_what_was_encoded_gives_the_target_back(a, b):
    a, b = torch.tensor([a]), torch.tensor([b])
    moved = decode(a, encode(a, b), (10_000, 10_000))
    torch.testing.assert_close(moved, b, atol=1e-2, rtol=1e-3)


def test_absurd_refinements_neither_overflow_nor_leave_the_image():
    moved = decode(torch.tensor([[10.0, 10, 20, 20]]), torch.tensor([[50.0, -50, 1000, -1000]]), (60, 80))
    assert torch.isfinite(moved).all()
    assert (moved[0, :2] < moved[0, 2:]).all()
    assert moved.min() >= 0
    assert moved[0, 2] <= 80
    assert clip(torch.tensor([[90.0, 70, 99, 99]]), (60, 80)).tolist() == [[79, 59, 80, 60]]


def test_jittered_boxes_overlap_as_much_as_asked():
    truth = torch.tensor([20.0, 20, 60, 50])
    drawn = jittered(truth, 6, 0.6, (96, 128), torch.Generator().manual_seed(0))
    assert len(drawn) == 6
    assert iou(drawn, truth[None]).min() >= 0.6


def test_regions_are_assigned_by_overlap():
    truth, classes = torch.tensor([[0.0, 0, 10, 10], [50, 50, 60, 60]]), torch.tensor([3, 1])
    boxes = torch.tensor([[0.0, 0, 10, 10], [0, 0, 10, 20], [80, 80, 90, 90], [51, 50, 60, 60], [0, 0, 10, 35]])
    label, near, targets = assign(boxes, truth, classes)
    assert label.tolist() == [3, -1, -1, 1, -1]
    assert near.tolist() == [3, 3, -1, 1, -1]
    assert targets[3].tolist() == [50, 50, 60, 60]
    assert assign(boxes, torch.zeros(0, 4), torch.zeros(0, dtype=torch.int64))[1].tolist() == [-1] * 5


def test_the_scale_is_mean_and_mean_norm_over_twenty():
    X = torch.randn(500, 8, generator=torch.Generator().manual_seed(0)) + 3
    scaled = Normalization.of(X)(X)
    expected = (X - X.mean(0)) * 20 / np.linalg.norm(X.numpy(), axis=1).mean()
    torch.testing.assert_close(scaled, expected)
    with pytest.raises(DataError):
        Normalization.of(X[:0])


def test_statistics_take_four_fifths_from_positives_evenly_by_class():
    label = torch.cat([torch.zeros(5000), torch.ones(5000), torch.full((5000,), -1.0)]).long()
    X = label[:, None].float().expand(-1, 2) * 1.0
    scale = Normalization.of_classes(X, label, torch.Generator().manual_seed(0))
    assert scale.mean[0].item() == pytest.approx(0.4 * 0 + 0.4 * 1 - 0.2 * 1, abs=1e-3)
    alone = Normalization.of_classes(X[:3], label[:3], torch.Generator().manual_seed(0))
    assert alone.mean_norm > 0


def regions(count, label=-1, near=-1, dim=4, seed=0):
    generator = torch.Generator().manual_seed(seed)
    boxes = torch.rand(count, 4, generator=generator)
    full = torch.full((count,), label), torch.full((count,), near)
    return Regions(torch.randn(count, dim, generator=generator), boxes, boxes.clone(), *full)


def test_the_store_keeps_each_region_once_with_little_slack():
    store = RegionStore(64)
    rows = [store.append(regions(50, seed=i, dim=64)) for i in range(40)]
    assert len(store) == 2000
    assert store.images == 40
    assert torch.equal(store.features[rows[7]], regions(50, seed=7, dim=64).features)
    assert torch.equal(store.image, torch.arange(40).repeat_interleave(50))
    assert store.nbytes < 1.5 * 2000 * (64 * 4)
    store.keep(torch.arange(0, 2000, 2))
    assert len(store) == 1000
    assert torch.equal(store.features[25:50], regions(50, seed=1, dim=64).features[::2])


def test_the_store_refuses_foreign_and_infinite_features_and_stays_as_it_was():
    store = RegionStore(4)
    store.append(regions(3))
    with pytest.raises(DataError, match=r"\(n, 4\)"):
        store.append(regions(3, dim=5))
    bad = regions(3)
    bad.features[1, 1] = float("nan")
    with pytest.raises(DataError, match="image 1 are not finite"):
        store.append(bad)
    assert len(store) == 3
    assert store.images == 1


def blobs(classes=3, positives=60, negatives=3000, d=10, seed=0):
    """Gaussian classes far from each other, background spread over all of space."""
    generator = torch.Generator().manual_seed(seed)
    centers = 6 * torch.randn(classes, d, generator=generator)
    X = torch.cat([c + torch.randn(positives, d, generator=generator) for c in centers])
    X = torch.cat([X, 3 * torch.randn(negatives, d, generator=generator)])
    label = torch.cat([torch.arange(classes).repeat_interleave(positives), torch.full((negatives,), -1)])
    return X, label


class Counting(Falkon):
    """Remembers how many samples every fit had."""

    sizes: list[int] = []

    def fit(self, X, Y, sample_weight=None, centers=None):
        Counting.sizes.append(len(X))
        super().fit(X, Y, sample_weight, centers)


def test_a_class_is_trained_on_positives_and_ever_harder_negatives():
    X, label = blobs()
    positives, negatives = torch.nonzero(label == 0).flatten(), torch.nonzero(label != 0).flatten()
    negatives = negatives[torch.randperm(len(negatives), generator=torch.Generator().manual_seed(1))]
    Counting.sizes.clear()
    procedure = Minibootstrap(batches=5, batch_size=500)
    head = procedure.train_class(lambda: Counting(sigma=10.0, penalty=1e-5, n_centers=300), X, positives, negatives)
    assert Counting.sizes[0] == 60 + 500
    assert len(Counting.sizes) == 5
    assert max(Counting.sizes[1:]) < 500  # most of a batch is easy
    scores = head.decision_function(X).squeeze(1)
    assert scores[positives].min() > scores[negatives].max()


def test_rounds_follow_algorithm_1_step_by_step():
    X, label = blobs(classes=1, negatives=900)
    positives, negatives = torch.nonzero(label == 0).flatten(), torch.nonzero(label != 0).flatten()
    make = lambda: Falkon(sigma=10.0, penalty=1e-5, n_centers=200)  # noqa: E731
    head = Minibootstrap(batches=3, batch_size=300).train_class(make, X, positives, negatives)

    def train(negatives):
        model = make()
        rows = torch.cat([positives, negatives])
        model.fit(X[rows], torch.where(label[rows] == 0, 1.0, -1.0)[:, None])
        return model

    score = lambda model, rows: model.decision_function(X[rows])[:, 0]  # noqa: E731
    first, second, third = negatives.split(300)
    model = train(first)
    chosen = first[score(model, first) >= -0.9]
    for batch in (second, third):
        chosen = torch.cat([chosen, batch[score(model, batch) > -0.7]])
        model = train(chosen)
        chosen = chosen[score(model, chosen) >= -0.9] if batch is second else chosen
    torch.testing.assert_close(head.decision_function(X), model.decision_function(X))


@pytest.mark.parametrize(
    "make", [lambda: Falkon(sigma=10.0, n_centers=300), lambda: Linear(epochs=10, learning_rate=0.01)]
)
def test_shared_training_tells_all_classes_apart(make):
    X, label = blobs()
    negatives = torch.nonzero(label < 0).flatten()
    head = Minibootstrap(batches=4, batch_size=500, hard=-0.7).train_shared(make, X, label, negatives, 4)
    scores = head.decision_function(X)
    assert scores.shape == (len(X), 4)  # class 3 has no positives
    for c in range(3):
        assert scores[label == c, c].min() > torch.quantile(scores[label != c, c], 0.98)
    if isinstance(head, Falkon):
        assert scores[:, 3].max() < -0.5


def test_shared_training_without_negatives_or_with_short_batches_works():
    X, label = blobs(negatives=7)
    for negatives in (torch.zeros(0, dtype=torch.int64), torch.nonzero(label < 0).flatten()):
        head = Minibootstrap(2, 5).train_shared(lambda: Falkon(sigma=10.0), X, label, negatives, 3)
        assert head.decision_function(X).argmax(1)[:180].tolist() == label[:180].tolist()
    assert Minibootstrap(2, 5).train_class(Falkon, X, torch.zeros(0, dtype=torch.int64), torch.arange(5)) is None


def test_one_vs_rest_targets():
    assert one_vs_rest(torch.tensor([1, -1, 0]), 2).tolist() == [[-1, 1], [-1, -1], [1, -1]]


def filled_store(positives=(30, 30), d=6, seed=0):
    store, generator = RegionStore(d), torch.Generator().manual_seed(seed)
    centers = 8 * torch.randn(len(positives) + 1, d, generator=generator)
    for _ in range(10):
        rows = [(centers[c] + torch.randn(n // 10, d, generator=generator), c, c) for c, n in enumerate(positives)] + [
            (centers[-1] + 4 * torch.randn(30, d, generator=generator), -1, -1)
        ]
        X = torch.cat([x for x, _, _ in rows])
        corner = 50 * torch.rand(len(X), 2, generator=generator)
        boxes = torch.cat([corner, corner + 20], dim=1)
        label = torch.cat([torch.full((len(x),), c) for x, c, _ in rows])
        # the true box lies where the first feature says
        targets = boxes + torch.tanh(X[:, :1] / 10) * 5
        store.append(Regions(X, boxes, targets, label, label.clone()))
    return store


@pytest.mark.parametrize("shared", [True, False])
def test_a_class_without_positives_is_never_found_and_one_positive_is_enough(shared):
    store = filled_store()
    lonely = store.features[-1:] + 20
    nowhere = torch.tensor([[5.0, 5, 25, 25]])
    store.append(Regions(lonely, nowhere, nowhere, torch.tensor([3]), torch.tensor([3])))
    detector = OnlineDetector(lambda: Falkon(sigma=15.0, n_centers=300), Minibootstrap(2, 100), shared=shared)
    detector.train(store, 4, torch.Generator().manual_seed(0))
    scores = detector.scores(detector.normalization(store.features))
    assert (scores[:, 2] == NEVER).all()
    assert scores[-1].argmax() == 3
    copy = OnlineDetector(detector.make_head, detector.minibootstrap, shared=shared)
    copy.load_state_dict(detector.state_dict())
    assert torch.equal(copy.scores(detector.normalization(store.features)), scores)


def test_box_regressors_learn_their_class_and_leave_the_others_alone():
    store = filled_store(positives=(300, 0))
    boxes = BoxRegressors()
    boxes.fit(store.features, store, 0.0)
    rows = torch.nonzero(store.label == 0).flatten()
    labels = torch.zeros(len(rows), dtype=torch.int64)
    refined = boxes.refine(store.features[rows], store.boxes[rows], labels, (200, 200))
    before, after = (paired_iou(b, store.targets[rows]).mean() for b in (store.boxes[rows], refined))
    assert 1 - after < 0.5 * (1 - before)
    untouched = boxes.refine(store.features[rows], store.boxes[rows], labels + 1, (200, 200))
    torch.testing.assert_close(untouched, store.boxes[rows])


def test_suppression_works_within_a_class_only():
    boxes = torch.tensor([[0.0, 0, 10, 10], [1, 0, 11, 10], [0, 0, 10, 10], [0, 0, 10, 4]])
    found = suppressed(Detections(boxes, torch.tensor([0, 0, 1, 0]), torch.tensor([0.5, 0.9, 0.1, 0.3])))
    assert found.scores.tolist() == pytest.approx([0.9, 0.1]) or found.scores.tolist() == pytest.approx([0.9, 0.3, 0.1])
    assert 0.5 not in found.scores.tolist()


@settings(max_examples=30, deadline=None)
@given(
    x=st.floats(20, 80), y=st.floats(20, 60), rx=st.floats(6, 18), ry=st.floats(6, 18), side=st.sampled_from([14, 28])
)
def test_a_mask_cropped_to_its_box_and_pasted_back_is_the_mask(x, y, rx, ry, side):
    rows, columns = np.mgrid[:90, :110]
    mask = torch.from_numpy(((rows + 0.5 - y) / ry) ** 2 + ((columns + 0.5 - x) / rx) ** 2 <= 1)[None]
    tight = boxes_of_masks(mask, torch.zeros(1, 4))
    back = paste_masks(crop_masks(mask, tight, side), tight, (90, 110))
    overlap = (mask & back).sum() / (mask | back).sum()
    assert overlap > 0.9


def test_pasting_survives_boxes_outside_and_thinner_than_a_pixel():
    boxes = torch.tensor([[200.0, 200, 210, 210], [10.6, 10.6, 10.9, 10.9], [-5, -5, 5, 5]])
    pasted = paste_masks(torch.ones(3, 14, 14), boxes, (40, 50))
    assert pasted.flatten(1).sum(1).tolist() == [0, 0, 25]


def test_an_empty_mask_keeps_the_given_box():
    masks = torch.zeros(2, 8, 9, dtype=torch.bool)
    masks[1, 2:4, 3:7] = True
    assert boxes_of_masks(masks, torch.tensor([[1.0, 2, 3, 4], [0, 0, 9, 8]])).tolist() == [[1, 2, 3, 4], [3, 2, 7, 4]]


def test_composites_hold_the_object_and_say_where():
    compositor, rng = Compositor.from_folder(), np.random.default_rng(0)
    mask = np.zeros((60, 60), dtype=bool)
    mask[10:50, 20:40] = True
    rgb = np.zeros((60, 60, 3), np.uint8)
    rgb[mask] = (255, 0, 255)
    found = 0
    for _ in range(30):
        made = compositor.compose(Cutout.of("magenta", rgb, mask), (120, 160), rng)
        assert made.rgb.shape == (120, 160, 3)
        for label, seen in made.instances:
            assert label == "magenta"
            color = made.rgb[cv2.erode(seen.astype(np.uint8), np.ones((3, 3))) > 0].mean(axis=0)
            assert color[0] > 2 * color[1]
            assert color[2] > 2 * color[1]
            found += 1
    assert found > 20  # now and then it is covered by something else


def test_clutter_folders_are_checked(tmp_path):
    with pytest.raises(DataError, match="no JPEG"):
        Compositor.from_folder(tmp_path)
    (tmp_path / "broken.jpg").write_bytes(b"no image")
    with pytest.raises(DataError, match=r"broken\.jpg"):
        Compositor.from_folder(tmp_path)
    cv2.imwrite(str(tmp_path / "broken.jpg"), np.zeros((30, 40, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "broken.png"), np.zeros((10, 10), np.uint8))
    with pytest.raises(DataError, match=r"\(10, 10\); expected the image's \(30, 40\)"):
        Compositor.from_folder(tmp_path)


def test_relighting_stays_within_bytes():
    picture = np.full((4, 4, 3), 250, np.uint8)
    values = [relit(picture, np.random.default_rng(i)).mean() for i in range(50)]
    assert min(values) < 200
    assert max(values) == 255
    assert not math.isnan(sum(values))


def test_suppressed_neighbors_of_the_same_class_vote_on_the_box():
    boxes = torch.tensor([[10.0, 10, 50, 50], [12, 12, 52, 52], [14, 10, 54, 50], [80, 80, 99, 99]])
    labels, scores = torch.tensor([0, 0, 1, 0]), torch.tensor([0.9, 0.9, 0.8, 0.1])
    candidates = Detections(boxes, labels, scores)
    kept = candidates.take(torch.tensor([0, 2, 3]))
    result = voted(kept, candidates)
    assert torch.allclose(result.boxes[0], torch.tensor([11.0, 11, 51, 51]))  # two equal votes
    assert torch.allclose(result.boxes[1:], boxes[2:])  # another class and a loner have no other voters
    assert torch.equal(result.scores, kept.scores)
    weak = Detections(boxes, labels, torch.tensor([0.9, -0.6, 0.8, 0.1]))
    assert (
        voted(weak.take(torch.tensor([0])), weak).boxes - boxes[0]
    ).abs().max() < 0.02  # a doubtful one has little say
    assert len(voted(kept.take(torch.zeros(0, dtype=torch.int64)), candidates)) == 0


def test_distractors_of_a_composite_are_seen_and_are_no_taught_object():
    rng = np.random.default_rng(0)
    compositor = Compositor.from_folder()
    rgb, mask = np.full((60, 60, 3), 200, np.uint8), np.zeros((60, 60), bool)
    mask[10:50, 15:45] = True
    cutout = Cutout.of("cup", rgb, mask)
    composites = [compositor.compose(cutout, (120, 160), rng) for _ in range(20)]
    assert sum(len(c.distractors) for c in composites) > 20
    for composite in composites:
        masks = [m for _, m in composite.instances] + list(composite.distractors)
        assert all(m.any() and m.shape == (120, 160) for m in masks)
        assert (np.sum(masks, axis=0) <= 1).all()  # a pixel belongs to what is on top


def test_distractors_become_described_negatives(windows, painter):
    frame, instances = painter([("red", 30, 40, 15)])
    image = windows.extract(frame.rgb)
    truth, distractors = torch.tensor([[15.0, 25, 45, 55]]), torch.tensor([[80.0, 20, 110, 50]])
    generator = torch.Generator().manual_seed(0)
    regions = describe(windows, image, truth, torch.tensor([0]), generator, distractors)
    own = (regions.boxes == distractors).all(dim=1)
    assert own.sum() == 1
    assert regions.label[own] == regions.near[own] == -1
    without = describe(windows, image, truth, torch.tensor([0]), torch.Generator().manual_seed(0))
    assert len(regions) == len(without) + 2  # the distractor's box and one drawn around it


def test_a_class_more_crowds_out_no_other():
    generator = torch.Generator().manual_seed(0)
    corners = 10.0 * torch.arange(90)[:, None]
    boxes = torch.cat([corners, torch.zeros(90, 1), corners + 5, torch.full((90, 1), 5.0)], dim=1)
    found = Detections(boxes, torch.arange(90) % 3, torch.rand(90, generator=generator))
    alone = suppressed(found.take(torch.nonzero(found.labels < 2).flatten()))
    together = suppressed(found)
    assert torch.bincount(together.labels).tolist() == [20, 20, 20]
    assert (together.scores.diff() <= 0).all()
    of_old = together.take(torch.nonzero(together.labels < 2).flatten())
    assert torch.equal(of_old.boxes, alone.boxes)
    assert torch.equal(of_old.scores, alone.scores)
