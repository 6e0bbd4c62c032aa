"""Single solves over n, d, M and the number of classes, for `icub benchmark heads`."""

from __future__ import annotations

import io
import re
import statistics
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from rich.progress import Progress
from sklearn.svm import SVC

from icub_benchmarks.figures import Figure
from icub_benchmarks.heads.baselines import NystroemRidge, falkon_library
from icub_benchmarks.heads.data import LAM, SIGMA, Mixture, Sizes, mean_precision
from icub_benchmarks.heads.timing import once, peak_memory, seconds
from icub_core.files import write_bytes_atomically, write_text_atomically
from icub_segmenters.heads.falkon import Falkon
from icub_segmenters.minibootstrap import one_vs_rest

SVC_SAMPLES, SVC_DIM = 4000, 256


@dataclass(frozen=True)
class Solve:
    """Size of one solve: samples, features, centers, classes."""

    n: int
    d: int
    M: int
    t: int

    @property
    def key(self) -> str:
        """Its part of a figure's key."""
        return f"n{self.n}_d{self.d}_M{self.M}_t{self.t}"


BASE = Solve(20_000, 1024, 1000, 21)
AXES = {
    "n": (2000, 5000, 10_000, 20_000, 50_000),
    "d": (128, 256, 512, 1024, 2048),
    "M": (250, 500, 1000, 2000),
    "t": (1, 5, 21, 80),
}
"""Each number is changed alone, the others stay those of BASE."""
NAMES = {"n": "samples n", "d": "features d", "M": "centers M", "t": "classes t"}


def solves(sizes: Sizes) -> list[Solve]:
    """Return what is measured; for the small sizes of a smoke test one solve."""
    if sizes.samples < BASE.n:
        return [Solve(1000, 64, 100, 1), Solve(1000, 64, 100, sizes.classes)]
    return list(dict.fromkeys(replace(BASE, **{axis: value}) for axis, values in AXES.items() for value in values))


def sweep(sizes: Sizes, seed: int, progress: Progress) -> Iterator[dict[str, Figure]]:
    """Compare single solves over n, d, M and the number of classes."""
    wanted = solves(sizes)
    task = progress.add_task("single solves", total=len(wanted) + 1)
    for solve in wanted:
        yield _against_nystroem(solve, sizes.tests, seed)
        progress.advance(task)
    few = sizes.samples < BASE.n
    yield _against_svc(wanted[0] if few else Solve(SVC_SAMPLES, SVC_DIM, 500, 1), sizes.tests, seed)
    progress.advance(task)


def _against_nystroem(solve: Solve, tests: int, seed: int) -> dict[str, Figure]:
    X, label, mixture = _samples(solve, tests, seed)
    Y = one_vs_rest(label, solve.t)
    key = f"heads.sweep.{solve.key}"
    ours, theirs = Falkon(sigma=SIGMA, penalty=LAM, n_centers=solve.M), NystroemRidge(solve.M, 0)
    times = statistics.median(seconds(lambda: ours.fit(X, Y), 3))
    arrays = X.numpy(), Y.numpy()
    theirs.fit(arrays[0][: 2 * solve.M], arrays[1][: 2 * solve.M])  # awake
    baselines: list[float] = []
    memory = {"": peak_memory(lambda: ours.fit(X, Y))}
    memory["_sklearn"] = peak_memory(lambda: baselines.append(once(lambda: theirs.fit(*arrays))))
    baseline = baselines[-1] if baselines else once(lambda: theirs.fit(*arrays))
    # the same centers for both: which are drawn moves the precision by points, and says nothing about the solution
    ours.fit(X, Y, centers=X[torch.from_numpy(theirs.map.component_indices_.copy())])
    X_test, test_label = mixture.tests()
    precision = mean_precision(ours.decision_function(X_test).numpy(), test_label)
    figures = {
        f"{key}.s": Figure(times, "s", n=3),
        f"{key}.sklearn_s": Figure(baseline, "s"),
        f"{key}.speedup": Figure(baseline / times, "1"),
        f"{key}.map": Figure(precision, "points"),
        f"{key}.map_difference": Figure(
            precision - mean_precision(theirs.score(X_test.numpy()).reshape(-1, solve.t), test_label), "points"
        ),
    }
    for suffix, found in memory.items():
        figures |= {f"{key}.peak{suffix}_{unit}": Figure(value, "B") for unit, value in found.items()}
    if (library := falkon_library(solve.M)) is not None:
        library_s = statistics.median(seconds(lambda: library(X, Y), 3))
        figures[f"{key}.library_s"] = Figure(library_s, "s", n=3)
        figures[f"{key}.speedup_over_library"] = Figure(library_s / times, "1")
    return figures


def _against_svc(solve: Solve, tests: int, seed: int) -> dict[str, Figure]:
    X, label, mixture = _samples(solve, tests, seed)
    Y = one_vs_rest(label, 1)
    ours, theirs = Falkon(sigma=SIGMA, penalty=LAM, n_centers=solve.M), SVC(gamma=0.5 / SIGMA**2, C=10.0)
    times = statistics.median(seconds(lambda: ours.fit(X, Y), 3))
    arrays = X.numpy(), Y[:, 0].numpy()
    baseline = min(seconds(lambda: theirs.fit(*arrays), 1))
    X_test, test_label = mixture.tests()
    difference = mean_precision(ours.decision_function(X_test).numpy(), test_label) - mean_precision(
        theirs.decision_function(X_test.numpy())[:, None], test_label
    )
    key = f"heads.svc.n{solve.n}_d{solve.d}"
    return {
        f"{key}.speedup": Figure(baseline / times, "1"),
        f"{key}.map_difference": Figure(difference, "points"),
    }


def _samples(solve: Solve, tests: int, seed: int) -> tuple[Any, Any, Mixture]:
    """Return samples (n, d), a quarter of them positives, their labels (n,), and where they come from."""
    mixture = Mixture(Sizes(solve.t, solve.d, solve.M, tests=tests), seed)
    each = solve.n // (4 * solve.t)
    return *mixture.labeled(each, solve.n - each * solve.t), mixture


def write_report(stem: Path, figures: Mapping[str, Mapping[str, Any]]) -> list[Path]:
    """Write the sweep of a results file as a table and, if it is whole, as a plot; return the files.

    Args:
        stem: Path without suffix; ``.md`` and ``.png`` are added.
        figures: Entries of the results file by key.
    """
    found: dict[Solve, dict[str, float]] = {}
    for key, entry in figures.items():
        match = re.fullmatch(r"heads\.sweep\.n(\d+)_d(\d+)_M(\d+)_t(\d+)\.(\w+)", key)
        if match:
            numbers = (int(match[k]) for k in range(1, 5))
            found.setdefault(Solve(*numbers), {})[match[5]] = entry["value"]
    found = {solve: row for solve, row in found.items() if "sklearn_s" in row}
    if not found:
        return []
    table = stem.with_suffix(".md")
    write_text_atomically(table, _table(found))
    if not all(solve in found for solve in (replace(BASE, **{a: v}) for a, values in AXES.items() for v in values)):
        return [table]
    image = stem.with_suffix(".png")
    write_bytes_atomically(image, _plot(found))
    return [table, image]


def _table(found: Mapping[Solve, Mapping[str, float]]) -> str:
    library = any("library_s" in row for row in found.values())
    headings = ["n", "d", "M", "classes", "ours, s", "scikit-learn, s", "ratio", "mAP", "minus scikit-learn's"]
    headings += ["FALKON library, s"] if library else []
    headings += ["peak, MB", "scikit-learn's"]
    lines = [f"| {' | '.join(headings)} |", f"|{' ---: |' * len(headings)}"]
    for solve, row in sorted(found.items(), key=lambda item: (item[0].t, item[0].n, item[0].d, item[0].M)):
        cells = [str(v) for v in (solve.n, solve.d, solve.M, solve.t)]
        cells += [f"{row['s']:.3f}", f"{row['sklearn_s']:.2f}", f"{row['speedup']:.1f}"]
        cells += [f"{row['map']:.1f}", f"{row['map_difference']:+.2f}"]
        cells += [f"{row['library_s']:.2f}" if "library_s" in row else "-"] if library else []
        cells += [f"{row[k] / 1e6:.0f}" if k in row else "-" for k in ("peak_bytes", "peak_sklearn_bytes")]
        lines.append(f"| {' | '.join(cells)} |")
    return "# Single solves, ours beside scikit-learn's Nystroem and Ridge\n\n" + "\n".join(lines) + "\n"


def _plot(found: Mapping[Solve, Mapping[str, float]]) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Drawing

    drawing = Drawing(figsize=(12, 3.4), dpi=100, layout="constrained")
    panels = drawing.subplots(1, len(AXES), sharey=True)
    for axes, (axis, values) in zip(panels, AXES.items(), strict=True):
        for column, label in (("s", "ours"), ("sklearn_s", "scikit-learn"), ("library_s", "FALKON library")):
            rows = [found[replace(BASE, **{axis: v})] for v in values]
            if all(column in row for row in rows):
                axes.plot(values, [row[column] for row in rows], marker="o", label=label)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel(NAMES[axis])
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("seconds of a fit")
    panels[0].legend()
    drawing.suptitle(f"One solve; what is not varied: n {BASE.n}, d {BASE.d}, M {BASE.M}, {BASE.t} classes")
    content = io.BytesIO()
    FigureCanvasAgg(drawing).print_png(content)
    return content.getvalue()
