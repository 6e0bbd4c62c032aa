"""Superquadric fit: time and accuracy on single views with outliers, beside a plain scipy fit of the same clouds.

    python benchmarks/superquadrics.py
    python benchmarks/superquadrics.py --views 200 --seed 1

Boxes, cylinders and ellipsoids of 4 to 18 cm stand on a table and are seen once, from 45 degrees above: 500 points,
10 % of them outliers, 1 mm noise. An axis counts as visible when the clean points span nine tenths of it. Times are
processor time of one thread, so that other work on the machine does not count. The rival minimises the classic
residual sqrt(a1 a2 a3) (F^e1 - 1) by scipy's least_squares with a soft-l1 loss and numerical derivatives, from the
principal axes.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: batches of 11 x 11 matrices gain nothing from threads

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from icub_core.evaluation.results import Figure, write_results
from icub_core.geometry import FloatArray
from icub_grasp_generators.superquadrics.fit import fit_superquadric
from icub_grasp_generators.superquadrics.shape import Superquadric
from icub_grasp_generators.synthetic_clouds import KINDS, TABLE_TOP, View, matched, single_view

RESULTS = Path(__file__).resolve().parent / "results" / "grasps.json"
WITHIN = 0.05
Fit = Callable[[FloatArray], Superquadric]


def scipy_fit(points: FloatArray) -> Superquadric:
    """Fit eleven parameters to points (N, 3) by scipy alone."""
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
    return Superquadric.from_parts(x[6:9], x[9:], Rotation.from_rotvec(x[3:6]).as_matrix(), x[:3])


def measure(fit: Fit, views: list[View], label: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return milliseconds of each fit, relative errors of the visible axes, and centre errors in metres."""
    fit(views[0].points)
    times, errors, offsets = [], [], []
    for view in track(views, description=label, transient=True):
        start = time.process_time()
        shape = fit(view.points)
        times.append((time.process_time() - start) * 1e3)
        found = matched(shape.half_axes, shape.T_world_object[:3, :3], view.R)
        errors.append(np.abs(found / view.half - 1.0)[view.visible])
        offsets.append(np.linalg.norm(shape.center - view.center))
    return np.array(times), np.concatenate(errors), np.array(offsets)


def main() -> None:
    """Measure, print a table, write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=100, help="of each of the three kinds of solid")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, default=RESULTS)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    views = {kind: [single_view(kind, rng) for _ in range(args.views)] for kind in KINDS}
    rivals: dict[str, Fit] = {
        "": lambda points: fit_superquadric(points, TABLE_TOP).shape,
        "no_table_": lambda points: fit_superquadric(points).shape,
        "scipy_": scipy_fit,
    }
    table = Table("fit", "solid", "ms", f"axes within {WITHIN:.0%}", "centre, mm (median, 90 %)")
    figures: dict[str, Figure] = {}
    medians: dict[str, float] = {}
    for prefix, fit in rivals.items():
        name = {"": "ours", "no_table_": "ours, no table", "scipy_": "scipy"}[prefix]
        times, errors, offsets = [], [], []
        for kind in KINDS:
            t, e, o = measure(fit, views[kind], f"{name}, {kind}")
            low, high = np.quantile(o, [0.5, 0.9]) * 1e3
            table.add_row(name, kind, f"{np.median(t):.1f}", f"{np.mean(e < WITHIN):.2f}", f"{low:.1f}, {high:.1f}")
            times.append(t)
            errors.append(e)
            offsets.append(o)
        ms, axes, off = np.concatenate(times), np.concatenate(errors), np.concatenate(offsets)
        ok = float(np.mean(axes < WITHIN))
        medians[prefix] = float(np.median(ms))
        quarter = (float(np.quantile(ms, 0.25)), float(np.quantile(ms, 0.75)))
        figures[f"superquadrics.{prefix}fit_ms"] = Figure(medians[prefix], "ms", quarter, len(ms))
        deviation = float(np.sqrt(ok * (1 - ok) / len(axes)))
        figures[f"superquadrics.{prefix}axes_ok"] = Figure(ok, "1", deviation, len(axes))
        figures[f"superquadrics.{prefix}center_mm"] = Figure(float(np.median(off) * 1e3), "mm", None, len(off))
    figures["superquadrics.speedup_scipy"] = Figure(medians["scipy_"] / medians[""], "1", None, len(KINDS) * args.views)
    Console().print(table)
    command = f"python benchmarks/superquadrics.py --views {args.views} --seed {args.seed}"
    write_results(args.output, command=command, seed=args.seed, figures=figures)


if __name__ == "__main__":
    main()
