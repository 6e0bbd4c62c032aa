"""Plugins are found without being imported, and loaded with errors that help."""

import sys

import pytest

from icub_core import registry
from icub_core.construct import build, factory
from icub_core.errors import ConfigError, PluginError
from icub_core.interfaces.segmenter import Segmenter
from icub_core.kinds import KINDS
from icub_testing.tiny.perception import TinyFeatureExtractor, TinyHead

TINY_SEGMENTER = "icub_testing.tiny.perception:TinySegmenter"


def test_finding_imports_no_plugin(install):
    install("third", {"icub.segmenter": {"third": "third_module:Third"}}, {"third_module.py": "raise SystemExit(3)"})
    found = registry.available("segmenter")["third"]
    assert found.target == "third_module:Third"
    assert found.distribution == "third 1.0"
    assert "third_module" not in sys.modules


def test_a_third_party_plugin_is_loaded_and_built(install):
    install("third", {"icub.segmenter": {"third": TINY_SEGMENTER}})
    assert issubclass(registry.load("segmenter", "third"), Segmenter)
    built = build("segmenter", {"plugin": "third", "tolerance": "0.3"})
    assert built._tolerance == 0.3


@pytest.mark.parametrize("kind", KINDS)
def test_every_announced_name_has_a_target_of_its_own(kind):
    assert all(not plugin.conflicts for plugin in registry.available(kind).values())


def test_an_unknown_kind_names_the_nearest():
    with pytest.raises(PluginError, match=r"no plugin kind named 'segmentr'\. Did you mean 'segmenter'\?"):
        registry.available("segmentr")


def test_an_unknown_name_names_the_nearest_and_all():
    with pytest.raises(PluginError, match=r"no segmenter plugin named 'falcon'\. Did you mean 'falkon'\? Known: "):
        registry.load("segmenter", "falcon")


@pytest.mark.parametrize(
    ("source", "cause"),
    [
        ("import no_such_library", "ModuleNotFoundError: No module named 'no_such_library'"),
        ("def broken(:", "SyntaxError: invalid syntax"),
        ("raise RuntimeError('first line\\nsecond line')", "RuntimeError: first line"),
        ("raise SystemExit('leaving')", "SystemExit: leaving"),
        ("Other = 1", "AttributeError"),
    ],
)
def test_a_broken_plugin_gives_one_line_with_target_and_cause(install, source, cause):
    install("broken", {"icub.policy": {"broken": "broken_module:Broken"}}, {"broken_module.py": source})
    with pytest.raises(PluginError) as caught:
        registry.load("policy", "broken")
    message = str(caught.value)
    assert "broken_module:Broken" in message
    assert "broken 1.0" in message
    assert cause in message
    assert "\n" not in message


def test_a_broken_plugin_does_not_disturb_others(install):
    install("broken", {"icub.segmenter": {"broken": "broken_module:Broken"}}, {"broken_module.py": "1/0"})
    install("third", {"icub.segmenter": {"third": TINY_SEGMENTER}})
    assert build("segmenter", "third") is not None


def test_a_plugin_of_another_kind_is_refused(install):
    install("third", {"icub.policy": {"odd": TINY_SEGMENTER}})
    with pytest.raises(PluginError, match=r"is not a subclass of icub_core\.interfaces\.policy\.Policy"):
        registry.load("policy", "odd")


def test_a_function_is_no_plugin(install):
    install("third", {"icub.policy": {"odd": "odd_module:make"}}, {"odd_module.py": "def make(): ..."})
    with pytest.raises(PluginError, match="is not a subclass"):
        registry.load("policy", "odd")


def test_two_distributions_with_one_name_are_refused_but_only_that_name(install):
    install("first", {"icub.segmenter": {"same": TINY_SEGMENTER, "mine": TINY_SEGMENTER}})
    install("second", {"icub.segmenter": {"same": "elsewhere:Other"}})
    with pytest.raises(PluginError, match=r"'same' is announced by more than one distribution: \w+ 1\.0, \w+ 1\.0"):
        registry.load("segmenter", "same")
    assert registry.load("segmenter", "mine")


def test_dependencies_are_passed_and_heads_as_a_factory(install):
    source = """
from icub_testing.tiny.perception import TinySegmenter
class Composed(TinySegmenter):
    def __init__(self, feature_extractor, online_head, least_pixels: int = 5):
        super().__init__(least_pixels=least_pixels)
        self.extractor, self.heads = feature_extractor, [online_head(), online_head()]
"""
    install(
        "third",
        {
            "icub.segmenter": {"composed": "composed_module:Composed"},
            "icub.online_head": {"tiny": "icub_testing.tiny.perception:TinyHead"},
        },
        {"composed_module.py": source},
    )
    extractor = TinyFeatureExtractor()
    heads = factory("online_head", {"plugin": "tiny", "penalty": 0.5})
    built = build("segmenter", "composed", feature_extractor=extractor, online_head=heads, least_pixels=7)
    assert built.extractor is extractor
    assert built._min_pixels == 7
    first, second = built.heads
    assert isinstance(first, TinyHead)
    assert first is not second
    assert first._penalty == 0.5


def test_a_missing_dependency_names_the_choices():
    with pytest.raises(ConfigError, match=r"needs a feature_extractor; add feature_extractor=NAME\. Known: .*compact"):
        build("segmenter", "falkon")


def test_a_constructor_that_fails_is_one_line(install):
    source = """
from icub_testing.tiny.perception import TinySegmenter
class Fails(TinySegmenter):
    def __init__(self):
        self.missing
"""
    install("third", {"icub.segmenter": {"fails": "fails_module:Fails"}}, {"fails_module.py": source})
    with pytest.raises(PluginError, match=r"'fails' cannot be constructed: AttributeError"):
        build("segmenter", "fails")


def test_a_factory_is_checked_before_its_first_call():
    with pytest.raises(ConfigError, match="has no parameter 'sigmma'. Did you mean 'sigma'"):
        factory("online_head", {"plugin": "falkon", "sigmma": 3.0})


@pytest.mark.parametrize("config", [{}, {"plugin": None}, {"plugin": 3}, None])
def test_a_configuration_without_a_name_says_what_to_add(config):
    with pytest.raises(ConfigError, match="Known: .*falkon"):
        build("segmenter", config)
