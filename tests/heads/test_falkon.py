"""FALKON against references that know nothing of it: dense kernel ridge regression and scikit-learn."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.kernel_ridge import KernelRidge
from sklearn.metrics.pairwise import rbf_kernel

from icub_core.errors import CheckpointError, ConfigError, DataError, NotFittedError
from icub_segmenters.heads import conjugate_gradients, nystrom
from icub_segmenters.heads.centers import balanced_centers, uniform_centers
from icub_segmenters.heads.conjugate_gradients import is_cheaper_than_direct
from icub_segmenters.heads.falkon import Falkon
from icub_segmenters.heads.kernels import make_kernel
from icub_segmenters.heads.nystrom import add_gram


def problem(n=300, d=6, t=3, seed=0, dtype=torch.float64):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, d))
    Y = np.sign(np.sin(X @ rng.normal(size=(d, t))) + 0.3 * rng.normal(size=(n, t)))
    return torch.as_tensor(X, dtype=dtype), torch.as_tensor(Y, dtype=dtype)


@pytest.mark.parametrize("solver", ["direct", "conjugate_gradients"])
def test_with_all_samples_as_centers_it_is_kernel_ridge_regression(solver):
    X, Y = problem()
    penalty, sigma = 1e-3, 2.0
    head = Falkon(sigma=sigma, penalty=penalty, n_centers=len(X), solver=solver)
    head.fit(X, Y)
    reference = KernelRidge(alpha=penalty * len(X), kernel="rbf", gamma=0.5 / sigma**2).fit(X.numpy(), Y.numpy())
    fresh = torch.randn(50, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    np.testing.assert_allclose(head.decision_function(fresh).numpy(), reference.predict(fresh.numpy()), atol=1e-7)


@pytest.mark.parametrize("kernel", ["gaussian", "laplacian", "linear"])
@pytest.mark.parametrize("solver", ["direct", "conjugate_gradients"])
def test_every_kernel_solves_dense_kernel_ridge_regression(kernel, solver):
    X, Y = problem(n=150, d=40)
    fresh = problem(n=30, d=40, seed=5)[0]
    sigma, penalty = 6.0, 1e-3
    head = Falkon(kernel, sigma, penalty, n_centers=len(X), solver=solver)
    head.fit(X, Y)
    k = make_kernel(kernel, sigma)
    reference = KernelRidge(alpha=penalty * len(X), kernel="precomputed").fit(k(X, X).numpy(), Y.numpy())
    # the linear kernel's matrix has rank 40: conjugate gradients see the jitter that its factorization needs
    tolerance = 1e-4 if kernel == "linear" else 1e-7
    np.testing.assert_allclose(
        head.decision_function(fresh).numpy(), reference.predict(k(fresh, X).numpy()), atol=tolerance
    )


@pytest.mark.parametrize("solver", ["direct", "conjugate_gradients"])
def test_small_blocks_of_bounded_memory_give_the_same_solution(solver, monkeypatch):
    X, Y = problem(n=1500)
    whole, blocks = Falkon(sigma=2.0, n_centers=60, solver=solver), Falkon(sigma=2.0, n_centers=60, solver=solver)
    whole.fit(X, Y)
    monkeypatch.setattr(nystrom, "BLOCK_BYTES", 1)  # 256 rows, the least
    monkeypatch.setattr(conjugate_gradients, "STORED_ROWS_BYTES", 0)
    kernel, largest = type(blocks.kernel).__call__, []

    def watched(self, X, *rest):
        largest.append(len(X))
        return kernel(self, X, *rest)

    monkeypatch.setattr(type(blocks.kernel), "__call__", watched)
    blocks.fit(X, Y)
    assert max(largest) == 256
    torch.testing.assert_close(blocks.decision_function(X), whole.decision_function(X), atol=1e-6, rtol=0)


@pytest.mark.parametrize("solver", ["direct", "conjugate_gradients"])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-6), (torch.float32, 2e-2)])
def test_nystrom_solution_equals_the_normal_equations_solved_by_numpy(solver, dtype, tolerance):
    X, Y = problem(n=800, dtype=dtype)
    head = Falkon(sigma=2.0, penalty=1e-4, n_centers=120, solver=solver, seed=3)
    head.fit(X, Y)
    C = head.centers.double().numpy()
    K, K_MM = rbf_kernel(X.double().numpy(), C, gamma=1 / 8), rbf_kernel(C, C, gamma=1 / 8)
    alpha = np.linalg.solve(K.T @ K + 1e-4 * len(X) * K_MM, K.T @ Y.double().numpy())
    np.testing.assert_allclose(head.decision_function(X).double().numpy(), K @ alpha, atol=tolerance)


def test_float32_features_of_realistic_size_are_close_to_the_float64_solution():
    generator = torch.Generator().manual_seed(0)
    X = torch.randn(3000, 256, generator=generator)
    X = 20 * X / X.norm(dim=1, keepdim=True)
    Y = torch.where(X[:, :2] + 0.3 * X[:, 2:4] > 1.0, 1.0, -1.0)
    scores = []
    for samples in (X, X.double()):
        head = Falkon(sigma=15.0, penalty=1e-5, n_centers=400)
        head.fit(samples, Y)
        scores.append(head.decision_function(samples).double())
    assert torch.linalg.norm(scores[0] - scores[1]) < 5e-5 * torch.linalg.norm(scores[1])


@pytest.mark.parametrize("kernel", ["gaussian", "laplacian", "linear"])
def test_kernels_are_what_their_formula_says(kernel):
    X, Y = problem(n=20)[0], problem(n=15, seed=2)[0]
    distance = np.linalg.norm(X.numpy()[:, None] - Y.numpy()[None], axis=2)
    expected = {
        "gaussian": np.exp(-(distance**2) / (2 * 1.7**2)),
        "laplacian": np.exp(-distance / 1.7),
        "linear": X.numpy() @ Y.numpy().T / 1.7**2,
    }[kernel]
    np.testing.assert_allclose(make_kernel(kernel, 1.7)(X, Y).numpy(), expected, atol=1e-7)


def test_a_linear_kernel_with_more_centers_than_dimensions_still_solves():
    X, Y = problem(n=400, dtype=torch.float32)
    head = Falkon(kernel="linear", sigma=1.0, penalty=1e-6, n_centers=200)
    head.fit(X, Y)
    solution = np.linalg.lstsq(X.numpy(), Y.numpy(), rcond=None)[0]
    np.testing.assert_allclose(head.decision_function(X).numpy(), X.numpy() @ solution, atol=2e-2)


def test_duplicate_samples_as_centers_do_no_harm():
    X, Y = problem(n=100, dtype=torch.float32)
    head = Falkon(sigma=2.0, penalty=1e-4, n_centers=300)
    head.fit(X.repeat(3, 1), Y.repeat(3, 1))
    reference = KernelRidge(alpha=1e-4 * 100, kernel="rbf", gamma=1 / 8).fit(X.numpy(), Y.numpy())
    np.testing.assert_allclose(head.decision_function(X).numpy(), reference.predict(X.numpy()), atol=2e-2)


def test_weight_two_is_the_sample_twice():
    X, Y = problem(n=100)
    twice = Falkon(sigma=2.0, penalty=1e-3)
    twice.fit(torch.cat([X, X[:30]]), torch.cat([Y, Y[:30]]), centers=X)
    weight = torch.ones(100)
    weight[:30] = 2
    for solver in ("direct", "conjugate_gradients"):
        weighted = Falkon(sigma=2.0, penalty=1e-3, solver=solver)
        weighted.fit(X, Y, weight, centers=X)
        torch.testing.assert_close(weighted.decision_function(X), twice.decision_function(X), atol=1e-6, rtol=0)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_order_of_samples_and_of_problems_does_not_matter(seed):
    X, Y = problem(n=80, seed=seed)
    head = Falkon(sigma=2.0, penalty=1e-3)
    head.fit(X, Y)
    rows = torch.randperm(80, generator=torch.Generator().manual_seed(seed))
    shuffled = Falkon(sigma=2.0, penalty=1e-3)
    shuffled.fit(X[rows], Y[rows][:, [2, 0, 1]])
    torch.testing.assert_close(
        shuffled.decision_function(X), head.decision_function(X)[:, [2, 0, 1]], atol=1e-6, rtol=0
    )


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), factor=st.floats(0.01, 100))
def test_scaling_samples_and_sigma_alike_changes_nothing_and_scores_are_linear_in_targets(seed, factor):
    X, Y = problem(n=80, seed=seed)
    head, scaled = Falkon(sigma=2.0, penalty=1e-3), Falkon(sigma=2.0 * factor, penalty=1e-3)
    head.fit(X, Y)
    scaled.fit(X * factor, -3.0 * Y)
    torch.testing.assert_close(
        scaled.decision_function(X * factor), -3.0 * head.decision_function(X), atol=1e-5, rtol=1e-5
    )


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), cut=st.integers(30, 150))
def test_partial_fit_equals_a_batch_fit_with_the_same_centers(seed, cut):
    X, Y = problem(n=160, seed=seed)
    pieces, batch = Falkon(sigma=2.0, penalty=1e-3, n_centers=25), Falkon(sigma=2.0, penalty=1e-3)
    pieces.fit(X[:cut], Y[:cut])
    pieces.partial_fit(X[cut:], Y[cut:])
    batch.fit(X, Y, centers=pieces.centers)
    torch.testing.assert_close(pieces.decision_function(X), batch.decision_function(X), atol=1e-6, rtol=0)


def test_a_new_problem_takes_the_earlier_samples_as_negatives():
    X, Y = problem(n=160, t=2)
    Y[:100, 1] = -1
    grown, batch = Falkon(sigma=2.0, penalty=1e-3, n_centers=25), Falkon(sigma=2.0, penalty=1e-3)
    grown.fit(X[:100], Y[:100, :1])
    grown.partial_fit(X[100:], Y[100:])
    batch.fit(X, Y, centers=grown.centers)
    torch.testing.assert_close(grown.decision_function(X), batch.decision_function(X), atol=1e-6, rtol=0)


def test_extending_the_centers_equals_starting_with_them():
    X, Y = problem(n=160)
    head, whole = Falkon(sigma=2.0, penalty=1e-3), Falkon(sigma=2.0, penalty=1e-3)
    head.fit(X, Y, centers=X[:20])
    head.extend_centers(X[20:50], X, Y)
    whole.fit(X, Y, centers=X[:50])
    torch.testing.assert_close(head.decision_function(X), whole.decision_function(X), atol=1e-6, rtol=0)
    head.partial_fit(X[:10], Y[:10])
    whole.partial_fit(X[:10], Y[:10])
    torch.testing.assert_close(head.decision_function(X), whole.decision_function(X), atol=1e-6, rtol=0)


def test_centers_are_not_extended_on_other_samples_than_were_fitted():
    X, Y = problem(n=60)
    head = Falkon(sigma=2.0, penalty=1e-3)
    with pytest.raises(ConfigError, match="extend_centers"):
        head.extend_centers(X[:5], X, Y)
    head.fit(X, Y, centers=X[:20])
    before = head.decision_function(X)
    for samples, targets in ((X[:50], Y[:50]), (X, Y[:, :2])):
        with pytest.raises(DataError, match="60 samples"):
            head.extend_centers(X[20:30], samples, targets)
    head.fit(X, Y, torch.full((60,), 2.0), X[:20])
    with pytest.raises(DataError, match="120 samples"):
        head.extend_centers(X[20:30], X, Y)
    torch.testing.assert_close(head.decision_function(X), before)


@settings(max_examples=50, deadline=None)
@given(n=st.integers(1, 60), positives=st.integers(0, 60), count=st.integers(1, 80), seed=st.integers(0, 99))
def test_balanced_centers_are_distinct_and_at_most_half_positive(n, positives, count, seed):
    Y = -torch.ones(n, 1)
    Y[: min(n, positives)] = 1
    chosen = balanced_centers(Y, count, torch.Generator().manual_seed(seed))
    assert len(chosen) == min(n, count) == len(set(chosen.tolist()))
    if n > count:
        picked, available = int((Y[chosen] > 0).sum()), int((Y > 0).sum())
        assert picked == max(min(available, count // 2), count - (n - available))


def test_balanced_centers_are_shared_evenly_by_the_problems_and_background():
    Y = -torch.ones(1000, 3)
    Y[:500, 0] = Y[500:510, 1] = Y[510:600, 2] = 1
    chosen = balanced_centers(Y, 100, torch.Generator().manual_seed(0))
    assert [int((Y[chosen, c] > 0).sum()) for c in range(3)] == [33, 10, 32]


def test_uniform_centers_are_uniform():
    counts = np.zeros(10)
    for seed in range(2000):
        counts[uniform_centers(10, 3, torch.Generator().manual_seed(seed)).numpy()] += 1
    assert np.abs(counts - 600).max() < 5 * np.sqrt(600 * 0.7)


def test_the_lower_triangle_of_the_gram_matrix_is_the_product():
    K = torch.randn(70, 13, dtype=torch.float64)
    total = torch.zeros(13, 13, dtype=torch.float64)
    add_gram(total, K[:40])
    add_gram(total, K[40:])
    torch.testing.assert_close(total.tril(), (K.T @ K).tril())


def test_the_cheaper_solver_is_chosen():
    assert not is_cheaper_than_direct(20_000, 1000, 21)
    assert is_cheaper_than_direct(80_000, 3200, 1)
    assert not is_cheaper_than_direct(80_000, 3200, 500)
    assert not is_cheaper_than_direct(10**7, 3200, 1)  # rows would not fit in memory


def test_state_dict_carries_the_scores_and_foreign_states_are_refused():
    X, Y = problem(dtype=torch.float32)
    head, copy = Falkon(sigma=2.0), Falkon(sigma=2.0)
    head.fit(X, Y)
    copy.load_state_dict(head.state_dict())
    assert torch.equal(copy.decision_function(X), head.decision_function(X))
    for state in ({"weight": X}, {"centers": X, "alpha": Y[:5]}):
        with pytest.raises(CheckpointError):
            copy.load_state_dict(state)
    assert torch.equal(copy.decision_function(X), head.decision_function(X))
    with pytest.raises(ConfigError, match="partial_fit"):
        copy.partial_fit(X, Y)


def test_bad_input_is_named_and_leaves_the_head_usable():
    X, Y = problem(dtype=torch.float32)
    head = Falkon(sigma=2.0)
    with pytest.raises(NotFittedError):
        head.decision_function(X)
    head.fit(X, Y)
    before = head.decision_function(X)
    broken = X.clone()
    broken[7, 2] = float("nan")
    with pytest.raises(DataError, match="1 of 300 samples, first in sample 7"):
        head.fit(broken, Y)
    with pytest.raises(DataError, match="not finite"):
        head.decision_function(torch.full((2, 6), float("inf")))
    with pytest.raises(DataError, match=r"Y is \(10, 3\)"):
        head.fit(X, Y[:10])
    with pytest.raises(DataError, match="no samples"):
        head.fit(X[:0], Y[:0])
    with pytest.raises(DataError, match="5 features"):
        head.decision_function(X[:, :5])
    with pytest.raises(DataError, match="sample_weight"):
        head.fit(X, Y, -torch.ones(300))
    assert torch.equal(head.decision_function(X), before)


@pytest.mark.parametrize("solver", ["direct", "conjugate_gradients"])
def test_repeated_centers_give_the_function_of_the_distinct_ones(solver):
    X, Y = problem(n=200)
    head, once = Falkon(sigma=2.0, penalty=1e-4, solver=solver), Falkon(sigma=2.0, penalty=1e-4, solver="direct")
    head.fit(X, Y, centers=X[:30].repeat(3, 1))
    once.fit(X, Y, centers=X[:30])
    torch.testing.assert_close(head.decision_function(X), once.decision_function(X), atol=1e-3, rtol=0)


@pytest.mark.parametrize("selection", ["uniform", "balanced"])
@pytest.mark.parametrize("positives", [0, 1, 300])
def test_a_class_without_or_with_one_or_with_only_positives_is_fitted_beside_others(selection, positives):
    X, Y = problem(n=300, t=2)
    Y[:, 0] = -1
    Y[:positives, 0] = 1
    head = Falkon(sigma=2.0, penalty=1e-5, n_centers=200, selection=selection)
    head.fit(X, Y)
    scores = head.decision_function(X)
    assert (torch.sign(scores[positives + 20 :, 0]) == -1).float().mean() > 0.98 or positives == 300
    assert positives != 300 or (scores[:, 0] > 0.8).all()
    assert positives != 1 or scores[:, 0].argmax() == 0 or selection == "uniform"
    assert (torch.sign(scores[:, 1]) == Y[:, 1]).float().mean() > 0.9


def test_half_precision_is_computed_in_single_and_whole_numbers_are_refused():
    X, Y = problem(dtype=torch.float32)
    head, single = Falkon(sigma=2.0), Falkon(sigma=2.0)
    head.fit(X.half(), Y)
    single.fit(X.half().float(), Y)
    torch.testing.assert_close(head.decision_function(X.half()), single.decision_function(X.half().float()))
    with pytest.raises(DataError, match="floating point"):
        head.fit(X.long(), Y)
    with pytest.raises(DataError, match="Y is not finite"):
        head.fit(X, Y * float("inf"))
    before = head.decision_function(X)
    with pytest.raises(DataError, match="cannot be factorized"):  # finite, but their squares are not
        head.fit(torch.full((300, 6), 3e38), Y, centers=X[:5])
    assert torch.equal(head.decision_function(X), before)


def test_one_sample_one_class_and_constant_features_are_handled():
    head = Falkon(sigma=2.0, penalty=1e-3)
    head.fit(torch.ones(1, 4), torch.ones(1, 1))
    assert head.decision_function(torch.ones(1, 4)).item() == pytest.approx(1 / (1 + 1e-3), abs=1e-4)
    head.fit(torch.zeros(50, 4), -torch.ones(50, 2))
    torch.testing.assert_close(head.decision_function(torch.zeros(2, 4)), torch.full((2, 2), -1.0), atol=2e-3, rtol=0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kernel": "gausian"}, "Did you mean 'gaussian'"),
        ({"solver": "dirct"}, "Did you mean 'direct'"),
        ({"selection": "balance"}, "Did you mean 'balanced'"),
        ({"sigma": 0.0}, "sigma is 0.0"),
        ({"penalty": 0.0}, "penalty is 0.0"),
        ({"n_centers": 0}, "n_centers is 0"),
    ],
)
def test_impossible_options_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        Falkon(**options)


def test_inputs_are_not_changed_and_the_precision_of_others_is_restored():
    torch.set_float32_matmul_precision("high")
    X, Y = problem(dtype=torch.float32)
    copies = X.clone(), Y.clone()
    head = Falkon(sigma=2.0)
    head.fit(X, Y)
    head.decision_function(X)
    assert torch.equal(X, copies[0])
    assert torch.equal(Y, copies[1])
    assert torch.get_float32_matmul_precision() == "high"
    torch.set_float32_matmul_precision("highest")
