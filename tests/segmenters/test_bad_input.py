"""What comes from outside may be odd or bad: it is used or refused in one line, and the learner stays usable."""

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import CheckpointError, DataError
from icub_core.geometry import pinhole
from icub_core.interfaces.feature_extractor import RpnCells
from icub_segmenters.baselines.linear_softmax import LinearSoftmax
from icub_segmenters.baselines.mask_rcnn import MaskRcnn
from icub_segmenters.baselines.o_os import OnlineObjectSegmentation
from icub_segmenters.baselines.ours_serial import OursSerial
from icub_segmenters.baselines.output_layers import OutputLayers
from icub_segmenters.feature_extractors.compact import CompactMaskRcnn
from icub_segmenters.heads.linear import Linear
from icub_segmenters.online_segmenter import OnlineSegmenter
from icub_support.detection import evaluate_instances
from icub_testing.tiny import tiny_class
from icub_testing.tiny.things import draw_frame


@pytest.fixture(scope="module")
def compact():
    return CompactMaskRcnn(proposals=20)


def frame_of(size, box, seed=0):
    """Noise with a bright rectangle (x0, y0, x1, y1), and its instance."""
    rng = np.random.default_rng(seed)
    rgb = rng.integers(60, 120, (*size, 3)).astype(np.uint8)
    mask = np.zeros(size, dtype=bool)
    mask[box[1] : box[3], box[0] : box[2]] = True
    rgb[mask] = (230, 40, 40)
    frame = RgbdFrame(rgb, np.zeros(size, np.float32), pinhole(size[1], size[0], 0.74), np.eye(4))
    return frame, (Instance.from_mask("thing", mask),)


@pytest.mark.parametrize(
    ("size", "box"),
    [
        ((1, 1), (0, 0, 1, 1)),
        ((9, 300), (100, 2, 140, 7)),
        ((700, 20), (3, 300, 15, 360)),
        ((480, 640), (200, 150, 330, 300)),
        ((60, 80), (0, 0, 80, 60)),  # the object is the whole image
    ],
)
def test_images_of_any_size_are_learned_from_and_segmented_at_their_size(compact, falkon, size, box):
    segmenter = OnlineSegmenter(compact, falkon, composites=1)
    segmenter.observe(*frame_of(size, box))
    segmenter.observe(*frame_of((240, 320), (100, 80, 180, 170), seed=1))
    assert segmenter.update().classes == ("thing",)
    for found in segmenter.segment(frame_of(size, box, seed=2)[0]):
        assert found.mask.shape == size
        assert found.mask.any()


def test_an_instance_of_one_pixel_is_enough_to_go_on(windows, falkon, painter, teacher):
    segmenter = OnlineSegmenter(windows, falkon, composites=1)
    frame, _ = painter([])
    mask = np.zeros((96, 128), dtype=bool)
    mask[40, 60] = True
    for sample in [*teacher(["red"]), (frame, (Instance.from_mask("speck", mask),))]:
        segmenter.observe(*sample)
    report = segmenter.update()
    assert report.classes == ("red", "speck")
    assert report.samples["speck"] >= 1
    assert segmenter.segment(painter([("red", 60, 40, 15)], seed=9)[0])[0].label == "red"


class Failing(tiny_class("feature_extractor")):
    """An extractor, some features of which are not finite when told so."""

    broken = ""

    def region_features(self, features, boxes):
        return self._spoilt("regions", super().region_features(features, boxes))

    def mask_features(self, features, boxes):
        return self._spoilt("pixels", super().mask_features(features, boxes))

    def rpn_cells(self, features):
        cells = super().rpn_cells(features)
        return RpnCells(self._spoilt("cells", cells.features), cells.anchors, cells.types)

    def _spoilt(self, what, X):
        return torch.where(torch.rand(X.shape) < 0.01, float("inf"), X) if what == self.broken else X


def found_by(segmenter, seed=5):
    frame, _ = draw_frame({"red": (40, 45, 17), "green": (110, 70, 16)}, seed=seed)
    return [(i.label, i.score) for i in segmenter.segment(frame)]


@pytest.mark.parametrize("broken", ["regions", "pixels", "cells"])
def test_features_that_are_not_finite_are_refused_and_nothing_of_the_frame_is_kept(broken, falkon):
    spoilt, clean = (
        OnlineSegmenter(Failing(), falkon, composites=0, masks="online", proposals="online") for _ in range(2)
    )
    for number, color in enumerate(["red", "green", "red", "green"]):
        if number == 2:
            spoilt.extractor.broken = broken
            with pytest.raises(DataError, match="not finite"):
                spoilt.observe(*draw_frame({"blue": (60, 50, 16)}, seed=40))  # a class that is then never learned
            spoilt.extractor.broken = ""
        for segmenter in (spoilt, clean):
            segmenter.observe(*draw_frame({color: (50 + 10 * number, 55, 16)}, seed=number))
    assert spoilt.update().classes == clean.update().classes == ("red", "green")
    assert found_by(spoilt) == found_by(clean)
    spoilt.extractor.broken = broken
    with pytest.raises(DataError, match="not finite"):
        found_by(spoilt)
    spoilt.extractor.broken = ""
    assert found_by(spoilt) == found_by(clean)


@pytest.mark.parametrize("store_features", [False, True])
def test_output_layers_leave_out_a_frame_whose_features_are_not_finite(store_features):
    extractor = Failing()
    segmenter = OutputLayers(extractor, epochs=2, store_features=store_features)
    for number, color in enumerate(["red", "green", "red", "green"]):
        segmenter.observe(*draw_frame({color: (50 + 10 * number, 55, 16)}, seed=number))
    segmenter.update()
    before = found_by(segmenter)
    extractor.broken = "regions"
    with pytest.raises(DataError, match=r"frame \d are not finite; it is left out"):
        segmenter.update()
    assert segmenter.classes == ("red", "green")
    extractor.broken = ""
    assert found_by(segmenter) == before
    assert sum(segmenter.update().samples.values()) == 3


def test_labels_that_were_never_taught_are_no_errors_at_test(windows, falkon, painter, teacher):
    segmenter = OnlineSegmenter(windows, falkon, composites=0)
    for sample in teacher(["red"]):
        segmenter.observe(*sample)
    segmenter.update()
    frame, truth = painter([("red", 30, 40, 15), ("yellow", 95, 50, 16)], seed=11)
    metrics = evaluate_instances([truth], [segmenter.segment(frame)], segmenter.classes)
    assert set(metrics.per_class) == {"red"}
    assert metrics.map50_segm > 0.9


BASELINES = {
    "ours": lambda extractor, falkon: OnlineSegmenter(extractor, falkon, composites=1),
    "faithful": lambda extractor, falkon: OnlineSegmenter(extractor, falkon, mode="faithful", composites=0),
    "o_os": lambda extractor, falkon: OnlineObjectSegmentation(extractor, falkon, batches=2),
    "linear_softmax": lambda extractor, falkon: LinearSoftmax(
        extractor, lambda: Linear(epochs=20, learning_rate=0.01), composites=0
    ),
    "output_layers": lambda extractor, falkon: OutputLayers(extractor, epochs=2),
    "ours_serial": lambda extractor, falkon: OursSerial(tiny_class("feature_extractor")(), falkon, composites=0),
    "mask_rcnn": lambda extractor, falkon: MaskRcnn(epochs=1),
}


@pytest.mark.parametrize("name", BASELINES)
def test_bad_masks_and_foreign_files_are_refused_by_all_and_learning_goes_on(
    name, windows, falkon, painter, teacher, tmp_path
):
    segmenter = BASELINES[name](windows, falkon)
    frame, (instance,) = painter([("red", 60, 40, 15)])
    foreign = Instance("red", 1.0, instance.box, np.ones((10, 10), dtype=bool))
    empty = Instance("red", 1.0, instance.box, np.zeros((96, 128), dtype=bool))
    for bad in (foreign, empty):
        with pytest.raises(DataError, match="the mask of 'red' is"):
            segmenter.observe(frame, (bad,))
    for sample in teacher(["red", "blue"], count=2):
        segmenter.observe(*sample)
    segmenter.observe(painter([])[0], ())
    report = segmenter.update()
    assert report.classes == ("red", "blue")
    assert all(count >= 2 for count in report.samples.values())
    before = [(i.label, i.score) for i in segmenter.segment(frame)]
    segmenter.save(tmp_path / "good")
    (file,) = (tmp_path / "good").iterdir()
    (tmp_path / "cut").mkdir()
    (tmp_path / "cut" / file.name).write_bytes(file.read_bytes()[:-200])
    (tmp_path / "foreign").mkdir()
    save_file({"weight": torch.ones(3)}, tmp_path / "foreign" / file.name)
    for folder in ("cut", "foreign", "missing"):
        with pytest.raises(CheckpointError) as error:
            segmenter.load(tmp_path / folder)
        assert folder in str(error.value)
        assert "\n" not in str(error.value)
    assert [(i.label, i.score) for i in segmenter.segment(frame)] == before
