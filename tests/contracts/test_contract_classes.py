"""The pytest classes: pass, fail, expected failure, and what a forgotten fixture or a misspelt name says."""

import os
import subprocess
import sys

import pytest

from icub_core.errors import ContractError
from icub_testing.contracts import ObjectSetContract

TEST_FILE = """
import pytest
from icub_testing.contracts import ObjectSetContract
from icub_testing.tiny.things import TinyObjects

class Repeats(TinyObjects):
    names = ("red", "red")

class TestGood(ObjectSetContract):
    @pytest.fixture
    def make_plugin(self):
        return TinyObjects

class TestBad(TestGood):
    @pytest.fixture
    def make_plugin(self):
        return Repeats

class TestKnownToBeBad(TestBad):
    expected_failures = {"check_names": "names repeat"}

class TestBetterThanSaid(TestGood):
    expected_failures = {"check_names": "names repeat"}

class TestForgotten(ObjectSetContract):
    pass
"""


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    folder = tmp_path_factory.mktemp("third")
    (folder / "test_third.py").write_text(TEST_FILE)
    command = [sys.executable, "-m", "pytest", "-rA", "-p", "no:cacheprovider", "-c", os.devnull, str(folder)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder).stdout


def test_a_good_plugin_passes_every_check(outcome):
    assert outcome.count("PASSED test_third.py::TestGood::") == 7
    assert "FAILED test_third.py::TestGood" not in outcome


def test_a_bad_plugin_fails_its_check_with_the_reason(outcome):
    assert "FAILED test_third.py::TestBad::test_contract[names]" in outcome
    assert outcome.count("FAILED test_third.py::TestBad::") == 1
    assert "expected every name once; got a name twice" in outcome


def test_an_expected_failure_is_strict(outcome):
    assert "XFAIL test_third.py::TestKnownToBeBad::test_contract[names]" in outcome
    assert "FAILED test_third.py::TestBetterThanSaid::test_contract[names]" in outcome


def test_a_forgotten_fixture_says_what_to_override(outcome):
    assert "TestForgotten must override the fixture make_plugin" in outcome


def test_a_misspelt_check_names_the_nearest():
    class Misspelt(ObjectSetContract):
        expected_failures = {"check_nmaes": "names repeat"}

    class Metafunc:
        fixturenames = ("contract_check",)

    with pytest.raises(
        ContractError, match=r"no check of objects plugins named 'check_nmaes'\. Did you mean 'check_names'\?"
    ):
        Misspelt().pytest_generate_tests(Metafunc())
