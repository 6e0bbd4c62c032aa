"""Baselines of the superquadric fit: what is missing is one line; EMS is called as its authors call it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from icub_benchmarks.grasps import baselines
from icub_core.errors import ConfigError
from icub_grasp_generators.synthetic_clouds import single_view

FAKE = """
import numpy as np
int_of_old_numpy = np.int(0)
class Ball:
    def __init__(self, points):
        self.scale, self.RotM, self.translation = np.ones(3), np.eye(3), points.mean(axis=0)
def EMS_recovery(points, AdaptiveUpperBound=False):
    assert AdaptiveUpperBound
    if len(points) < 10:
        raise ValueError("Initial guess is outside of provided bounds")
    return Ball(points), None
"""


@pytest.fixture(autouse=True)
def _without_ems(monkeypatch):
    monkeypatch.setattr(np, "int", int, raising=False)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield
    for name in ("EMS", "EMS.EMS_recovery", "mayavi", "plyfile"):
        sys.modules.pop(name, None)


def checkout(folder: Path, text: str) -> Path:
    package = folder / "Python" / "src" / "EMS"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "EMS_recovery.py").write_text(text)
    return folder


def test_a_folder_without_ems_is_one_line(tmp_path):
    with pytest.raises(ConfigError, match="holds no package EMS"):
        baselines.load_ems(tmp_path)


def test_a_missing_compiler_is_named(tmp_path):
    with pytest.raises(ConfigError, match="numba") as caught:
        baselines.load_ems(checkout(tmp_path, "import numba_that_is_not_there"))
    assert "\n" not in str(caught.value)


def test_ems_is_called_and_its_failure_counts_as_one(tmp_path):
    fit = baselines.load_ems(checkout(tmp_path, FAKE))
    points = np.random.default_rng(0).normal(size=(50, 3))
    found = fit(points)
    np.testing.assert_allclose(found.center, points.mean(axis=0))
    np.testing.assert_array_equal(found.half_axes, 1.0)
    assert np.isnan(fit(points[:5]).center).all()


def test_the_scipy_fit_finds_an_ellipsoid_seen_without_outliers():
    view = single_view("ellipsoid", np.random.default_rng(1), outliers=0.0, noise=0.0)
    found = baselines.scipy_fit(view.points)
    assert np.all(np.isfinite(found.half_axes))
    assert np.linalg.norm(found.center - view.center) < 0.06
