"""Superquadric fit: time and accuracy on single views with outliers, beside EMS and a plain scipy fit.

    icub benchmark superquadrics
    icub benchmark superquadrics --ems EMS-superquadric_fitting   # a checkout of the peer; needs numba, too
    icub benchmark superquadrics --views 200 --seed 1

Boxes, cylinders and ellipsoids of 4 to 18 cm stand on a table and are seen once, from 45 degrees above: 500 points,
10 % of them outliers, 1 mm noise. An axis counts as visible when the clean points span nine tenths of it. All fits get
the same clouds, kind by kind; times are processor time of one thread, so that other work hardly counts.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: batches of 11 x 11 matrices gain nothing from threads

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from icub_benchmarks.figures import Figure
from icub_benchmarks.grasps.baselines import Fit, Found, load_ems, scipy_fit
from icub_benchmarks.results import command_line, make_parser, write_figures
from icub_core.geometry import FloatArray
from icub_grasp_generators.superquadrics.fit import fit_superquadric
from icub_grasp_generators.synthetic_clouds import KINDS, TABLE_TOP, View, matched, single_view

WITHIN = 0.05
NAMES = {"": "ours", "no_table_": "ours, no table", "ems_": "EMS", "scipy_": "scipy"}


def ours(points: FloatArray, table_top: float | None) -> Found:
    """Fit as the generator `superquadrics` does."""
    shape = fit_superquadric(points, table_top).shape
    return Found(shape.half_axes, shape.T_world_object[:3, :3], shape.center)


class Record:
    """What one fit did on every view of one kind of solid."""

    def __init__(self) -> None:
        self.ms: list[float] = []
        self.errors: list[float] = []
        self.offsets: list[float] = []

    def add(self, fit: Fit, view: View) -> None:
        """Fit one view; note milliseconds, relative errors of visible axes, and the distance of the centers, mm."""
        start = time.process_time()
        found = fit(view.points)
        self.ms.append((time.process_time() - start) * 1e3)
        errors = np.abs(matched(found.half_axes, found.R, view.R) / view.half - 1.0)[view.visible]
        self.errors += np.nan_to_num(errors, nan=np.inf).tolist()
        self.offsets.append(float(np.nan_to_num(1e3 * np.linalg.norm(found.center - view.center), nan=np.inf)))


def measure(fits: dict[str, Fit], views: dict[str, list[View]]) -> dict[tuple[str, str], Record]:
    """Fit every view by every fit, the fits taking turns with each kind; records by (fit, kind of solid)."""
    records = {(prefix, kind): Record() for prefix in fits for kind in KINDS}
    for kind in KINDS:
        for prefix, fit in fits.items():
            fit(views[kind][0].points)  # whatever is compiled or read at the first call
            for view in track(views[kind], description=f"{NAMES[prefix]}, {kind}", transient=True):
                records[prefix, kind].add(fit, view)
    return records


def summarize(prefixes: Sequence[str], records: dict[tuple[str, str], Record]) -> tuple[dict[str, Figure], Table]:
    """Return the figures and a table of them."""
    table = Table("fit", "solid", "ms", f"axes within {WITHIN:.0%}", "center, mm (median, 90 %)")
    figures: dict[str, Figure] = {}
    medians: dict[str, float] = {}
    for prefix in prefixes:
        parts = [records[prefix, kind] for kind in KINDS]
        for kind, part in zip(KINDS, parts, strict=True):
            low, high = np.quantile(part.offsets, [0.5, 0.9])
            ok = float(np.mean(np.array(part.errors) < WITHIN))
            table.add_row(NAMES[prefix], kind, f"{np.median(part.ms):.1f}", f"{ok:.2f}", f"{low:.1f}, {high:.1f}")
        ms = np.concatenate([part.ms for part in parts])
        errors = np.concatenate([part.errors for part in parts])
        offsets = np.concatenate([part.offsets for part in parts])
        medians[prefix] = float(np.median(ms))
        ok = float(np.mean(errors < WITHIN))
        key = f"superquadrics.{prefix}"
        quarter = (float(np.quantile(ms, 0.25)), float(np.quantile(ms, 0.75)))
        figures[f"{key}fit_ms"] = Figure(medians[prefix], "ms", quarter, len(ms))
        figures[f"{key}axes_ok"] = Figure(ok, "1", float(np.sqrt(ok * (1 - ok) / len(errors))), len(errors))
        figures[f"{key}axis_error"] = Figure(float(np.median(errors)), "1", None, len(errors))
        figures[f"{key}center_mm"] = Figure(float(np.median(offsets)), "mm", None, len(offsets))
        if prefix in ("ems_", "scipy_"):
            ratio = medians[prefix] / medians[""]
            figures[f"superquadrics.speedup_{prefix[:-1]}"] = Figure(ratio, "1", None, len(ms))
    return figures, table


def main(argv: Sequence[str]) -> None:
    """Measure, print a table, write grasps.json."""
    parser = make_parser("superquadrics", __doc__)
    parser.add_argument("--views", type=int, default=100, help="of each of the three kinds of solid")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--ems", type=Path, metavar="FOLDER", help="checkout of EMS-superquadric_fitting, the peer")
    options = parser.parse_args(argv)
    console = Console()
    fits: dict[str, Fit] = {
        "": lambda points: ours(points, TABLE_TOP),
        "no_table_": lambda points: ours(points, None),
        "scipy_": scipy_fit,
    }
    if options.ems is None:
        console.print("EMS is left out; --ems FOLDER names a checkout of github.com/bmlklwx/EMS-superquadric_fitting")
    else:
        fits["ems_"] = load_ems(options.ems)
    rng = np.random.default_rng(options.seed)
    views = {kind: [single_view(kind, rng) for _ in range(options.views)] for kind in KINDS}
    figures, table = summarize(list(fits), measure(fits, views))
    console.print(table)
    peer = [] if options.ems is None else ["--ems", "EMS-superquadric_fitting"]
    words = ["--views", str(options.views), "--seed", str(options.seed), *peer]  # not where the peer lies here
    command = command_line("superquadrics", words)
    write_figures(options.results / "grasps.json", figures, command=command, seed=options.seed)
