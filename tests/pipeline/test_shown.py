"""The main job's teaching and examination as data sets: what a benchmark compares segmenters on."""

import numpy as np
import pytest

from icub_core.pipeline.settings import SeeSettings, TeachSettings
from icub_core.pipeline.shown import shown_and_seen


def test_objects_are_shown_one_after_another_and_then_stand_among_strangers_on_a_table():
    teach = TeachSettings(objects=["006_mustard_bottle", "005_tomato_soup_can"], frames=12)
    shares = []
    train, test = shown_and_seen(
        3, teach, SeeSettings(frames=4, strangers=4), progress=lambda share, text: shares.append(share)
    )
    assert train.classes == test.classes == tuple(teach.objects)
    labels = [instances[0].label for _, instances in train]
    assert labels == sorted(labels, key=teach.objects.index)
    assert set(labels) == set(teach.objects)
    assert len(test) == 4
    assert shares == sorted(shares)
    for frame, instances in test:
        assert {i.label for i in instances} <= set(teach.objects)
        assert all(i.mask.shape == frame.rgb.shape[:2] for i in instances)
    again, _ = shown_and_seen(3, teach, SeeSettings(frames=1, strangers=4))
    assert np.array_equal(train[0][0].rgb, again[0][0].rgb)
    with pytest.raises(IndexError):
        test[4]
