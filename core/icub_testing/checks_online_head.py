"""Contract of on-line heads."""

from __future__ import annotations

import math
from typing import get_args

import torch
from torch.nn import functional

from icub_core.errors import CheckpointError, DataError, NotFittedError
from icub_core.interfaces.abilities import SharesKernel
from icub_core.interfaces.online_head import OnlineHead, Score
from icub_testing.checks import Make
from icub_testing.expect import expect, expect_close, expect_raises, expect_same, expect_tensor

DIMENSIONS = 6
KERNEL_TOLERANCE = 0.02
"""Scores of one head by its own solver and from a system that was filled step by step may differ by rounding."""
REFIT_TOLERANCE = 0.05
"""Scores of a used head may differ by its random numbers, far less than by what it was fitted to before."""


def _data(seed: int = 0, problems: int = 2) -> tuple[torch.Tensor, torch.Tensor]:
    """Draw two or more clouds far apart, +1 for the cloud of a problem and -1 for the rest."""
    generator = torch.Generator().manual_seed(seed)
    clouds = problems + 1  # the last one belongs to no problem
    centers = 4.0 * torch.eye(DIMENSIONS)[:clouds]
    X = torch.cat([center + 0.3 * torch.randn((30, DIMENSIONS), generator=generator) for center in centers])
    owner = torch.arange(clouds).repeat_interleave(30)
    Y = torch.where(owner[:, None] == torch.arange(problems), 1.0, -1.0)
    return X, Y


def _fitted(make: Make, seed: int = 0, problems: int = 2) -> OnlineHead:
    head: OnlineHead = make()
    head.fit(*_data(seed, problems))
    return head


def check_scores(make: Make) -> None:
    """Scores are float32, one column per problem."""
    for problems in (1, 3):
        head = _fitted(make, problems=problems)
        expect_tensor(head.decision_function(_data(1, problems)[0]), (30 * (problems + 1), problems), "scores")


def check_learns(make: Make) -> None:
    """Well separated clouds are told apart on new samples."""
    X, Y = _data(1)
    best = _fitted(make).decision_function(X)[:60].argmax(dim=1)
    share = float((best == Y[:60].argmax(dim=1)).float().mean())
    expect(share > 0.95, "more than 95 % of new samples right", f"{100 * share:.0f} %")
    outside = float(_fitted(make).decision_function(X)[60:].max(dim=1).values.mean())
    inside = float(_fitted(make).decision_function(X)[:60].max(dim=1).values.mean())
    expect(
        inside > outside, "higher scores for taught clouds than for the background", f"{inside:.3g} and {outside:.3g}"
    )


def check_score_meaning(make: Make) -> None:
    """Scores mean what `score` says: read so, they are no worse than undecided for positives and for negatives."""
    head, (X, Y) = _fitted(make, problems=1), _data(1, problems=1)
    meanings = get_args(Score)
    expect(head.score in meanings, f"score to be {' or '.join(meanings)}", head.score)
    scores = head.decision_function(X)
    for side, name in ((Y > 0, "positives"), (Y < 0, "negatives")):
        if head.score == "log_odds":
            loss, undecided = float(functional.softplus(-Y[side] * scores[side]).mean()), math.log(2)
        else:
            loss, undecided = float((scores[side] - Y[side]).square().mean()), 1.0
        expect(loss <= undecided + 1e-4, f"{name}: a loss of {head.score} scores of at most {undecided:.2f}", loss)


def check_shares_kernel(make: Make) -> None:
    """A head that shares its kernel gives the scores of `fit` when its system is filled step by step."""
    head: OnlineHead = make()
    X, Y = _data()
    if not isinstance(head, SharesKernel):
        return
    chosen = head.choose_centers(Y)
    expect(0 < len(chosen.unique()) == len(chosen), "distinct centers, at least one", chosen.tolist())
    system = head.kernel_system(X[chosen], Y.shape[1])
    system.add(X[:50], Y[:50])
    system.add_rows(system.rows(X[50:]), Y[50:])
    new = _data(1)[0]
    scores = system.scores(system.rows(new))
    head.adopt(system)
    expect_close(head.decision_function(new), scores, KERNEL_TOLERANCE, "scores of the system and of the head")
    fitted = _fitted(make).decision_function(new)
    expect_close(fitted, scores, KERNEL_TOLERANCE, "scores after fit and of the system")
    few = head.with_at_most(5)
    expect(isinstance(few, OnlineHead), "another head from with_at_most", type(few).__name__)
    expect(len(few.choose_centers(Y)) <= 5, "at most 5 centers", len(few.choose_centers(Y)))
    expect(len(head.choose_centers(Y)) == len(chosen), "a head that with_at_most leaves as it is", "fewer centers")
    expect_raises(NotFittedError, lambda: few.decision_function(new), "for the head from with_at_most, before fit")


def check_unfitted(make: Make) -> None:
    """Scores and state before fitting raise NotFittedError."""
    expect_raises(NotFittedError, lambda: make().decision_function(_data()[0]), "before fit")
    expect_raises(NotFittedError, lambda: make().state_dict(), "before fit")


def check_forgets(make: Make) -> None:
    """Fitting again forgets what was fitted before."""
    head = _fitted(make, seed=5, problems=3)
    head.fit(*_data())
    X = _data(1)[0]
    fresh = _fitted(make).decision_function(X)
    expect_close(head.decision_function(X), fresh, REFIT_TOLERANCE, "scores of a fresh and of a used head")


def check_repeatable(make: Make) -> None:
    """The same data and seed give the same scores."""
    X = _data(1)[0]
    expect_same(
        _fitted(make).decision_function(X), _fitted(make).decision_function(X), "scores of two heads fitted alike"
    )


def check_stateless_scores(make: Make) -> None:
    """Scoring changes nothing: the same samples score the same later, alone and among others."""
    head, X = _fitted(make), _data(1)[0]
    first = head.decision_function(X)
    head.decision_function(_data(2)[0] * 3)
    expect_same(first, head.decision_function(X), "scores of the same samples")


def check_inputs_unchanged(make: Make) -> None:
    """Samples, targets and weights are not changed."""
    X, Y = _data()
    weight = torch.ones(len(X))
    head = make()
    head.fit(X, Y, weight)
    head.decision_function(X)
    expect_same(X, _data()[0], "samples before and after")
    expect_same(Y, _data()[1], "targets before and after")
    expect_same(weight, torch.ones(len(X)), "weights before and after")


def check_not_finite(make: Make) -> None:
    """NaN and infinite samples raise DataError."""
    for value in (float("nan"), float("inf")):
        X, Y = _data()
        X[3, 2] = value
        expect_raises(DataError, lambda X=X, Y=Y: make().fit(X, Y), f"for a sample with {value}")  # type: ignore[misc]


def check_state_round_trip(make: Make) -> None:
    """A head that loads the state of another one gives the same scores."""
    head, other, X = _fitted(make), make(), _data(1)[0]
    other.load_state_dict(head.state_dict())
    expect_same(head.decision_function(X), other.decision_function(X), "scores after the state was loaded")


def check_bad_state(make: Make) -> None:
    """A state with other names or shapes raises CheckpointError and changes nothing."""
    head, X = _fitted(make), _data(1)[0]
    before = head.decision_function(X)
    expect_raises(CheckpointError, lambda: head.load_state_dict({"nonsense": torch.zeros(3)}), "for a foreign state")
    flat = {name: tensor.reshape(-1) for name, tensor in head.state_dict().items()}
    expect_raises(CheckpointError, lambda: head.load_state_dict(flat), "for a state of other shapes")
    expect_same(before, head.decision_function(X), "scores before and after a refused state")
