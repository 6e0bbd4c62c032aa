"""Box regression and the cheap baseline against numpy and scikit-learn."""

import numpy as np
import pytest
import torch
from sklearn.linear_model import LogisticRegression

from icub_core.errors import CheckpointError, ConfigError, DataError, NotFittedError
from icub_segmenters.heads.linear import Linear
from icub_segmenters.heads.rls import Rls


def boxes(n=200, d=10, seed=0):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, d)) * 3
    Y = X @ rng.normal(size=(d, 4)) * 0.1 + [0.5, -0.2, 1.0, 0.0] + 0.05 * rng.normal(size=(n, 4))
    return torch.as_tensor(X), torch.as_tensor(Y)


def test_without_whitening_it_is_ridge_regression_with_a_penalized_bias():
    X, Y = boxes()
    head = Rls(penalty=5.0, whiten=False)
    head.fit(X, Y)
    design = np.c_[X.numpy(), np.ones(len(X))]
    mean = Y.numpy().mean(axis=0)
    W = np.linalg.solve(design.T @ design + 5.0 * np.eye(11), design.T @ (Y.numpy() - mean))
    np.testing.assert_allclose(head.decision_function(X).numpy(), design @ W + mean, atol=1e-9)


def test_whitening_all_targets_with_one_penalty_does_not_change_the_ridge_solution():
    # (X^T X + lam I)^-1 X^T (Y T) T^-1: a shared penalty commutes with any mixing of the targets
    X, Y = boxes()
    plain, white = Rls(penalty=5.0, whiten=False), Rls(penalty=5.0, whiten=True)
    plain.fit(X, Y)
    white.fit(X, Y)
    torch.testing.assert_close(plain.decision_function(X), white.decision_function(X), atol=1e-8, rtol=0)


def test_weights_count_as_repetitions_and_one_sample_predicts_its_target():
    X, Y = boxes(40)
    weighted, repeated = Rls(penalty=2.0), Rls(penalty=2.0)
    weighted.fit(X, Y, torch.cat([torch.full((10,), 3.0), torch.ones(30)]))
    repeated.fit(torch.cat([X, X[:10], X[:10]]), torch.cat([Y, Y[:10], Y[:10]]))
    torch.testing.assert_close(weighted.decision_function(X), repeated.decision_function(X), atol=1e-8, rtol=0)
    single = Rls()
    single.fit(X[:1], Y[:1])
    torch.testing.assert_close(single.decision_function(X[:1]), Y[:1], atol=1e-8, rtol=0)


def classes(n=600, d=5, seed=0):
    rng = np.random.default_rng(seed)
    label = rng.integers(0, 4, n)  # 0 is background
    X = rng.normal(size=(n, d)) + 2.0 * rng.normal(size=(4, d))[label]
    Y = -np.ones((n, 3))
    Y[np.arange(n)[label > 0], label[label > 0] - 1] = 1
    return torch.as_tensor(X), torch.as_tensor(Y), label


def test_softmax_by_lbfgs_agrees_with_scikit_learn():
    X, Y, label = classes()
    head = Linear(optimizer="lbfgs", epochs=500, weight_decay=1e-2)
    head.fit(X, Y)
    reference = LogisticRegression(C=1 / (1e-2 * len(X)), tol=1e-8, max_iter=2000).fit(X.numpy(), label)
    logits = reference.decision_function(X.numpy())
    np.testing.assert_allclose(head.decision_function(X).numpy(), logits[:, 1:] - logits[:, :1], atol=2e-2)


def test_logistic_by_lbfgs_agrees_with_scikit_learn():
    X, Y, _ = classes()
    head = Linear(loss="logistic", optimizer="lbfgs", epochs=500, weight_decay=1e-2)
    head.fit(X, Y)
    for column in range(3):
        target = Y[:, column].numpy() > 0
        reference = LogisticRegression(C=1 / (1e-2 * len(X)), tol=1e-8, max_iter=2000).fit(X.numpy(), target)
        np.testing.assert_allclose(
            head.decision_function(X)[:, column].numpy(), reference.decision_function(X.numpy()), atol=2e-2
        )


def test_adam_learns_the_same_and_repeats_itself():
    X, Y, label = classes()
    adam, again, lbfgs = (
        Linear(epochs=60, learning_rate=0.03),
        Linear(epochs=60, learning_rate=0.03),
        Linear("softmax", "lbfgs", 200),
    )
    for head in (adam, again, lbfgs):
        head.fit(X.float(), Y)
    assert torch.equal(adam.decision_function(X.float()), again.decision_function(X.float()))
    votes = [
        np.where(h.decision_function(X.float()).amax(1) > 0, h.decision_function(X.float()).argmax(1) + 1, 0)
        for h in (adam, lbfgs)
    ]
    assert (votes[0] == label).mean() > (votes[1] == label).mean() - 0.02
    assert (votes[0] == label).mean() > 0.85


@pytest.mark.parametrize("make", [Rls, Linear])
def test_states_travel_and_bad_input_is_refused(make):
    X, Y, _ = classes()
    head, copy = make(), make()
    with pytest.raises(NotFittedError):
        head.decision_function(X)
    with pytest.raises(NotFittedError):
        head.state_dict()
    head.fit(X, Y)
    copy.load_state_dict(head.state_dict())
    assert torch.equal(copy.decision_function(X), head.decision_function(X))
    with pytest.raises(CheckpointError):
        copy.load_state_dict({"alpha": X})
    with pytest.raises(CheckpointError):
        copy.load_state_dict({"weight": X, "bias": X[0, :2]})
    X[3, 1] = float("nan")
    with pytest.raises(DataError, match="sample 3"):
        head.fit(X, Y)
    with pytest.raises(DataError, match="features"):
        head.decision_function(X[:, :2])


@pytest.mark.parametrize("options", [{"loss": "hinge"}, {"optimizer": "sgd"}, {"epochs": 0}])
def test_impossible_options_of_the_linear_head_are_refused(options):
    with pytest.raises(ConfigError):
        Linear(**options)


def test_rls_refuses_a_penalty_of_nothing():
    with pytest.raises(ConfigError):
        Rls(penalty=0.0)


@pytest.mark.parametrize("n", [5, 60])
def test_fewer_samples_than_features_give_the_same_ridge_solution(n):
    generator = torch.Generator().manual_seed(0)
    X = torch.randn(n, 20, generator=generator, dtype=torch.float64)
    Y = torch.randn(n, 2, generator=generator, dtype=torch.float64)
    head = Rls(penalty=0.5, whiten=False)
    head.fit(X, Y)
    wide = torch.cat([X, torch.ones(n, 1, dtype=torch.float64)], dim=1)
    expected = torch.linalg.solve(wide.T @ wide + 0.5 * torch.eye(21, dtype=torch.float64), wide.T @ (Y - Y.mean(0)))
    torch.testing.assert_close(head.weight, expected[:-1])
    torch.testing.assert_close(head.bias, expected[-1] + Y.mean(0))
