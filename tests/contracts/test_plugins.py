"""Every plugin that ships keeps the contract of its kind; none is left out silently."""

from pathlib import Path

import pytest

from icub_core.kinds import KINDS
from icub_core.registry import PluginInfo
from icub_support.commands.plugins import every_plugin
from icub_testing.checks import checks
from icub_testing.fakes import with_tiny_dependencies

TESTS = Path(__file__).resolve().parents[1]
WITH_THEIR_DATA = {
    "feature_extractor": "feature_extractors",
    "simulator": "simulators",
    "objects": "simulators/test_objects.py",
    "dataset": ".",
    "episodes": "datasets",
}
"""Kinds whose plugins need weights, an engine or files: their own tests run the contract."""


def _own() -> list[PluginInfo]:
    return [plugin for plugin in every_plugin() if plugin.distribution.startswith("icub-kit ")]


TRAINS_A_NETWORK = {"mask_rcnn"}
"""Plugins whose every update trains a deep network."""
HERE = [plugin for plugin in _own() if plugin.kind not in WITH_THEIR_DATA]


@pytest.mark.parametrize(
    ("plugin", "check"),
    [
        pytest.param(
            plugin,
            name,
            id=f"{plugin.kind}-{plugin.name}-{name.removeprefix('check_')}",
            marks=[pytest.mark.slow] if plugin.name in TRAINS_A_NETWORK else [],
        )
        for plugin in HERE
        for name in checks(plugin.kind)
    ],
)
def test_contract(plugin, check):
    checks(plugin.kind)[check](with_tiny_dependencies(plugin.kind, plugin.name))


@pytest.mark.parametrize("plugin", [p for p in _own() if p.kind in WITH_THEIR_DATA], ids=lambda p: f"{p.kind}-{p.name}")
def test_the_contract_is_run_elsewhere(plugin):
    place = TESTS / WITH_THEIR_DATA[plugin.kind]
    files = [place] if place.is_file() else sorted(place.rglob("*.py"))
    text = "\n".join(file.read_text(encoding="utf-8") for file in files)
    assert "icub_testing.c" in text, "neither the checks nor the contract classes are imported there"
    assert plugin.target.partition(":")[2] in text, f"{plugin.target} is not named in {place}"


def test_every_kind_has_a_plugin_that_ships_or_is_known_to_have_none():
    assert {kind for kind in KINDS if not any(p.kind == kind for p in _own())} <= {"dataset"}
