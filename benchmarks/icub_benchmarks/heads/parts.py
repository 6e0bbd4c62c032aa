"""Parts of `icub benchmark heads` that decide whether what is to be reached is reached."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator

import numpy as np
import torch
from rich.progress import Progress

from icub_benchmarks.figures import Figure
from icub_benchmarks.heads.baselines import sklearn_minibootstrap
from icub_benchmarks.heads.data import LAM, SIGMA, Mixture, Sizes, mean_precision
from icub_benchmarks.heads.timing import REPETITIONS, best_product_rate, seconds
from icub_core.interfaces.online_head import OnlineHead
from icub_segmenters.heads.falkon import Falkon
from icub_segmenters.minibootstrap import Minibootstrap, one_vs_rest
from icub_segmenters.region_store import BACKGROUND, Regions, RegionStore
from icub_segmenters.sampling import class_negatives


def limit(sizes: Sizes, seed: int, _: Progress) -> Iterator[dict[str, Figure]]:
    """Measure the shared solve beside the time of its arithmetic."""
    n, d, M, t = sizes.samples, sizes.dim, sizes.centers, sizes.classes
    mixture = Mixture(sizes, seed)
    X, label = mixture.labeled(n // (2 * t), n - t * (n // (2 * t)))
    Y = one_vs_rest(label, t)
    head = Falkon(sigma=SIGMA, penalty=LAM, n_centers=M, solver="direct")
    rates, times = [], []
    for _repetition in range(REPETITIONS):  # interleaved: both meet the machine in the same mood
        rates.append(best_product_rate(3 * M))
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


def minibootstrap(sizes: Sizes, seed: int, progress: Progress) -> Iterator[dict[str, Figure]]:
    """Measure the training of all classes, ours in both modes and scikit-learn's, and what they learned."""
    procedure = Minibootstrap(sizes.batches, sizes.batch_size)
    mixture = Mixture(sizes, seed)
    X, label = mixture.labeled(sizes.positives, procedure.budget)
    X_test, test_label = mixture.tests()
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
        return Falkon(sigma=SIGMA, penalty=LAM, n_centers=sizes.centers, selection="balanced", solver="direct")

    def shared() -> OnlineHead:
        return procedure.train_shared(head, X, label, background, sizes.classes)

    task = progress.add_task("Minibootstrap, ours", total=sizes.classes + 1)
    head().fit(X[:2000], one_vs_rest(label[:2000], sizes.classes))  # threads and libraries are awake
    times = seconds(shared, REPETITIONS)
    mean = mean_precision(shared().decision_function(X_test).numpy(), test_label)
    progress.advance(task)
    scores, faithful = torch.zeros(len(X_test), sizes.classes), 0.0
    for c in range(sizes.classes):
        begun = time.perf_counter()
        trained = procedure.train_class(head, X, positives[c], negatives[c])
        faithful += time.perf_counter() - begun
        assert trained is not None  # every class has positives
        scores[:, c] = trained.decision_function(X_test)[:, 0]
        progress.advance(task)
    mean_faithful = mean_precision(scores.numpy(), test_label)
    task = progress.add_task("Minibootstrap, scikit-learn", total=sizes.classes)
    baseline_scores, baseline = np.zeros((len(X_test), sizes.classes), np.float32), 0.0
    samples = X.numpy()
    for c in range(sizes.classes):
        begun = time.perf_counter()
        learned = sklearn_minibootstrap(procedure, sizes.centers, samples, positives[c].numpy(), negatives[c].numpy())
        baseline += time.perf_counter() - begun
        baseline_scores[:, c] = learned.score(X_test.numpy())
        progress.advance(task)
    mean_baseline = mean_precision(baseline_scores, test_label)
    ours = statistics.median(times)
    yield {
        "heads.minibootstrap_s": Figure(ours, "s", (min(times), max(times)), len(times)),
        "heads.minibootstrap_faithful_s": Figure(faithful, "s"),
        "heads.minibootstrap_sklearn_s": Figure(baseline, "s"),
        "heads.minibootstrap_speedup": Figure(baseline / ours, "1"),
        "heads.minibootstrap_speedup_faithful": Figure(baseline / faithful, "1"),
        "heads.minibootstrap_map": Figure(mean, "points"),
        "heads.minibootstrap_map_minus_sklearn": Figure(mean - mean_baseline, "points"),
        "heads.minibootstrap_map_faithful_minus_sklearn": Figure(mean_faithful - mean_baseline, "points"),
    }
