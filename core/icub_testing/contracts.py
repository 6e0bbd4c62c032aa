"""The checks of every kind as pytest classes.

A third party's test file is a class and a fixture::

    class TestMine(SegmenterContract):
        expected_failures = {"check_repeatable": "uses the clock"}  # optional, strict

        @pytest.fixture
        def make_plugin(self):
            return lambda: MySegmenter(tolerance=0.2)
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import pytest

from icub_core.errors import ContractError, unknown_name
from icub_testing.checks import Check, Make, checks


class PluginContract:
    """One test per check; subclass the class of your kind and override `make_plugin`."""

    kind: ClassVar[str] = ""
    expected_failures: ClassVar[Mapping[str, str]] = {}
    """Check to the reason why it is known to fail; it must then fail."""

    @pytest.fixture
    def make_plugin(self) -> Make:
        """Return a factory without arguments that builds a fresh plugin."""
        raise ContractError(f"{type(self).__name__} must override the fixture make_plugin")

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Make one test of every check of the kind."""
        if "contract_check" not in metafunc.fixturenames:
            return
        known = checks(self.kind)
        for name in self.expected_failures:
            if name not in known:
                raise ContractError(unknown_name(f"check of {self.kind} plugins", name, known))
        cases = []
        for name, check in known.items():
            reason = self.expected_failures.get(name)
            marks = [pytest.mark.xfail(reason=reason, strict=True)] if reason is not None else []
            cases.append(pytest.param(check, id=name.removeprefix("check_"), marks=marks))
        metafunc.parametrize("contract_check", cases)

    def test_contract(self, contract_check: Check, make_plugin: Make) -> None:
        """The plugin keeps one property of its kind's contract."""
        contract_check(make_plugin)


class FeatureExtractorContract(PluginContract):
    """Checks of feature extractors."""

    kind = "feature_extractor"


class OnlineHeadContract(PluginContract):
    """Checks of on-line heads."""

    kind = "online_head"


class SegmenterContract(PluginContract):
    """Checks of segmenters."""

    kind = "segmenter"


class GraspGeneratorContract(PluginContract):
    """Checks of grasp generators."""

    kind = "grasp_generator"


class PolicyContract(PluginContract):
    """Checks of policies."""

    kind = "policy"


class SimulatorContract(PluginContract):
    """Checks of simulators."""

    kind = "simulator"


class RobotContract(PluginContract):
    """Checks of robots."""

    kind = "robot"


class ObjectSetContract(PluginContract):
    """Checks of object sets."""

    kind = "objects"


class DatasetContract(PluginContract):
    """Checks of data sets."""

    kind = "dataset"


class EpisodesContract(PluginContract):
    """Checks of recorded episodes."""

    kind = "episodes"


class TaskContract(PluginContract):
    """Checks of tasks."""

    kind = "task"


class PipelineContract(PluginContract):
    """Checks of pipelines."""

    kind = "pipeline"
