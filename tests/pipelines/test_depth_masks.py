import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from icub_core.data import RgbdFrame
from icub_pipelines.depth_masks import CoherentMasks, closest_blob, overlap


def room(height=120, width=160):
    """A wall at 1.2 m and a table that rises towards the camera at the bottom of the image."""
    depth = np.full((height, width), 1.2, dtype=np.float32)
    depth[80:] = np.linspace(1.1, 0.6, 40, dtype=np.float32)[:, None]
    return depth


def frame_of(depth):
    return RgbdFrame(np.zeros((*depth.shape, 3), np.uint8), depth, np.eye(3), np.eye(4))


def test_finds_exactly_the_object_in_front():
    depth = room()
    truth = np.zeros(depth.shape, bool)
    truth[30:70, 50:90] = True
    depth[truth] = 0.45
    assert np.array_equal(closest_blob(depth), truth)


def test_of_two_objects_takes_the_closer_one():
    depth = room()
    depth[20:50, 20:50] = 0.50
    depth[20:50, 90:120] = 0.42
    mask = closest_blob(depth)
    assert mask[30, 100]
    assert not mask[30, 30]


def test_an_object_in_front_of_a_surface_within_its_depth_extent_is_cut_at_the_jump():
    depth = room()
    depth[:, 80:] = 0.55  # a shelf 10 cm behind the object
    depth[40:80, 60:100] = 0.45
    mask = closest_blob(depth)
    assert mask[60, 90]
    assert not mask[60, 130]


@pytest.mark.parametrize("depth", [np.zeros((60, 80), np.float32), np.full((60, 80), np.nan, np.float32)])
def test_nothing_measured_is_no_blob(depth):
    assert closest_blob(depth) is None


def test_speckle_in_front_is_not_taken_for_the_object():
    depth = room()
    depth[30:70, 50:90] = 0.45
    depth[5, 5:25] = 0.2
    mask = closest_blob(depth)
    assert mask[50, 70]
    assert not mask[5, 10]


def square(left):
    mask = np.zeros((40, 60), bool)
    mask[10:30, left : left + 20] = True
    return mask


def passed(masks):
    stream, filter_ = [], CoherentMasks()
    for i, mask in enumerate(masks):
        frame = frame_of(np.full((40, 60), 1 + i, np.float32))
        out = filter_.push(frame, mask)
        if out is not None:
            stream.append(round(float(out[0].depth[0, 0])) - 1)
    return stream, filter_


def test_frames_that_agree_with_both_neighbors_pass_one_late():
    stream, filter_ = passed([square(2), square(3), square(4), square(5)])
    assert stream == [0, 1, 2]
    assert filter_.rejected == 0


def test_a_jump_rejects_the_frames_on_both_of_its_sides():
    stream, filter_ = passed([square(0), square(1), square(40), square(39), square(38), square(37)])
    assert stream == [0, 3, 4]
    assert filter_.rejected == 2


def test_a_lost_blob_interrupts_the_stream():
    stream, _ = passed([square(0), square(1), None, square(1), square(2), square(3)])
    assert stream == [0, 3, 4]


@given(st.integers(0, 2**32 - 1))
def test_overlap_is_symmetric_and_one_only_for_equal_masks(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.random((2, 9, 9)) < 0.5
    assert overlap(a, b) == overlap(b, a)
    assert 0 <= overlap(a, b) <= 1
    assert (overlap(a, b) == 1) == (np.array_equal(a, b) and bool(a.any()))
