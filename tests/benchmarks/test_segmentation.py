"""A trial promises: every training frame once and in order, one update, honest times, metrics of what was found."""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from icub_benchmarks.segmentation import run
from icub_benchmarks.segmentation.head_clock import heads_share
from icub_benchmarks.segmentation.methods import Method
from icub_benchmarks.segmentation.trial import Trial, run_trial
from icub_benchmarks.segmentation.trial_report import markdown_table, plot_over_time
from icub_benchmarks.segmentation.trials import Run
from icub_core.data import Instance, RgbdFrame
from icub_core.errors import ConfigError, DataError, NotFittedError
from icub_core.geometry import pinhole
from icub_core.interfaces.dataset import Dataset
from icub_core.interfaces.segmenter import Segmenter, UpdateReport
from icub_segmenters.heads.linear import Linear
from icub_segmenters.procedure import Procedure
from icub_support.detection import MEAN_NAMES, DetectionMetrics

COLORS = {"red": (200, 20, 20), "green": (20, 200, 20), "blue": (20, 20, 200)}


class Squares(Dataset):
    """Colored squares on black."""

    def __init__(self, frames):
        self._frames = frames

    @property
    def classes(self):
        return tuple(COLORS)

    def __len__(self):
        return len(self._frames)

    def __getitem__(self, index):
        rgb = np.zeros((20, 60, 3), np.uint8)
        instances = []
        for i, label in enumerate(self._frames[index]):
            mask = np.zeros((20, 60), bool)
            mask[5:15, 20 * i + 3 : 20 * i + 13] = True
            rgb[mask] = COLORS[label]
            instances.append(Instance.from_mask(label, mask))
        frame = RgbdFrame(rgb, np.zeros((20, 60), np.float32), pinhole(60, 20, 0.7), np.eye(4), stamp=float(index))
        return frame, tuple(instances)


class ByColor(Segmenter):
    """Learns the mean color of each class and finds the pixels that have it."""

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
        self._known = {label: np.mean(colors, axis=0) for label, colors in self._seen.items()}
        return UpdateReport(0.15, {"detection": 0.02, "masks": 0.01}, self.classes)

    def segment(self, frame):
        if not self._known:
            raise NotFittedError("nothing was taught")
        found = []
        for label, color in self._known.items():
            mask = np.abs(frame.rgb - color).sum(axis=2) < 30
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
    segmenter, shares = ByColor(), []
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
    assert trial.voc["area"]["map50_bbox"] == trial.voc["11-point"]["map70_segm"] == 1.0
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert Trial.from_dict(json.loads(json.dumps(trial.as_dict()))) == trial


def test_two_instances_taken_for_one_are_no_hit():
    trial = run_trial(ByColor(), Squares([["red"]]), Squares([["red", "red"]]), lambda share, text: None)
    assert trial.metrics.map70_segm == 0.0  # one mask over both covers each by a half
    assert math.isclose(trial.metrics.map50_segm, 51 / 101)
    assert math.isclose(trial.voc["11-point"]["map50_segm"], 6 / 11)
    assert math.isclose(trial.voc["area"]["map50_segm"], 0.5)


def test_nothing_to_learn_or_to_examine_is_refused():
    with pytest.raises(DataError, match="none of the 2 training frames"):
        run_trial(ByColor(), Squares([[], []]), Squares([["red"]]), lambda share, text: None)
    with pytest.raises(DataError, match="no readable frame"):
        run_trial(ByColor(), Squares([["red"]]), Squares([]), lambda share, text: None)


def trial_with(map50, update_seconds, map70=0.5):
    return Trial(DetectionMetrics(map50, map70, map50, map70), 2.0, update_seconds, {"detection": 0.1}, 0.05, 9, 9)


def test_the_benchmark_reports_means_deviations_and_ratios_run_by_run():
    def runs(*trials):
        return [Run(trial, 0.1) for trial in trials]

    measured = {
        ("tabletop", "ours"): runs(trial_with(0.80, 1.0), trial_with(0.90, 2.0)),
        ("tabletop", "output_layers"): runs(trial_with(0.70, 100.0), trial_with(0.70, 100.0)),
        ("tabletop", "o_os"): runs(trial_with(0.75, 1.0, 0.49), trial_with(0.75, 1.0, 0.49)),
    }
    figures = run._figures(measured)
    segm = figures["segmentation.tabletop.ours.map50_segm"]
    assert (segm.value, segm.n) == (pytest.approx(0.85), 2)
    assert segm.spread == pytest.approx(0.1 / math.sqrt(2))
    assert figures["segmentation.speedup_output_layers"].value == pytest.approx((100 + 50) / 2)
    assert figures["segmentation.map50_segm_minus_output_layers"].value == pytest.approx(15.0)
    assert figures["segmentation.ours_minus_oos"].value == pytest.approx(1.0)  # the smallest of the four gains
    assert figures["segmentation.heads_share"].value == pytest.approx(0.1)


def test_a_method_is_a_configuration_and_some_columns_of_the_features():
    method = Method("few", "falkon,segmenter.procedure.jittered_boxes=2,features=0:256")
    segmenter = method.segmenter(method.config(0, "cpu", "tabletop", Path()))
    assert segmenter.procedure.jittered_boxes == 2 != Procedure().jittered_boxes
    assert segmenter.extractor.region_dim == 256
    wrong = Method("wrong", "falkon,segmenter.procedure.jitered_boxes=2")
    with pytest.raises(ConfigError, match="jitered_boxes"):
        wrong.config(0, "cpu", "tabletop", Path())


def test_a_report_has_a_row_a_method_and_a_plot(tmp_path):
    trials = [trial_with(0.8, 1.0), trial_with(0.9, 2.0)]
    table = markdown_table({"ours": trials, "not measured": []})
    assert table.count("\n") == 3
    assert "| ours | 85.0 ± 7.1 |" in table
    by_rule = {rule: dict.fromkeys(MEAN_NAMES, value) for rule, value in (("11-point", 0.25), ("area", 0.75))}
    known = [replace(trial, voc=by_rule) for trial in trials]
    by_voc = markdown_table({"ours": known, "older": trials, "mixed": [known[0], trials[1]]}).split("PASCAL VOC")[1]
    assert "| ours | 25.0 ± 0.0 | 25.0 ± 0.0 | 25.0 ± 0.0 | 25.0 ± 0.0 | 75.0 ± 0.0 |" in by_voc
    assert by_voc.count("n/a (0 of 2 trials)") == by_voc.count("n/a (1 of 2 trials)") == 8
    assert by_voc.index("| ours |") < by_voc.index("| older | n/a (0 of 2") < by_voc.index("| mixed | n/a (1 of 2")
    plot_over_time(tmp_path / "plot.png", "title", {"ours": {"ours": trials}, "none": {}})
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_the_share_of_the_heads_is_the_time_in_their_decision_functions():
    head = Linear()
    head.fit(torch.randn(20, 3), torch.ones(20, 1))

    class Asking(ByColor):
        def segment(self, frame):
            time.sleep(0.01)
            head.decision_function(torch.zeros(2, 3))
            return ()

    share = heads_share(Asking(), [Squares([["red"]])[0][0]] * 5)
    assert 0 < share < 0.5


def test_the_benchmark_names_unknown_tasks_and_methods():
    with pytest.raises(ConfigError, match="Did you mean 'tabletop'"):
        run.main(["--tasks", "tabeltop"])
    with pytest.raises(ConfigError, match="Did you mean 'falkon'"):
        run.main(["--methods", "falcon"])


@pytest.mark.slow
def test_the_quick_benchmark_measures_the_figures_that_are_to_be_reached_and_resumes(tmp_path):
    arguments = ["--quick", "--tasks", "tabletop", "--work", str(tmp_path / "work"), "--results", str(tmp_path)]
    assert run.main([*arguments, "--methods", "ours", "o_os"]) == 0
    trials = {file: file.stat().st_mtime_ns for file in (tmp_path / "work").iterdir()}
    assert run.main([*arguments, "--methods", "ours", "o_os", "output_layers"]) == 0
    assert all(file.stat().st_mtime_ns == time for file, time in trials.items())
    figures = json.loads((tmp_path / "segmentation.json").read_text())["figures"]
    for key in ("speedup_output_layers", "map50_segm_minus_output_layers", "ours_minus_oos", "heads_share"):
        assert math.isfinite(figures[f"segmentation.{key}"]["value"])
    assert "| output_layers |" in (tmp_path / "segmentation.md").read_text()
    assert (tmp_path / "segmentation_tabletop.png").is_file()
