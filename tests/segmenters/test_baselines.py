"""What the segmenters to compare with promise beyond the contract of their kind."""

import pytest
import torch

from icub_core.errors import NotFittedError
from icub_segmenters.baselines.linear_softmax import LinearSoftmax, SoftmaxDetector
from icub_segmenters.baselines.ours_serial import OursSerial
from icub_segmenters.heads.linear import Linear
from icub_segmenters.minibootstrap import Minibootstrap
from icub_segmenters.online_rpn import with_proposals
from icub_testing.tiny import tiny_class
from icub_testing.tiny.things import draw_frame


class Counting(tiny_class("feature_extractor")):
    """Counts what is extracted."""

    def __init__(self):
        super().__init__()
        self.extracted = 0

    def extract(self, rgb):
        self.extracted += 1
        return super().extract(rgb)


def shown(segmenter, colors=("red", "blue"), count=3):
    for color in colors:
        for i in range(count):
            segmenter.observe(*draw_frame({color: (45 + 18 * i, 45 + 9 * i, 16)}, seed=i))


def test_ours_serial_extracts_a_second_time_after_the_last_frame_with_proposals_of_its_own(falkon):
    extractor = Counting()
    serial = OursSerial(extractor, falkon, composites=0)
    shown(serial)
    assert extractor.extracted == 6
    assert len(serial.store) == 0  # only cells are kept so far
    report = serial.update()
    assert extractor.extracted == 12
    assert {"rpn", "features", "detection", "masks"} == set(report.parts)
    assert len(serial.store) > 0
    image = extractor.extract(draw_frame({"red": (60, 60, 17)}, seed=9)[0].rgb)
    proposed = with_proposals(serial.rpn, extractor, image)
    own, _ = serial.rpn.propose(extractor.rpn_cells(proposed), proposed.image_size)
    assert torch.equal(proposed.proposals, own)


def test_ours_serial_has_nothing_to_learn_from_frames_without_instances(falkon):
    serial = OursSerial(Counting(), falkon)
    serial.observe(draw_frame({}, seed=1)[0], ())
    with pytest.raises(NotFittedError, match="at least one frame with an instance"):
        serial.update()


def test_linear_scores_order_regions_as_softmax_probabilities_do():
    detector = SoftmaxDetector(Linear, Minibootstrap(1, 10), shared=True, repool=False)
    head = Linear()
    X = torch.randn(40, 5, generator=torch.Generator().manual_seed(0)) * 20
    head.weight, head.bias = torch.eye(5)[:, :3], torch.tensor([0.5, 0.0, -0.5])
    detector.heads, detector._known = {0: head}, torch.ones(3, dtype=torch.bool)
    scores = detector.scores(X)
    logits = torch.cat([torch.zeros(40, 1), X @ head.weight + head.bias], dim=1).double()
    probability = logits.softmax(dim=1)[:, 1:]
    assert torch.isfinite(scores).all()
    torch.testing.assert_close(scores.double().sigmoid(), probability, atol=1e-6, rtol=1e-4)


def test_the_linear_baseline_sees_all_negatives_and_reports_doubtful_finds_too(falkon):
    baseline = LinearSoftmax(Counting(), lambda: Linear(epochs=5), negatives=500, composites=0)
    assert (baseline.minibootstrap.batches, baseline.minibootstrap.batch_size) == (1, 500)
    assert baseline.procedure.min_score < -5
    shown(baseline)
    assert baseline.update().classes == ("red", "blue")
