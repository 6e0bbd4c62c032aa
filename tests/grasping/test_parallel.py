"""Evaluation in several processes gives what one process gives, and survives the loss of one."""

import numpy as np
import pytest

from icub_benchmarks import parallel
from icub_benchmarks.parallel import EnvRecipe, evaluate_in_workers
from icub_core.construct import build
from icub_core.rollouts import EpisodeResults, evaluate
from icub_tasks.grasping.termination import FIRST_FAULT, EndReason


def results_of(episodes):
    n = len(episodes)
    return EpisodeResults(
        np.ones(n, bool), np.asarray(episodes, float), np.full(n, 9), np.full(n, EndReason.SUCCESS), ("can",) * n
    )


class FlakyWorkers:
    """Loses whatever holds episode 5, and counts what it was asked."""

    asked: list[list[int]] = []

    def __init__(self, make, count, patience):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def map(self, jobs, progress=None):
        spans = [list(range(job.first, job.first + job.count)) for job in jobs]
        self.asked.append([e for span in spans for e in span])
        return [None if 5 in span else results_of(span) for span in spans]


def test_a_lost_worker_costs_one_episode(monkeypatch):
    monkeypatch.setattr(parallel, "Workers", FlakyWorkers)
    FlakyWorkers.asked.clear()
    results = evaluate_in_workers(EnvRecipe(("can",), worlds=4), "demonstrations", 10, workers=2)
    assert FlakyWorkers.asked == [list(range(10)), [4, 5, 6, 7]]
    assert [e for e in range(10) if not results.success[e]] == [5]
    assert results.reasons[5] == EndReason.WORKER_LOST >= FIRST_FAULT
    np.testing.assert_array_equal(np.delete(results.returns, 5), [0, 1, 2, 3, 4, 6, 7, 8, 9])


@pytest.mark.slow
def test_the_number_of_workers_does_not_change_the_results():
    recipe = EnvRecipe(("010_potted_meat_can",), worlds=2)
    here = evaluate(build("policy", "demonstrations"), recipe.build(), 3, seed=4)
    there = evaluate_in_workers(recipe, "demonstrations", 3, seed=4, workers=2)
    np.testing.assert_array_equal(there.returns, here.returns)
    np.testing.assert_array_equal(there.steps, here.steps)
    np.testing.assert_array_equal(there.reasons, here.reasons)
    assert there.objects == here.objects
    assert there.resamples == here.resamples
