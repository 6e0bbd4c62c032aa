"""Metrics promise: COCO's numbers, VOC's numbers, documented answers for empty sets, clear refusals."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from icub_benchmarks.segmentation.voc import average_precision, evaluate_voc
from icub_core.data import Instance
from icub_core.errors import ConfigError, DataError
from icub_segmenters.feature_extractors.proposals import average_recall, best_overlaps, recall
from icub_support.detection import evaluate_instances
from icub_support.overlap import box_iou, mask_iou

H, W = 24, 32


def rectangle(label: str, x0: int, y0: int, x1: int, y1: int, score: float = 1.0) -> Instance:
    mask = np.zeros((H, W), dtype=bool)
    mask[y0:y1, x0:x1] = True
    return Instance(label, score, np.array([x0, y0, x1, y1], dtype=np.float64), mask)


@st.composite
def images(draw, scored: bool):
    def one():
        x0, y0 = draw(st.integers(0, W - 4)), draw(st.integers(0, H - 4))
        x1, y1 = draw(st.integers(x0 + 2, W)), draw(st.integers(y0 + 2, H))
        score = draw(st.integers(0, 40)) / 40 if scored else 1.0
        return rectangle(draw(st.sampled_from(["cup", "box"])), x0, y0, x1, y1, score)

    return [[one() for _ in range(draw(st.integers(0, 4)))] for _ in range(2)]


def brute_force(truth, predictions, label, threshold, rule):
    """COCO or VOC average precision by plain loops over Python numbers."""
    pairs = sorted(
        ((i, p) for i, image in enumerate(predictions) for p in image if p.label == label),
        key=lambda pair: -pair[1].score,
    )
    positives = sum(t.label == label for image in truth for t in image)
    if not positives:
        return math.nan
    taken, hits = set(), []
    for i, p in pairs:
        best, best_iou = None, -1.0
        for j, t in enumerate(truth[i]):
            if t.label != label or (rule == "coco" and (i, j) in taken):
                continue
            iou = np.sum(t.mask & p.mask) / np.sum(t.mask | p.mask)
            # COCO walks on with >=, so that the last of equals wins; VOC's argmax takes the first
            if iou > best_iou or (rule == "coco" and iou == best_iou):
                best, best_iou = j, iou
        hit = best is not None and best_iou >= threshold and (i, best) not in taken
        if hit:
            taken.add((i, best))
        hits.append(hit)
    recalls = [sum(hits[: k + 1]) / positives for k in range(len(hits))]
    precisions = [sum(hits[: k + 1]) / (k + 1) for k in range(len(hits))]
    if rule == "area":
        area, previous = 0.0, 0.0
        for k, r in enumerate(recalls):
            area += (r - previous) * max(precisions[k:])
            previous = r
        return area
    levels = [k / 10 for k in range(11)] if rule == "11-point" else list(np.linspace(0, 1, 101))
    at = [max((p for p, r in zip(precisions, recalls, strict=True) if r >= t), default=0.0) for t in levels]
    return sum(at) / len(at)


@settings(max_examples=100, deadline=None)
@given(images(scored=False), images(scored=True))
def test_coco_and_voc_agree_with_plain_loops(truth, predictions):
    coco = evaluate_instances(truth, predictions, ["cup", "box"])
    voc = {rule: evaluate_voc(truth, predictions, ["cup", "box"], rule) for rule in ("11-point", "area")}
    for label in ("cup", "box"):
        for threshold in (0.5, 0.7):
            key = f"ap{round(100 * threshold)}"
            for kind in ("segm", "bbox"):  # rectangles: boxes and masks overlap equally
                assert coco.per_class[label][f"{key}_{kind}"] == pytest.approx(
                    brute_force(truth, predictions, label, threshold, "coco"), abs=1e-9, nan_ok=True
                )
                for rule, metrics in voc.items():
                    assert metrics.per_class[label][f"{key}_{kind}"] == pytest.approx(
                        brute_force(truth, predictions, label, threshold, rule), abs=1e-9, nan_ok=True
                    )


def test_pycocotools_gives_the_same_numbers(capsys):
    coco_module = pytest.importorskip("pycocotools.coco")
    eval_module = pytest.importorskip("pycocotools.cocoeval")
    mask_module = pytest.importorskip("pycocotools.mask")
    random = np.random.default_rng(3)
    truth, predictions = [], []
    for _ in range(12):
        true = []
        for label in random.choice(["cup", "box", "can"], size=random.integers(0, 4)):
            x0, y0 = random.integers(0, W - 8), random.integers(0, H - 8)
            true.append(rectangle(str(label), x0, y0, x0 + random.integers(4, 8), y0 + random.integers(4, 8)))
        moved = []
        for t in true:
            x0, y0, x1, y1 = (t.box + random.integers(-1, 2, 4)).clip([0, 0, 1, 1], [W - 1, H - 1, W, H]).astype(int)
            moved.append(rectangle(t.label, x0, y0, x1, y1, float(random.random())))
            moved.append(rectangle("cup", x0, y0, x1, y1, float(random.random())))
        truth.append(true)
        predictions.append(moved)
    classes = ["cup", "box", "can"]
    metrics = evaluate_instances(truth, predictions, classes)

    def rle(instance):
        return mask_module.encode(np.asfortranarray(instance.mask.astype(np.uint8)))

    def entry(i, instance):
        x0, y0, x1, y1 = instance.box
        return {
            "image_id": i + 1,
            "category_id": classes.index(instance.label) + 1,
            "bbox": [x0, y0, x1 - x0, y1 - y0],
            "segmentation": rle(instance),
            "area": int(instance.mask.sum()),
            "iscrowd": 0,
        }

    annotations = [entry(i, t) for i, image in enumerate(truth) for t in image]
    for number, annotation in enumerate(annotations):
        annotation["id"] = number + 1
    reference = coco_module.COCO()
    reference.dataset = {
        "info": {},
        "images": [{"id": i + 1, "height": H, "width": W} for i in range(len(truth))],
        "categories": [{"id": k + 1, "name": c} for k, c in enumerate(classes)],
        "annotations": annotations,
    }
    reference.createIndex()
    found = reference.loadRes([{**entry(i, p), "score": p.score} for i, image in enumerate(predictions) for p in image])
    for kind in ("segm", "bbox"):
        evaluation = eval_module.COCOeval(reference, found, kind)
        evaluation.params.iouThrs = np.array([0.5, 0.7])
        evaluation.evaluate()
        evaluation.accumulate()
        precision = evaluation.eval["precision"][:, :, :, 0, 2]
        assert (precision >= 0).all()
        assert 0.05 < precision.mean() < 0.95  # a case that tells rules apart
        for t, name in enumerate(("map50", "map70")):
            assert getattr(metrics, f"{name}_{kind}") == pytest.approx(precision[t].mean(), abs=1e-12)
    capsys.readouterr()


def test_perfect_predictions_score_one_by_every_rule():
    truth = [[rectangle("cup", 1, 1, 9, 9), rectangle("box", 10, 5, 30, 20)], [rectangle("cup", 3, 3, 8, 8)]]
    for metrics in (
        evaluate_instances(truth, truth, ["cup", "box"]),
        evaluate_voc(truth, truth, ["cup", "box"], "11-point"),
        evaluate_voc(truth, truth, ["cup", "box"], "area"),
    ):
        assert metrics.as_dict("s.") == {
            "s.map50_segm": 1.0, "s.map70_segm": 1.0, "s.map50_bbox": 1.0, "s.map70_bbox": 1.0,
        }  # fmt: skip
        assert metrics.truth_count == {"cup": 2, "box": 1}


def test_rules_differ_where_they_should():
    # one of two objects found, first: recall stops at 1/2 with precision 1
    truth = [[rectangle("cup", 0, 0, 8, 8), rectangle("cup", 16, 0, 24, 8)]]
    found = [[rectangle("cup", 0, 0, 8, 8, 0.9)]]
    assert evaluate_instances(truth, found, ["cup"]).map50_segm == pytest.approx(51 / 101)
    assert evaluate_voc(truth, found, ["cup"], "11-point").map50_segm == pytest.approx(6 / 11)
    assert evaluate_voc(truth, found, ["cup"], "area").map50_segm == pytest.approx(0.5)
    # a second prediction whose best overlap is taken: VOC calls it false, COCO gives it to the neighbor it also covers
    truth = [[rectangle("cup", 0, 0, 10, 10), rectangle("cup", 0, 1, 10, 11)]]
    found = [[rectangle("cup", 0, 0, 10, 10, 0.9), rectangle("cup", 0, 0, 10, 10, 0.8)]]
    assert evaluate_instances(truth, found, ["cup"]).map50_bbox == pytest.approx(1.0)
    assert evaluate_voc(truth, found, ["cup"], "area").map50_bbox == pytest.approx(0.5)


def test_a_box_at_exactly_the_threshold_counts():
    truth = [[rectangle("cup", 0, 0, 10, 10)]]
    found = [[rectangle("cup", 0, 0, 10, 5, 0.5)]]  # IoU 0.5
    assert evaluate_instances(truth, found, ["cup"]).map50_segm == 1.0
    assert evaluate_voc(truth, found, ["cup"]).map50_segm == 1.0
    assert evaluate_instances(truth, found, ["cup"]).map70_segm == 0.0


@pytest.mark.parametrize("evaluate", [evaluate_instances, evaluate_voc])
def test_empty_sets_have_documented_answers(evaluate):
    cup = rectangle("cup", 1, 1, 9, 9)
    nothing_found = evaluate([[cup], []], [[], []], ["cup", "box"])
    assert nothing_found.map50_segm == 0.0
    assert nothing_found.per_class["cup"]["ap70_bbox"] == 0.0
    assert math.isnan(nothing_found.per_class["box"]["ap50_segm"])
    nothing_there = evaluate([[]], [[cup]], ["cup"])
    assert math.isnan(nothing_there.map50_bbox)
    no_images = evaluate([], [], ["cup"])
    assert math.isnan(no_images.map70_segm)
    # a class that never occurs has no part in the mean, even when it is (wrongly) predicted
    ghost = evaluate([[cup]], [[cup, rectangle("box", 1, 1, 9, 9)]], ["cup", "box"])
    assert ghost.map50_segm == 1.0


@pytest.mark.parametrize("evaluate", [evaluate_instances, evaluate_voc])
def test_distractors_in_the_truth_are_not_evaluated_but_still_fool(evaluate):
    cup, toy = rectangle("cup", 1, 1, 9, 9), rectangle("toy", 12, 1, 20, 9)
    assert evaluate([[cup, toy]], [[cup]], ["cup"]).map50_segm == 1.0
    fooled = evaluate([[cup, toy]], [[rectangle("cup", 12, 1, 20, 9, 2.0), cup]], ["cup"])
    assert fooled.map50_segm == pytest.approx(0.5)


@pytest.mark.parametrize("evaluate", [evaluate_instances, evaluate_voc])
def test_empty_predicted_masks_are_false_positives(evaluate):
    truth = [[rectangle("cup", 1, 1, 9, 9)]]
    empty = Instance("cup", 0.9, np.array([1.0, 1.0, 9.0, 9.0]), np.zeros((H, W), dtype=bool))
    metrics = evaluate(truth, [[empty]], ["cup"])
    assert metrics.map50_segm == 0.0
    assert metrics.map50_bbox == 1.0


@pytest.mark.parametrize("evaluate", [evaluate_instances, evaluate_voc])
def test_unusable_input_is_refused_in_one_line(evaluate):
    cup = rectangle("cup", 1, 1, 9, 9)
    small = Instance("cup", 1.0, cup.box, np.ones((4, 4), dtype=bool))
    for truth, predictions, classes, words in (
        ([[cup]], [], ["cup"], "0 images were predicted but 1"),
        ([[cup]], [[small]], ["cup"], "image 0: masks of different sizes"),
        ([[], [cup]], [[], [rectangle("cop", 1, 1, 9, 9)]], ["cup"], "image 1: 'cop' was predicted"),
        ([[cup]], [[rectangle("cup", 1, 1, 9, 9, math.nan)]], ["cup"], "score of 'cup' is nan"),
        ([[cup]], [[cup]], ["cup", "cup"], "repeat a name"),
    ):
        with pytest.raises(DataError, match=words) as error:
            evaluate(truth, predictions, classes)
        assert "\n" not in str(error.value)


def test_unknown_rule_names_the_nearest():
    with pytest.raises(ConfigError, match="11-point"):
        evaluate_voc([], [], ["cup"], "11point")
    with pytest.raises(ConfigError, match="area"):
        average_precision(np.array([1.0]), np.array([1.0]), "arae")


def test_the_core_does_not_import_the_library_by_itself():
    import subprocess

    code = (
        "import sys, icub_support.detection, icub_benchmarks.segmentation.voc; print('faster_coco_eval' in sys.modules)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "False"


boxes = st.tuples(st.integers(0, 20), st.integers(0, 15), st.integers(1, 12), st.integers(1, 9)).map(
    lambda b: (b[0], b[1], b[0] + b[2], b[1] + b[3])
)


@settings(deadline=None)
@given(st.lists(boxes, min_size=1, max_size=4), st.lists(boxes, min_size=1, max_size=4))
def test_box_and_mask_overlap_agree_on_rectangles(a, b):
    masks_a = [rectangle("a", *box).mask for box in a]
    masks_b = [rectangle("b", *box).mask for box in b]
    by_box = box_iou(np.array(a, dtype=float), np.array(b, dtype=float))
    np.testing.assert_allclose(mask_iou(masks_a, masks_b), by_box, atol=1e-12)
    assert by_box.shape == (len(a), len(b))
    np.testing.assert_allclose(box_iou(np.array(b, dtype=float), np.array(a, dtype=float)), by_box.T)


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.lists(boxes, max_size=3), min_size=2, max_size=2),
    st.lists(st.lists(boxes, max_size=6), min_size=2, max_size=2),
)
def test_average_recall_is_the_area_under_recall(truth, proposals):
    def stack(lists):
        return [np.array(rows, dtype=float).reshape(-1, 4) for rows in lists]

    best = best_overlaps(stack(truth), stack(proposals))
    assert len(best) == sum(len(rows) for rows in truth)
    if not len(best):
        assert math.isnan(average_recall(best))
        return
    grid = np.linspace(0.5, 1.0, 501)
    area = np.trapezoid([recall(best, t) for t in grid], grid) / 0.5
    assert average_recall(best) == pytest.approx(area, abs=2e-3)
    assert (best_overlaps(stack(truth), stack(proposals), top=2) <= best).all()


def test_average_recall_by_hand():
    truth = [np.array([[0.0, 0.0, 10.0, 10.0]]), np.array([[0.0, 0.0, 4.0, 4.0]]), np.zeros((0, 4))]
    proposals = [np.array([[0.0, 0.0, 10.0, 8.0], [0.0, 0.0, 10.0, 10.0]]), np.zeros((0, 4)), np.zeros((1, 4))]
    assert average_recall(best_overlaps(truth, proposals)) == pytest.approx((1.0 + 0.0) / 2)
    assert average_recall(best_overlaps(truth, proposals, top=1)) == pytest.approx(2 * 0.3 / 2)
    with pytest.raises(DataError, match="2 images"):
        best_overlaps(truth, proposals[:2])
