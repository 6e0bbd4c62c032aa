"""The main job's teaching and examination as data sets: what a benchmark compares segmenters on."""

import numpy as np
import pytest

from icub_benchmarks.segmentation.recording import taught_and_seen
from icub_pipelines.settings import SeeSettings


def test_objects_are_taught_one_after_another_and_then_stand_among_distractors_on_a_table():
    names = ["006_mustard_bottle", "005_tomato_soup_can"]
    shares = []
    train, test = taught_and_seen(
        3, names, 12, SeeSettings(frames=4, distractors=4), progress=lambda share, text: shares.append(share)
    )
    assert train.classes == test.classes == tuple(names)
    labels = [instances[0].label for _, instances in train]
    assert labels == sorted(labels, key=names.index)
    assert set(labels) == set(names)
    assert len(test) == 4
    assert shares == sorted(shares)
    for frame, instances in test:
        assert {i.label for i in instances} <= set(names)
        assert all(i.mask.shape == frame.rgb.shape[:2] for i in instances)
    again, _ = taught_and_seen(3, names, 12, SeeSettings(frames=1, distractors=4))
    assert np.array_equal(train[0][0].rgb, again[0][0].rgb)
    with pytest.raises(IndexError):
        test[4]
