"""What comes from outside may be odd or bad: it is used or refused in one line, and the learner stays usable."""

import numpy as np
import pytest
import torch

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import CheckpointError, DataError
from icub_core.evaluation.detection import evaluate_instances
from icub_core.geometry import pinhole
from icub_segmenters.baselines.linear_softmax import LinearSoftmax
from icub_segmenters.baselines.o_os import OnlineObjectSegmentation
from icub_segmenters.baselines.output_layers import OutputLayers
from icub_segmenters.feature_extractors.compact import CompactMaskRcnn
from icub_segmenters.heads.linear import Linear
from icub_segmenters.online_segmenter import OnlineSegmenter


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
def test_images_of_any_size_are_learnt_from_and_segmented_at_their_size(compact, falkon, size, box):
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


class Failing:
    """An extractor whose features are not finite when told so."""

    def __init__(self, extractor):
        self._extractor, self.broken = extractor, False

    def __getattr__(self, name):
        return getattr(self._extractor, name)

    def region_features(self, features, boxes):
        X = self._extractor.region_features(features, boxes)
        return torch.full_like(X, float("nan")) if self.broken else X


def test_features_that_are_not_finite_are_refused_and_nothing_of_the_frame_is_kept(windows, falkon, painter, teacher):
    failing = Failing(windows)
    spoilt = OnlineSegmenter(failing, falkon, composites=0)
    clean = OnlineSegmenter(windows, falkon, composites=0)
    for number, (frame, instances) in enumerate(teacher(["red", "green"], count=3)):
        if number == 2:
            failing.broken = True
            with pytest.raises(DataError, match="not finite"):
                spoilt.observe(*painter([("blue", 60, 40, 15)]))  # a class that is then never learnt
            failing.broken = False
        spoilt.observe(frame, instances)
        clean.observe(frame, instances)
    assert spoilt.update().classes == clean.update().classes == ("red", "green")
    frame, _ = painter([("red", 40, 40, 15), ("green", 90, 50, 14)], seed=5)
    assert [(i.label, i.score) for i in spoilt.segment(frame)] == [(i.label, i.score) for i in clean.segment(frame)]


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
    "o_os": lambda extractor, falkon: OnlineObjectSegmentation(extractor, falkon, batches=2),
    "linear_softmax": lambda extractor, falkon: LinearSoftmax(
        extractor, lambda: Linear(epochs=20, learning_rate=0.01), composites=0
    ),
    "output_layers": lambda extractor, falkon: OutputLayers(extractor, epochs=2),
}


@pytest.mark.parametrize("name", BASELINES)
def test_baselines_refuse_bad_masks_and_foreign_files_and_go_on(name, windows, falkon, painter, teacher, tmp_path):
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
    assert segmenter.update().classes == ("red", "blue")
    before = [(i.label, i.score) for i in segmenter.segment(frame)]
    segmenter.save(tmp_path / "good")
    (file,) = (tmp_path / "good").iterdir()
    (tmp_path / "cut").mkdir()
    (tmp_path / "cut" / file.name).write_bytes(file.read_bytes()[:-200])
    for folder in ("cut", "missing"):
        with pytest.raises(CheckpointError):
            segmenter.load(tmp_path / folder)
    assert [(i.label, i.score) for i in segmenter.segment(frame)] == before
