"""Every check can fail: one deliberately faulty plugin a check fails that check and no other."""

import pytest

from icub_core.kinds import KINDS
from icub_testing.checks import checks, run_checks, summary
from icub_testing.tiny import TINY, tiny_class

from .faulty import perception, pipeline, skills, task, world  # noqa: F401  # they register their classes
from .faulty.base import FAULTY


def _failing(kind, make):
    return {result.name: result.problem for result in run_checks(kind, make) if result.problem}


@pytest.mark.parametrize("kind", KINDS)
def test_the_tiny_plugin_keeps_its_contract(kind):
    assert _failing(kind, tiny_class(kind)) == {}


def test_every_check_of_every_kind_has_its_faulty_plugin():
    assert {(kind, name) for kind in KINDS for name in checks(kind)} == set(FAULTY)
    assert set(TINY) == set(KINDS)


@pytest.mark.parametrize(("kind", "check"), sorted(FAULTY), ids=lambda value: value.removeprefix("check_"))
def test_a_faulty_plugin_fails_its_check_and_no_other(kind, check):
    failing = _failing(kind, FAULTY[kind, check])
    assert set(failing) == {check}, failing
    assert failing[check]
    assert "\n" not in failing[check], "the table shows one line a problem"


@pytest.mark.parametrize("kind", KINDS)
def test_every_check_says_what_it_checks(kind):
    assert all(len(summary(check)) > 20 for check in checks(kind).values())
