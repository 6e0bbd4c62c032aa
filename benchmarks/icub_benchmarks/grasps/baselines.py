"""Other fits of a superquadric: EMS, where its code is at hand, and plain scipy."""

from __future__ import annotations

import importlib
import sys
import types
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from icub_core.errors import ConfigError
from icub_core.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class Found:
    """What a fit found: half axes (3,), meters, rotation (3, 3) and center (3,); not a number where it failed."""

    half_axes: FloatArray
    R: FloatArray
    center: FloatArray


Fit = Callable[[FloatArray], Found]


def scipy_fit(points: FloatArray) -> Found:
    """Fit eleven parameters to points (N, 3) by scipy alone, from the principal axes.

    The residual is the classic sqrt(a1 a2 a3) (F^e1 - 1), with a soft-l1 loss and numerical derivatives.
    """
    origin = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - origin, full_matrices=False)
    axes[2] *= np.sign(np.linalg.det(axes))
    half = np.quantile(np.abs((points - origin) @ axes.T), 0.9, axis=0)

    def residual(x: FloatArray) -> FloatArray:
        local = np.abs(Rotation.from_rotvec(x[3:6]).inv().apply(points - x[:3]) / x[6:9]) + 1e-9
        e1, e2 = x[9:]
        F = (local[:, 0] ** (2 / e2) + local[:, 1] ** (2 / e2)) ** (e2 / e1) + local[:, 2] ** (2 / e1)
        return np.sqrt(np.prod(x[6:9])) * (np.minimum(F, 1e6) ** e1 - 1.0)

    start = np.concatenate([origin, Rotation.from_matrix(axes.T).as_rotvec(), half, [1.0, 1.0]])
    low = np.concatenate([np.full(6, -np.inf), 0.3 * half, [0.1, 0.1]])
    high = np.concatenate([np.full(6, np.inf), 3.0 * half, [1.9, 1.9]])
    x = least_squares(residual, start, bounds=(low, high), loss="soft_l1", f_scale=1e-3, x_scale="jac").x
    return Found(x[6:9], Rotation.from_rotvec(x[3:6]).as_matrix(), x[:3])


def load_ems(checkout: Path) -> Fit:
    """Return the fit of Liu et al. 2022 from a checkout of github.com/bmlklwx/EMS-superquadric_fitting.

    It runs as its authors call it for partial views: an upper bound that follows the points, an outlier share of 0.1.

    Args:
        checkout: The repository, or its Python version.

    Raises:
        ConfigError: No such code there, or the package numba, which compiles it, is not installed.
    """
    sources = [checkout / part for part in (".", "src", "Python/src") if (checkout / part / "EMS").is_dir()]
    if not sources:
        raise ConfigError(f"{checkout} holds no package EMS; expected a checkout of EMS-superquadric_fitting")
    for viewer in ("mayavi", "plyfile"):  # imported on top of its modules, used for its demonstration only
        sys.modules.setdefault(viewer, types.ModuleType(viewer))
    vars(sys.modules["mayavi"]).setdefault("mlab", None)
    vars(np)["int"] = int  # its code is of a time when numpy had this name
    sys.path.insert(0, str(sources[0]))
    try:
        recovery: Any = importlib.import_module("EMS.EMS_recovery").EMS_recovery
    except ImportError as error:
        raise ConfigError(f"EMS of {checkout} cannot be imported: {error}; it needs: pip install numba") from error

    def fit(points: FloatArray) -> Found:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                solid, _ = recovery(points, AdaptiveUpperBound=True)
        except ValueError:  # a start outside of its own bounds
            return Found(np.full(3, np.nan), np.full((3, 3), np.nan), np.full(3, np.nan))
        return Found(solid.scale, solid.RotM, solid.translation)

    return fit
