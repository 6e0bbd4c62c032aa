"""What the Minibootstrap promises: its rounds, whatever the classes are called and however samples are scaled."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from icub_segmenters.heads.falkon import Falkon
from icub_segmenters.minibootstrap import Minibootstrap, one_vs_rest
from icub_testing.tiny import tiny_class


def samples(seed, classes=3, each=15, background=80, dim=8):
    generator = torch.Generator().manual_seed(seed)
    label = torch.arange(classes).repeat_interleave(each)
    X = 3 * torch.randn(classes, dim, generator=generator)[label] + torch.randn(len(label), dim, generator=generator)
    X = torch.cat([X, 3 * torch.randn(background, dim, generator=generator)])
    return X.double(), torch.cat([label, torch.full((background,), -1)])


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 1000), order=st.permutations([0, 1, 2]), scale=st.floats(0.1, 10))
def test_names_of_classes_and_units_of_features_do_not_matter(seed, order, scale):
    X, label = samples(seed)
    negatives = torch.nonzero(label < 0).flatten()
    procedure = Minibootstrap(3, 25)
    renamed = torch.where(label >= 0, torch.tensor(order)[label], -1)
    shared = procedure.train_shared(lambda: Falkon(sigma=4.0, penalty=1e-4, n_centers=40), X, label, negatives, 3)
    other = procedure.train_shared(
        lambda: Falkon(sigma=4.0 * scale, penalty=1e-4, n_centers=40), scale * X, renamed, negatives, 3
    )
    torch.testing.assert_close(
        other.decision_function(scale * X)[:, order], shared.decision_function(X), atol=1e-5, rtol=0
    )


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 1000))
def test_one_class_alone_is_the_same_trained_shared_or_faithfully_when_all_fits_one_batch(seed):
    X, label = samples(seed, classes=1)
    positives, negatives = torch.nonzero(label == 0).flatten(), torch.nonzero(label < 0).flatten()
    procedure = Minibootstrap(1, 200)

    def head():
        return Falkon(sigma=4.0, penalty=1e-4, n_centers=1000)

    shared = procedure.train_shared(head, X, label, negatives, 1)
    faithful = procedure.train_class(head, X, positives, negatives)
    torch.testing.assert_close(shared.decision_function(X), faithful.decision_function(X), atol=1e-6, rtol=0)


@pytest.mark.parametrize("selection", ["uniform", "balanced"])
def test_shared_rounds_add_the_hard_negatives_of_every_batch_and_no_others(selection):
    X, label = samples(3, background=600)
    positives, negatives = torch.nonzero(label >= 0).flatten(), torch.nonzero(label < 0).flatten()
    Y = one_vs_rest(label, 3).double()

    def make():
        return Falkon(sigma=6.0, penalty=1e-4, n_centers=100, selection=selection, solver="direct")

    first, *rest = negatives[:500].split(100)
    pool = torch.cat([positives, first, *rest])
    centers = X[pool[make().choose_centers(Y[pool])]]

    def fitted(rows):
        head = make()
        head.fit(X[rows], Y[rows], centers=centers)
        return head

    chosen, added = torch.cat([positives, first]), []
    for batch in rest:
        hard = (fitted(chosen).decision_function(X[batch]) > -0.7).any(dim=1)
        added.append(int(hard.sum()))
        chosen = torch.cat([chosen, batch[hard]])
    assert all(5 < count < 95 for count in added), "every batch has hard negatives and others"
    trained = Minibootstrap(5, 100).train_shared(make, X, label, negatives, 3)
    torch.testing.assert_close(trained.decision_function(X), fitted(chosen).decision_function(X), atol=1e-6, rtol=0)


def test_shared_rounds_of_a_head_without_a_shared_kernel_fit_all_that_was_hard():
    X, label = samples(3, background=600)
    X = X.float()
    positives, negatives = torch.nonzero(label >= 0).flatten(), torch.nonzero(label < 0).flatten()
    Y, make = one_vs_rest(label, 3), tiny_class("online_head")
    first, *rest = negatives[:500].split(100)
    chosen = torch.cat([positives, first])
    for batch in rest:
        head = make()
        head.fit(X[chosen], Y[chosen])
        hard = (head.decision_function(X[batch]) > -0.7).any(dim=1)
        assert 5 < int(hard.sum()) < 95
        chosen = torch.cat([chosen, batch[hard]])
    expected = make()
    expected.fit(X[chosen], Y[chosen])
    trained = Minibootstrap(5, 100).train_shared(make, X, label, negatives, 3)
    assert torch.equal(trained.decision_function(X), expected.decision_function(X))
