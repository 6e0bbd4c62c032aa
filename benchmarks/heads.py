"""On-line heads against scikit-learn and against the arithmetic limit of the machine; memory of the region store.

    icub benchmark heads
    icub benchmark heads --parts minibootstrap --seed 1
    icub benchmark heads --quick --out /tmp/heads.json      # a smoke test: small sizes, meaningless figures

Features are synthetic but have the structure of region features: every class and every kind of background is a mixture
of views in a latent space, seen through random rectified units, so that classes overlap and some background is hard.
Ours and scikit-learn get the same arrays, kernel width, lambda, number of centres, batches and thresholds in the same
run and with the same number of threads; average precisions are measured on samples that nobody trained on.

- minibootstrap: all classes by the Minibootstrap. The rival is the faithful loop (Algorithm 1), each class with its own
  negatives and centres, with Nystroem + Ridge in it. Ours once in that faithful mode (``_faithful``) and once shared:
  one pool of negatives and one set of centres for all classes.
- limit: the shared direct solve; its arithmetic is the kernel rows, half of the symmetric Gram matrix, right sides,
  the kernel matrix of the centres, factorisation and substitution.
- sweep: one and many classes over n, d and M; time and accuracy against Nystroem + Ridge, once against SVC, and against
  the FALKON library where it is installed.
- store: memory of all classes' negatives, features kept once and classes holding row numbers.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import shlex
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress
from sklearn.kernel_approximation import Nystroem
from sklearn.linear_model import Ridge
from sklearn.metrics import average_precision_score
from sklearn.svm import SVC

from icub_core.evaluation.results import Figure, write_results
from icub_segmenters.heads.falkon import Falkon
from icub_segmenters.heads.products import product_precision
from icub_segmenters.minibootstrap import Minibootstrap, one_vs_rest
from icub_segmenters.region_store import BACKGROUND, Regions, RegionStore
from icub_segmenters.sampling import class_negatives

RESULTS = Path(__file__).resolve().parent / "results" / "heads.json"
PARTS = ("limit", "store", "sweep", "minibootstrap")
SIGMA, LAM = 15.0, 1e-5
"""Width and regulariser of the thesis's detector on features of norm 20."""
LATENT, VIEWS, BACKGROUNDS = 32, 6, 120
"""Dimensions of the latent space, views of a class, kinds of background."""
NOISE = 1.2
"""Spread of samples around their view: at this the best mean average precision is about 85 points."""
REPETITIONS = 5


@dataclass(frozen=True)
class Sizes:
    """What is measured at.

    Attributes:
        classes, dim, centers: t, d, M.
        batches, batch_size: n_B and BS.
        positives: Of each class.
        tests: Test samples of each class; background is ten times as much in all.
        samples: n of the shared solve.
        per_image: Negatives an image has in the store.
    """

    classes: int = 21
    dim: int = 1024
    centers: int = 1000
    batches: int = 10
    batch_size: int = 2000
    positives: int = 300
    tests: int = 100
    samples: int = 20_000
    per_image: int = 30


QUICK = Sizes(3, 64, 100, 3, 200, 40, 30, 1500, 10)


class Mixture:
    """Draws features (n, d) float32 of mean norm about 20."""

    def __init__(self, sizes: Sizes, seed: int) -> None:
        self.generator = torch.Generator().manual_seed(seed)
        kinds = sizes.classes * VIEWS + BACKGROUNDS
        self.sizes = sizes
        self.views = self._normal(kinds, LATENT)
        # classes of one family are look-alikes
        family = self._normal(-(-sizes.classes // 3), 1, LATENT).repeat_interleave(3, dim=0)[: sizes.classes]
        self.views[: sizes.classes * VIEWS] = (family + 0.9 * self._normal(sizes.classes, VIEWS, LATENT)).flatten(0, 1)
        self.lens = self._normal(LATENT, sizes.dim) / math.sqrt(LATENT)
        self.scale = 1.0
        self.mean = torch.zeros(sizes.dim)
        sample = self.background(2000)
        self.mean = sample.mean(dim=0)
        self.scale = 20.0 / float((sample - self.mean).norm(dim=1).mean())

    def of_class(self, number: int, count: int) -> torch.Tensor:
        """Draw `count` samples of a class."""
        return self._seen(number * VIEWS + self._whole(VIEWS, count))

    def background(self, count: int) -> torch.Tensor:
        """Draw `count` samples of background."""
        return self._seen(self.sizes.classes * VIEWS + self._whole(BACKGROUNDS, count))

    def labelled(self, positives: int, background: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Return samples and class numbers, -1 for background, in random order."""
        parts = [self.of_class(c, positives) for c in range(self.sizes.classes)] + [self.background(background)]
        label = torch.cat([torch.full((len(p),), c) for c, p in enumerate(parts)])
        label[label == self.sizes.classes] = BACKGROUND
        order = torch.randperm(len(label), generator=self.generator)
        return torch.cat(parts)[order], label[order]

    def _seen(self, kind: torch.Tensor) -> torch.Tensor:
        latent = self.views[kind] + NOISE * self._normal(len(kind), LATENT)
        return (torch.relu(latent @ self.lens) - self.mean) * self.scale

    def _normal(self, *shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=self.generator)

    def _whole(self, below: int, count: int) -> torch.Tensor:
        return torch.randint(below, (count,), generator=self.generator)


class NystroemRidge:
    """scikit-learn's way to the same function: features of the centres' kernel, then ridge regression."""

    def __init__(self, centers: int, seed: int) -> None:
        self.centers, self.seed = centers, seed

    def fit(self, X: NDArray[np.float32], Y: NDArray[np.float32]) -> NystroemRidge:
        """Train on X (n, d) and Y (n, t)."""
        self.map = Nystroem(gamma=0.5 / SIGMA**2, n_components=min(self.centers, len(X)), random_state=self.seed)
        self.ridge = Ridge(alpha=LAM * len(X), fit_intercept=False)
        self.ridge.fit(self.map.fit_transform(X), Y)
        return self

    def score(self, X: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return scores (n, t)."""
        return self.ridge.predict(self.map.transform(X))


def sklearn_minibootstrap(
    procedure: Minibootstrap,
    centers: int,
    X: NDArray[np.float32],
    positives: NDArray[np.int64],
    negatives: NDArray[np.int64],
) -> NystroemRidge:
    """Train one class by Algorithm 1, as `Minibootstrap.train_class`."""

    def fitted(chosen: NDArray[np.int64]) -> NystroemRidge:
        Y = np.concatenate([np.ones(len(positives)), -np.ones(len(chosen))]).astype(np.float32)
        return NystroemRidge(centers, 0).fit(X[np.concatenate([positives, chosen])], Y)

    chosen, *rest = (negatives[i : i + procedure.batch_size] for i in range(0, len(negatives), procedure.batch_size))
    head = fitted(chosen)
    for batch in rest:
        chosen = chosen[head.score(X[chosen]) >= procedure.easy]
        chosen = np.concatenate([chosen, batch[head.score(X[batch]) > procedure.hard]])
        head = fitted(chosen)
    return head


def mean_precision(scores: NDArray[np.float32], label: NDArray[np.int64]) -> float:
    """Return the mean average precision, in points, of scores (n, t) for class numbers (n,)."""
    return 100 * float(np.mean([average_precision_score(label == c, scores[:, c]) for c in range(scores.shape[1])]))


def best_product_rate(size: int = 3000) -> float:
    """Return the best float32 rate, in operations a second, of MKL and oneDNN, which torch has both."""
    A, B = torch.rand(size, size), torch.rand(size, size)
    rate = 0.0
    for precision in ("highest", "medium"):
        with product_precision(precision):
            rate = max(rate, 2 * size**3 / min(seconds(lambda: A @ B, 5)))
    return rate


def seconds(call: Callable[[], object], repetitions: int = REPETITIONS) -> list[float]:
    """Return the durations of repeated calls after one that does not count."""
    call()
    times = []
    for _ in range(repetitions):
        begun = time.perf_counter()
        call()
        times.append(time.perf_counter() - begun)
    return times


def once(call: Callable[[], object]) -> float:
    """Return the seconds of one call."""
    begun = time.perf_counter()
    call()
    return time.perf_counter() - begun


def peak_memory(call: Callable[[], object]) -> dict[str, float]:
    """Return what a call adds to the resident memory at most, in bytes, under "bytes"; nothing where Linux cannot say.

    Memory that the process already holds but does not use is not counted, so this is a lower bound.
    """
    status = Path("/proc/self/status")

    def resident(what: str) -> float:
        line = next(line for line in status.read_text().splitlines() if line.startswith(what))
        return 1024.0 * float(line.split()[1])

    try:
        Path("/proc/self/clear_refs").write_text("5")  # resets the high-water mark
        before = resident("VmRSS")
        call()
        return {"bytes": resident("VmHWM") - before}
    except OSError:
        return {}


def limit(sizes: Sizes, seed: int, _: Progress) -> Iterator[dict[str, Figure]]:
    """Measure the shared solve beside the time of its arithmetic."""
    n, d, M, t = sizes.samples, sizes.dim, sizes.centers, sizes.classes
    mixture = Mixture(sizes, seed)
    X, label = mixture.labelled(n // (2 * t), n - t * (n // (2 * t)))
    Y = one_vs_rest(label, t)
    head = Falkon(sigma=SIGMA, lam=LAM, centers=M, solver="direct")
    rates, times = [], []
    for _repetition in range(REPETITIONS):  # interleaved: both meet the machine in the same mood
        rates.append(best_product_rate())
        times += seconds(lambda: head.fit(X, Y), 2)
    rate, best = max(rates), min(times)
    operations = 2.0 * n * M * d + n * M * (M + 1) + 2.0 * n * M * t + M * M * d + M**3 / 3 + 2.0 * M * M * t
    yield {
        "heads.product_rate": Figure(rate / 1e9, "Gflop/s", n=len(rates)),
        "heads.solve_s": Figure(best, "s", (best, max(times)), len(times)),
        "heads.solve_arithmetic_s": Figure(operations / rate, "s"),
        "heads.solve_over_limit": Figure(best * rate / operations, "1", n=len(times)),
    }


def store(sizes: Sizes, seed: int, _: Progress) -> Iterator[dict[str, Figure]]:
    """Measure the memory of all classes' negatives, drawn as the faithful mode draws them."""
    budget = sizes.batches * sizes.batch_size
    images = -(-budget // sizes.per_image)
    mixture = Mixture(sizes, seed)
    regions = RegionStore(sizes.dim)
    count = sizes.per_image
    for number in range(images):
        c = number % sizes.classes
        features = torch.cat([mixture.of_class(c, 1), mixture.background(count)])
        label = torch.full((count + 1,), BACKGROUND)
        label[0] = c
        boxes = torch.zeros(count + 1, 4)
        regions.append(Regions(features, boxes, boxes, label, label.clone()))
    generator = torch.Generator().manual_seed(seed)
    rows = [class_negatives(regions, c, budget, generator) for c in range(sizes.classes)]
    distinct = regions.features[torch.cat(rows).unique()].nbytes
    kept = regions.nbytes + sum(r.nbytes for r in rows)
    copied = sum(len(r) for r in rows) * sizes.dim * regions.features.element_size()
    yield {
        "heads.store_ratio": Figure(kept / distinct, "1"),
        "heads.store_bytes": Figure(float(kept), "B"),
        "heads.store_negatives_a_class": Figure(float(np.mean([len(r) for r in rows])), "1"),
        "heads.store_ratio_of_copies": Figure(copied / distinct, "1"),
    }


def sweep(sizes: Sizes, seed: int, progress: Progress) -> Iterator[dict[str, Figure]]:
    """Compare single solves over n, d, M and the number of classes."""
    quick = sizes.samples < 5000
    grid = [(1000, 64, 100)] if quick else [(4000, 256, 500), (4000, 1024, 1000), (20_000, 256, 1000)]
    grid += [] if quick else [(20_000, 1024, 1000)]
    task = progress.add_task("single solves", total=2 * len(grid))
    for n, d, M in grid:
        for t in (1, sizes.classes):
            yield _solves(Sizes(t, d, M), n, seed)
            progress.advance(task)
    yield _against_svc(Sizes(1, grid[0][1], grid[0][2]), grid[0][0], seed)


def _solves(sizes: Sizes, n: int, seed: int) -> dict[str, Figure]:
    t, M = sizes.classes, sizes.centers
    X, label, X_test, test_label = _split(sizes, n, seed)
    Y = one_vs_rest(label, t)
    key = f"heads.sweep.n{n}_d{sizes.dim}_M{M}_t{t}"
    ours, theirs = Falkon(sigma=SIGMA, lam=LAM, centers=M), NystroemRidge(M, 0)
    times = statistics.median(seconds(lambda: ours.fit(X, Y), 3))
    arrays = X.numpy(), Y.numpy()
    theirs.fit(arrays[0][: 2 * M], arrays[1][: 2 * M])  # awake
    rivals: list[float] = []
    memory = {"": peak_memory(lambda: ours.fit(X, Y))}
    memory["_sklearn"] = peak_memory(lambda: rivals.append(once(lambda: theirs.fit(*arrays))))
    rival = rivals[-1] if rivals else once(lambda: theirs.fit(*arrays))
    figures = {
        f"{key}.s": Figure(times, "s", n=3),
        f"{key}.speedup": Figure(rival / times, "1"),
        f"{key}.map_difference": Figure(
            mean_precision(ours.decision_function(X_test).numpy(), test_label)
            - mean_precision(theirs.score(X_test.numpy()).reshape(-1, t), test_label),
            "points",
        ),
    }
    for suffix, found in memory.items():
        figures |= {f"{key}.peak{suffix}_{unit}": Figure(value, "B") for unit, value in found.items()}
    if (library := _falkon_library(sizes)) is not None:
        figures[f"{key}.speedup_over_library"] = Figure(
            statistics.median(seconds(lambda: library(X, Y), 3)) / times, "1"
        )
    return figures


def _against_svc(sizes: Sizes, n: int, seed: int) -> dict[str, Figure]:
    X, label, X_test, test_label = _split(sizes, n, seed)
    Y = one_vs_rest(label, 1)
    ours, theirs = Falkon(sigma=SIGMA, lam=LAM, centers=sizes.centers), SVC(gamma=0.5 / SIGMA**2, C=10.0)
    times = statistics.median(seconds(lambda: ours.fit(X, Y), 3))
    arrays = X.numpy(), Y[:, 0].numpy()
    rival = min(seconds(lambda: theirs.fit(*arrays), 1))
    difference = mean_precision(ours.decision_function(X_test).numpy(), test_label) - mean_precision(
        theirs.decision_function(X_test.numpy())[:, None], test_label
    )
    key = f"heads.svc.n{n}_d{sizes.dim}"
    return {
        f"{key}.speedup": Figure(rival / times, "1"),
        f"{key}.map_difference": Figure(difference, "points"),
    }


def _split(sizes: Sizes, n: int, seed: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, NDArray[np.int64]]:
    mixture = Mixture(sizes, seed)
    each = n // (4 * sizes.classes)
    X, label = mixture.labelled(each, n - each * sizes.classes)
    X_test, test_label = mixture.labelled(sizes.tests, 10 * sizes.tests * sizes.classes)
    return X, label, X_test, test_label.numpy()


def _falkon_library(sizes: Sizes) -> Callable[[torch.Tensor, torch.Tensor], object] | None:
    """Return a fit by the FALKON library, with the options that suit it best on a CPU, or None where it is absent."""
    if importlib.util.find_spec("falkon") is None:
        return None
    import falkon

    options = falkon.FalkonOptions(
        use_cpu=True, keops_active="no", store_kernel_d_threshold=0, no_single_kernel=False, cg_epsilon_32=1e-15
    )

    def fit(X: torch.Tensor, Y: torch.Tensor) -> object:
        kernel = falkon.kernels.GaussianKernel(SIGMA)
        return falkon.Falkon(kernel=kernel, penalty=LAM, M=sizes.centers, options=options).fit(X, Y)

    return fit


def minibootstrap(sizes: Sizes, seed: int, progress: Progress) -> Iterator[dict[str, Figure]]:
    """Measure the training of all classes, ours in both modes and scikit-learn's, and what they learnt."""
    procedure = Minibootstrap(sizes.batches, sizes.batch_size)
    mixture = Mixture(sizes, seed)
    X, label = mixture.labelled(sizes.positives, procedure.budget)
    X_test, test_label = mixture.labelled(sizes.tests, 10 * sizes.tests * sizes.classes)
    generator = torch.Generator().manual_seed(seed)
    positives = [torch.nonzero(label == c).flatten() for c in range(sizes.classes)]
    # negatives of a class are background and other classes' positives alike; the shared mode knows the latter anyway
    negatives = []
    for c in range(sizes.classes):
        rows = torch.nonzero(label != c).flatten()
        negatives.append(rows[torch.randperm(len(rows), generator=generator)[: procedure.budget]])
    background = torch.nonzero(label == BACKGROUND).flatten()
    background = background[torch.randperm(len(background), generator=generator)]

    def head() -> Falkon:
        return Falkon(sigma=SIGMA, lam=LAM, centers=sizes.centers, selection="balanced", solver="direct")

    def shared() -> torch.Tensor:
        return procedure.train_shared(head, X, label, background, sizes.classes)

    task = progress.add_task("Minibootstrap, ours", total=sizes.classes + 1)
    head().fit(X[:2000], one_vs_rest(label[:2000], sizes.classes))  # threads and libraries are awake
    times = seconds(shared, REPETITIONS)
    mean = mean_precision(shared().decision_function(X_test).numpy(), test_label.numpy())
    progress.advance(task)
    scores, faithful = torch.zeros(len(X_test), sizes.classes), 0.0
    for c in range(sizes.classes):
        begun = time.perf_counter()
        trained = procedure.train_class(head, X, positives[c], negatives[c])
        faithful += time.perf_counter() - begun
        scores[:, c] = trained.decision_function(X_test)[:, 0]
        progress.advance(task)
    mean_faithful = mean_precision(scores.numpy(), test_label.numpy())
    task = progress.add_task("Minibootstrap, scikit-learn", total=sizes.classes)
    rival_scores, rival = np.zeros((len(X_test), sizes.classes), np.float32), 0.0
    samples = X.numpy()
    for c in range(sizes.classes):
        begun = time.perf_counter()
        learnt = sklearn_minibootstrap(procedure, sizes.centers, samples, positives[c].numpy(), negatives[c].numpy())
        rival += time.perf_counter() - begun
        rival_scores[:, c] = learnt.score(X_test.numpy())
        progress.advance(task)
    mean_rival = mean_precision(rival_scores, test_label.numpy())
    ours = statistics.median(times)
    yield {
        "heads.minibootstrap_s": Figure(ours, "s", (min(times), max(times)), len(times)),
        "heads.minibootstrap_faithful_s": Figure(faithful, "s"),
        "heads.minibootstrap_sklearn_s": Figure(rival, "s"),
        "heads.minibootstrap_speedup": Figure(rival / ours, "1"),
        "heads.minibootstrap_speedup_faithful": Figure(rival / faithful, "1"),
        "heads.minibootstrap_map": Figure(mean, "points"),
        "heads.minibootstrap_map_minus_sklearn": Figure(mean - mean_rival, "points"),
        "heads.minibootstrap_map_faithful_minus_sklearn": Figure(mean_faithful - mean_rival, "points"),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write benchmarks/results/heads.json, after each part, so that an interrupted run keeps the others."""
    parser = argparse.ArgumentParser(
        prog="icub benchmark heads", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="small sizes, to see that everything runs")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    sizes = QUICK if options.quick else Sizes()
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    command = shlex.join(["icub", "benchmark", "heads", *arguments])
    measures = {"limit": limit, "store": store, "sweep": sweep, "minibootstrap": minibootstrap}
    console = Console(stderr=True)
    try:
        with Progress(console=console) as progress:
            for part in options.parts:
                for figures in measures[part](sizes, options.seed, progress):
                    write_results(options.out, command=command, seed=options.seed, figures=figures)
                    for key, figure in figures.items():
                        progress.print(f"{key:56s} {figure.value:10.3f} {figure.unit}", highlight=False)
    except KeyboardInterrupt:
        console.print("stopped; finished parts are kept, --parts names the others")
        return 130
    console.print(f"written: {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
