"""What the model of a stereo depth camera promises."""

import numpy as np
import pytest

from icub_core.geometry import look_at
from icub_core.scene import CameraView, Scene
from icub_simulators.depth_noise import BASELINE, DISPARITY_NOISE, stereo_depth

FOCAL = 600.0


def flat(z, shape=(80, 120)):
    return np.full(shape, z, np.float32)


def test_noise_grows_with_the_square_of_distance():
    rng = np.random.default_rng(0)
    for z in (0.4, 0.8, 1.6):
        measured = stereo_depth(flat(z), FOCAL, rng)
        expected = z * z / (FOCAL * BASELINE) * DISPARITY_NOISE
        assert measured[measured > 0].std() == pytest.approx(expected, rel=0.1)
        assert measured[measured > 0].mean() == pytest.approx(z, rel=2e-3)
        assert (measured > 0).all()


def test_holes_are_beside_the_nearer_object_and_along_edges():
    depth = flat(1.0)
    depth[20:60, 40:80] = 0.6
    missing = stereo_depth(depth, FOCAL, np.random.default_rng(0)) == 0
    shadow = FOCAL * BASELINE * (1 / 0.6 - 1 / 1.0)  # width of the strip that the second imager does not see
    rows = slice(25, 55)
    assert missing[rows, 40 - int(shadow) + 1 : 39].mean() > 0.9
    assert 0.3 < missing[rows, 80].mean() < 0.9
    assert missing[rows, 50:70].mean() == 0
    assert missing[rows, 95:].mean() == 0


def test_nothing_stays_nothing():
    depth = flat(0.0)
    depth[:, 60:] = 12.0
    assert (stereo_depth(depth, FOCAL, np.random.default_rng(0)) == 0).all()


def test_a_simulator_with_noise_repeats_itself_after_reset(engine):
    noisy = type(engine)(depth_noise=True)
    view = CameraView(look_at([0.2, 0.0, 1.5], [-0.4, 0.0, 0.95]), 0.7)
    engine.load(None, Scene())
    noisy.load(None, Scene())
    true = engine.render(view, 160, 120).frame.depth
    first = noisy.render(view, 160, 120).frame.depth
    second = noisy.render(view, 160, 120).frame.depth
    noisy.reset()
    np.testing.assert_array_equal(noisy.render(view, 160, 120).frame.depth, first)
    assert np.any(first != second)
    near = (first > 0) & (true < 1.2) & (true > 0)
    assert 1e-4 < np.abs(first - true)[near].mean() < 0.02
    noisy.close()
