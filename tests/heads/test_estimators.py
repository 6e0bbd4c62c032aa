"""The scikit-learn estimators obey scikit-learn's own checks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.datasets import load_iris, make_regression
from sklearn.kernel_ridge import KernelRidge
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import check_estimator, estimator_checks_generator

from icub_segmenters.heads.estimators import FalkonClassifier, FalkonRegressor


@pytest.mark.parametrize("make", [FalkonRegressor, FalkonClassifier])
@pytest.mark.slow  # 60 checks each
def test_every_check_of_scikit_learn_passes_without_exception(make):
    results = check_estimator(make(), on_fail=None, on_skip=None)
    assert [(r["check_name"], str(r["exception"])) for r in results if r["status"] == "failed"] == []
    assert len(results) > 30


def test_the_regressor_is_kernel_ridge_regression_on_centered_targets():
    X, y = make_regression(120, 4, noise=5.0, random_state=0)
    ours = FalkonRegressor(sigma=2.0, penalty=1e-3).fit(X, y)
    theirs = KernelRidge(alpha=1e-3 * 120, kernel="rbf", gamma=1 / 8).fit(X, y - y.mean())
    np.testing.assert_allclose(ours.predict(X), theirs.predict(X) + y.mean(), rtol=1e-6)


def test_grid_search_over_the_width_works():
    X, y = load_iris(return_X_y=True)
    pipeline = make_pipeline(StandardScaler(), FalkonClassifier(penalty=1e-4))
    search = GridSearchCV(pipeline, {"falkonclassifier__sigma": [0.05, 2.0]}, cv=3).fit(X, y)
    assert search.best_params_ == {"falkonclassifier__sigma": 2.0}
    assert search.best_score_ > 0.93


@settings(max_examples=10, deadline=None)
@given(names=st.permutations(["cup", "box", "can"]), seed=st.integers(0, 1000))
def test_the_names_of_classes_and_the_order_of_samples_do_not_matter(names, seed):
    X, y = load_iris(return_X_y=True)
    order = np.random.default_rng(seed).permutation(len(X))
    plain = FalkonClassifier(sigma=1.0, penalty=1e-4).fit(X, y)
    renamed = FalkonClassifier(sigma=1.0, penalty=1e-4).fit(X[order], np.array(names)[y[order]])
    assert (renamed.predict(X) == np.array(names)[plain.predict(X)]).all()
    columns = [list(renamed.classes_).index(name) for name in names]
    np.testing.assert_allclose(renamed.decision_function(X)[:, columns], plain.decision_function(X), atol=1e-6)


def test_the_checks_would_notice_a_broken_estimator():
    class Forgetful(FalkonRegressor):
        def fit(self, X, y, sample_weight=None):
            super().fit(X, y, sample_weight)
            self.penalty = 2 * self.penalty  # fit may not change parameters
            return self

    failures = 0
    for estimator, check in estimator_checks_generator(Forgetful()):
        try:
            check(estimator)
        except Exception:
            failures += 1
    assert failures
