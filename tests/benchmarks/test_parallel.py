"""Evaluation in several processes gives what one process gives, and survives the loss of one."""

from functools import partial

import numpy as np
import pytest

import icub_core as icub
from icub_benchmarks import parallel
from icub_benchmarks.parallel import WORKER_LOST, evaluate_in_workers
from icub_core.rollouts import EpisodeResults, evaluate

REASONS = ("running", "success", "time_limit")


def results_of(episodes):
    n = len(episodes)
    return EpisodeResults(
        np.ones(n, bool), np.asarray(episodes, float), np.full(n, 9), np.ones(n, int), ("can",) * n, REASONS
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
    results = evaluate_in_workers(icub.make_env, icub.load, 10, num_envs=4, workers=2)
    assert FlakyWorkers.asked == [list(range(10)), [4, 5, 6, 7]]
    assert [e for e in range(10) if not results.success[e]] == [5]
    assert results.ends() == {"success": 9, WORKER_LOST: 1}
    assert results.faults == 1
    np.testing.assert_array_equal(np.delete(results.returns, 5), [0, 1, 2, 3, 4, 6, 7, 8, 9])


@pytest.mark.slow
def test_the_number_of_workers_does_not_change_the_results():
    make_task = partial(icub.make_env, "grasp", objects=["010_potted_meat_can"])
    make_policy = partial(icub.load, "policy", "demonstrations")
    here = evaluate(make_policy(), make_task(num_envs=2), 3, seed=4)
    there = evaluate_in_workers(make_task, make_policy, 3, seed=4, num_envs=2, workers=2)
    np.testing.assert_array_equal(there.returns, here.returns)
    np.testing.assert_array_equal(there.steps, here.steps)
    assert there.ends() == here.ends()
    assert there.objects == here.objects
    assert there.resamples == here.resamples
