"""Processes that do jobs: order, losses, errors."""

import os
import time

import pytest

from icub_benchmarks.workers import Workers
from icub_core.errors import ConfigError, DataError, SimulationError


def square(job):
    return job * job


def make_square():
    return square


def troubled(job):
    if job == "die":
        os._exit(3)
    if job == "hang":
        time.sleep(60)
    if job == "data":
        raise DataError("no cloud")
    if job == "bug":
        raise ZeroDivisionError("division by zero")
    return job


def make_troubled():
    return troubled


def die_at_once():
    os._exit(1)


@pytest.mark.parametrize("count", [1, 3])
def test_results_come_in_the_order_of_the_jobs(count):
    seen = []
    with Workers(make_square, count) as workers:
        assert workers.map(range(7), seen.append) == [k * k for k in range(7)]
        assert workers.map([5]) == [25]
    assert seen == list(range(1, 8))


def test_a_worker_that_dies_costs_its_job_only():
    with Workers(make_troubled, 2) as workers:
        assert workers.map(["a", "die", "b", "c"]) == ["a", None, "b", "c"]
        assert workers.replaced == 1


def test_a_worker_that_hangs_is_replaced():
    with Workers(make_troubled, 1, patience=3.0) as workers:
        begun = time.monotonic()
        assert workers.map(["hang", "b"]) == [None, "b"]
        assert time.monotonic() - begun < 30


def test_errors_reach_the_caller_in_one_line():
    with Workers(make_troubled, 1) as workers, pytest.raises(DataError, match="no cloud"):
        workers.map(["data"])
    with Workers(make_troubled, 1) as workers, pytest.raises(SimulationError, match="ZeroDivisionError: division"):
        workers.map(["bug"])


def test_a_worker_that_cannot_be_set_up_is_an_error():
    with Workers(die_at_once, 1) as workers, pytest.raises(SimulationError, match="before it was set up"):
        workers.map([1])


@pytest.mark.parametrize(("count", "patience"), [(0, 1.0), (1, 0.0)])
def test_numbers_of_nothing_are_refused(count, patience):
    with pytest.raises(ConfigError, match="at least 1"):
        Workers(make_square, count, patience)
