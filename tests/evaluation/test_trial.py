"""A trial promises: every training frame once and in order, one update, honest times, metrics of what was found."""

from __future__ import annotations

import importlib.util
import json
import math
import time
from pathlib import Path

import numpy as np
import pytest

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import DataError, NotFittedError
from icub_core.evaluation.trial import Trial, run_trial
from icub_core.geometry import pinhole
from icub_core.interfaces.dataset import Dataset
from icub_core.interfaces.segmenter import Segmenter, UpdateReport

COLOURS = {"red": (200, 20, 20), "green": (20, 200, 20), "blue": (20, 20, 200)}


class Squares(Dataset):
    """Coloured squares on black."""

    def __init__(self, frames):
        self._frames = frames

    @property
    def classes(self):
        return tuple(COLOURS)

    def __len__(self):
        return len(self._frames)

    def __getitem__(self, index):
        rgb = np.zeros((20, 60, 3), np.uint8)
        instances = []
        for i, label in enumerate(self._frames[index]):
            mask = np.zeros((20, 60), bool)
            mask[5:15, 20 * i + 3 : 20 * i + 13] = True
            rgb[mask] = COLOURS[label]
            instances.append(Instance.from_mask(label, mask))
        frame = RgbdFrame(rgb, np.zeros((20, 60), np.float32), pinhole(60, 20, 0.7), np.eye(4), stamp=float(index))
        return frame, tuple(instances)


class ByColour(Segmenter):
    """Learns the mean colour of each class and finds the pixels that have it."""

    def __init__(self):
        self.calls, self._seen, self._known = [], {}, {}

    def observe(self, frame, instances):
        self.calls.append(frame.stamp)
        time.sleep(0.002)
        for instance in instances:
            self._seen.setdefault(instance.label, []).append(frame.rgb[instance.mask].mean(axis=0))

    def update(self):
        self.calls.append("update")
        time.sleep(0.15)
        self._known = {label: np.mean(colours, axis=0) for label, colours in self._seen.items()}
        return UpdateReport(0.15, {"detection": 0.02, "masks": 0.01}, self.classes)

    def segment(self, frame):
        if not self._known:
            raise NotFittedError("nothing was taught")
        found = []
        for label, colour in self._known.items():
            mask = np.abs(frame.rgb - colour).sum(axis=2) < 30
            if mask.any():
                found.append(Instance.from_mask(label, mask, score=1.0))
        return tuple(found)

    @property
    def classes(self):
        return tuple(self._known)

    def save(self, path):
        raise NotImplementedError

    def load(self, path):
        raise NotImplementedError


def test_a_trial_teaches_in_order_updates_once_and_measures():
    segmenter, shares = ByColour(), []
    train = Squares([["red"], ["green"], ["red", "green"]])
    test = Squares([["green", "red"], ["red", "blue"]])
    trial = run_trial(segmenter, train, test, lambda share, text: shares.append(share))
    assert segmenter.calls == [0.0, 1.0, 2.0, "update"]
    assert trial.metrics.map50_segm == 1.0
    assert set(trial.metrics.per_class) == {"red", "green"}  # blue was never taught
    assert (trial.train_frames, trial.test_frames) == (3, 2)
    assert 0.006 <= trial.feature_seconds < 0.15  # the update is not in it
    assert trial.update_seconds >= 0.15
    assert trial.parts == {"detection": 0.02, "masks": 0.01}
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert Trial.from_dict(json.loads(json.dumps(trial.as_dict()))) == trial


def test_two_instances_taken_for_one_are_no_hit():
    trial = run_trial(ByColour(), Squares([["red"]]), Squares([["red", "red"]]), lambda share, text: None)
    assert trial.metrics.map70_segm == 0.0  # one mask over both covers each by a half
    assert math.isclose(trial.metrics.map50_segm, 51 / 101)


def test_nothing_to_learn_or_to_examine_is_refused():
    with pytest.raises(DataError, match="none of the 2 training frames"):
        run_trial(ByColour(), Squares([[], []]), Squares([["red"]]), lambda share, text: None)
    with pytest.raises(DataError, match="no readable frame"):
        run_trial(ByColour(), Squares([["red"]]), Squares([]), lambda share, text: None)


@pytest.fixture(scope="module")
def benchmark():
    path = Path(__file__).parents[2] / "benchmarks" / "segmentation.py"
    spec = importlib.util.spec_from_file_location("segmentation_benchmark", path)
    module = importlib.util.module_from_spec(spec)
    import sys

    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def trial_with(map50, update_seconds, map70=0.5):
    from icub_core.evaluation.detection import DetectionMetrics

    return Trial(DetectionMetrics(map50, map70, map50, map70), 2.0, update_seconds, {"detection": 0.1}, 0.05, 9, 9)


def test_the_benchmark_reports_means_deviations_and_ratios_run_by_run(benchmark):
    trials = {
        ("tabletop", "falkon"): [trial_with(0.80, 1.0), trial_with(0.90, 2.0)],
        ("tabletop", "output_layers"): [trial_with(0.70, 100.0), trial_with(0.70, 100.0)],
        ("tabletop", "o_os"): [trial_with(0.75, 1.0, 0.49), trial_with(0.75, 1.0, 0.49)],
    }
    figures = benchmark._figures(trials)
    segm = figures["segmentation.tabletop.falkon.map50_segm"]
    assert (segm.value, segm.n) == (pytest.approx(0.85), 2)
    assert segm.spread == pytest.approx(0.1 / math.sqrt(2))
    assert figures["segmentation.speedup_output_layers"].value == pytest.approx((100 + 50) / 2)
    assert figures["segmentation.map50_segm_minus_output_layers"].value == pytest.approx(15.0)
    assert figures["segmentation.ours_minus_oos"].value == pytest.approx(1.0)  # the smallest of the four gains


def test_the_benchmark_names_unknown_tasks_and_methods(benchmark, capsys):
    assert benchmark.main(["--tasks", "tabeltop"]) == 1
    assert "Did you mean 'tabletop'" in " ".join(capsys.readouterr().err.split())
