"""Appendix D by experiment: thinning out again and again is the same as sampling once."""

import itertools

import numpy as np
import torch
from scipy.stats import chisquare

from icub_segmenters.region_store import Regions, RegionStore
from icub_segmenters.sampling import (
    class_negatives,
    quota_per_image,
    sample,
    sample_per_group,
    shared_negatives,
    thin_out,
)

DRAWS = 6000


def counted(draw, n, k, draws=DRAWS):
    """Count how often each k-subset of range(n) is drawn."""
    subsets = {s: i for i, s in enumerate(itertools.combinations(range(n), k))}
    counts = np.zeros(len(subsets))
    for seed in range(draws):
        counts[subsets[tuple(sorted(draw(torch.Generator().manual_seed(seed)).tolist()))]] += 1
    return counts


def test_a_sample_of_a_sample_of_a_sample_is_uniform_over_all_subsets():
    def nested(generator):
        return sample(sample(sample(torch.arange(6), 5, generator), 4, generator), 2, generator)

    counts = counted(nested, 6, 2)
    assert chisquare(counts).pvalue > 1e-3


def test_with_replacement_as_in_the_released_code_it_would_not_be():
    def with_replacement(generator):
        pool = torch.arange(6)
        for size in (5, 4, 2):
            pool = pool[torch.randint(len(pool), (size,), generator=generator)]
        return pool

    pairs = sum(len(set(with_replacement(torch.Generator().manual_seed(s)).tolist())) == 2 for s in range(2000))
    assert pairs < 1900  # duplicates: fewer distinct negatives than asked for


def test_groups_are_sampled_uniformly_and_alike():
    rows, group = torch.arange(100, 112), torch.tensor([0] * 4 + [1] * 6 + [2] * 2)
    counts = np.zeros(12)
    for seed in range(3000):
        chosen = sample_per_group(rows, group, 3, torch.Generator().manual_seed(seed))
        assert torch.bincount(group[chosen - 100], minlength=3).tolist() == [3, 3, 2]
        counts[chosen.numpy() - 100] += 1
    assert chisquare(counts[:4]).pvalue > 1e-3
    assert chisquare(counts[4:10]).pvalue > 1e-3
    assert sample_per_group(rows[:0], group[:0], 3, torch.Generator()).numel() == 0


def image(number, background=12, label=-1):
    count = background + (label >= 0)
    features = torch.full((count, 1), float(number)) + torch.arange(count)[:, None] / 100
    labels = torch.full((count,), -1)
    if label >= 0:
        labels[0] = label
    boxes = torch.zeros(count, 4)
    return Regions(features, boxes, boxes, labels, labels.clone())


def test_images_that_arrive_one_by_one_keep_a_uniform_sample():
    """Algorithm 2: negatives of the first of four images, thinned at each arrival."""
    subsets = {s: i for i, s in enumerate(itertools.combinations(range(6), 2))}
    counts = np.zeros(len(subsets))
    for seed in range(900):
        store = RegionStore(1, seed)
        for number in range(4):
            store.append(image(number, background=6))
            thin_out(store, 8)
        assert torch.bincount(store.image).tolist() == [2, 2, 2, 2]
        kept = (store.features[store.image == 0, 0] * 100).round().long().tolist()
        counts[subsets[tuple(sorted(kept))]] += 1
    assert chisquare(counts).pvalue > 1e-3


def algorithm_3(images, labels, budget, generator):
    """Thesis Algorithm 3, word for word: which (image, row) are negatives of each class, images coming one by one."""
    per_class, buffer, classes = {}, {}, []
    for i, (count, label) in enumerate(zip(images, labels, strict=True)):
        if label >= 0 and label not in classes:
            classes.append(label)
        quota = quota_per_image(budget, i + 1)
        buffer = {j: sample(rows, quota, generator) for j, rows in buffer.items()}
        per_class = {key: sample(rows, quota, generator) for key, rows in per_class.items()}
        if label >= 0:  # row 0 is the positive
            per_class[label, i] = sample(torch.arange(1, count), quota, generator)
        buffer[i] = sample(torch.arange(count), quota, generator)
    return {c: {i: per_class.get((c, i), buffer[i]) for i in range(len(images))} for c in classes}


def test_the_store_draws_as_algorithm_3_does():
    """Appendix D by experiment: each row of each image is as often a negative of each class in both."""
    labels, background, budget, trials = [0, 0, 1, 0, 2, -1], 5, 12, 1500
    counts = [background + (label >= 0) for label in labels]
    ours, theirs = np.zeros((3, 6, 6)), np.zeros((3, 6, 6))
    for seed in range(trials):
        generator = torch.Generator().manual_seed(seed)
        store = RegionStore(1, seed)
        for number, label in enumerate(labels):
            store.append(image(number, background=background, label=label))
            thin_out(store, budget)
        for c in range(3):
            rows = class_negatives(store, c, budget, generator)
            np.add.at(ours[c], (store.image[rows].numpy(), within(store, rows)), 1)
        for c, chosen in algorithm_3(counts, labels, budget, generator).items():
            for i, rows in chosen.items():
                np.add.at(theirs[c], (i, rows.numpy()), 1)
    assert ours.sum() == theirs.sum()  # the same number of negatives an image
    used = theirs > 0
    assert (used == (ours > 0)).all()
    difference = (ours - theirs)[used]
    share = 0.5 * (ours + theirs)[used] / trials
    z = difference / np.sqrt(np.maximum(2 * trials * share * (1 - share), 1e-9))
    assert np.abs(z).max() < 4.5  # 95 rows: chance 1e-3
    assert np.abs(z).mean() < 1.1


def within(store, rows):
    """Row numbers within their images: background's features count on from the positive's."""
    return (store.features[rows, 0].double() * 100).round().long().numpy() % 100


def test_what_was_thinned_out_on_the_way_does_not_change_what_is_drawn():
    """Stronger than appendix D: not only the distribution, the very rows are those of a batch."""
    thinned, batch = RegionStore(1, 3), RegionStore(1, 3)
    for number in range(12):
        regions = image(number, background=9, label=number % 4 - 1)
        thinned.append(regions)
        batch.append(regions)
        thin_out(thinned, 40)
    assert len(thinned) < 0.7 * len(batch)
    for c in range(3):
        a = thinned.features[class_negatives(thinned, c, 40, torch.Generator().manual_seed(0))]
        b = batch.features[class_negatives(batch, c, 40, torch.Generator().manual_seed(0))]
        assert torch.equal(a, b)
    a = thinned.features[shared_negatives(thinned, 40, torch.Generator().manual_seed(0))]
    b = batch.features[shared_negatives(batch, 40, torch.Generator().manual_seed(0))]
    assert torch.equal(a, b)


def test_negatives_are_spread_over_images_and_bounded():
    store = RegionStore(1)
    for number in range(10):
        store.append(image(number, background=20, label=number % 3))
    for budget in (5, 37, 100, 10_000):
        rows = shared_negatives(store, budget, torch.Generator().manual_seed(0))
        assert len(rows) == min(budget, 200) == len(set(rows.tolist()))
        assert (store.label[rows] == -1).all()
        per_image = torch.bincount(store.image[rows], minlength=10)
        assert per_image.max() <= quota_per_image(budget, 10)


def test_a_class_takes_other_classes_regions_as_negatives_and_never_its_own():
    """Algorithm 3, with the shared buffer: every region of images without the class is a candidate."""
    store = RegionStore(1)
    for number in range(6):
        store.append(image(number, background=3, label=number % 2))
    rows = class_negatives(store, 0, 10_000, torch.Generator().manual_seed(0))
    assert (store.near[rows] != 0).all()
    assert int((store.near[rows] == 1).sum()) == 3
    assert len(rows) == 6 * 3 + 3


def test_thinning_keeps_every_positive():
    store = RegionStore(1)
    for number in range(20):
        store.append(image(number, background=10, label=0))
    thin_out(store, 40)
    assert int((store.label == 0).sum()) == 20
    assert torch.bincount(store.image[store.label < 0]).tolist() == [2] * 20
