"""Composition: every kind in one configuration, presets with the right precedence, errors in one line."""

import logging

import pytest
from omegaconf import DictConfig, OmegaConf

from icub_core.config.assembly import Assembly
from icub_core.config.compose import compose
from icub_core.config.folders import config_folders, groups
from icub_core.config.settings import build_scene
from icub_core.construct import checked_parameters, split_config
from icub_core.errors import ConfigError, PluginError
from icub_core.kinds import KINDS
from icub_core.registry import load
from icub_testing.tiny import TINY

TINY_WORLD = [f"{kind}=tiny" for kind in ("simulator", "robot", "objects", "grasp_generator")]
COMPOSED = """
from collections.abc import Callable
from icub_core.interfaces.online_head import OnlineHead
from icub_testing.tiny.perception import TinySegmenter
class Composed(TinySegmenter):
    def __init__(self, feature_extractor, online_head: Callable[[], OnlineHead], least_pixels: int = 5, seed: int = 0):
        super().__init__(least_pixels=least_pixels)
        self.extractor, self.head, self.seed = feature_extractor, online_head(), seed
"""


PRESET = """\
# @package _global_
defaults:
  - override /feature_extractor: tiny
  - override /online_head: tiny
  - _self_
segmenter:
  plugin: composed
  least_pixels: 6
"""
EXPERIMENT = """\
# @package _global_
defaults:
  - override /segmenter: composed
  - _self_
online_head:
  penalty: 0.25
seed: 7
"""


@pytest.fixture
def tiny(install):
    """Install the tiny plugins under the name `tiny`, and a segmenter with a preset, a variant and a budget."""
    points = {f"icub.{kind}": {"tiny": target} for kind, target in TINY.items()}
    points["icub.segmenter"]["composed"] = "tiny_composed:Composed"
    points["icub.configs"] = {"tiny": "tiny_configs"}
    files = {
        "tiny_composed.py": COMPOSED,
        "tiny_configs/__init__.py": "raise ImportError('configuration folders are never imported')",
        "tiny_configs/segmenter/composed.yaml": PRESET,
        "tiny_configs/online_head/soft.yaml": "defaults:\n  - tiny\npenalty: 10.0\n",
        "tiny_configs/online_head/stiff.yaml": "plugin: tiny\npenalty: 1.0e-6\n",
        "tiny_configs/segmenter/budget/composed_paper.yaml": "least_pixels: 60\n",
        "tiny_configs/experiment/table.yaml": EXPERIMENT,
    }
    return install("tiny", points, files)


def test_every_kind_has_its_key_and_left_out_stages_are_null(tiny):
    config = compose([*TINY_WORLD, "~grasp_generator", "~task"])
    assert set(KINDS) <= set(config)
    assert config.simulator.plugin == "tiny"
    assert config.segmenter is None
    assert config.grasp_generator is None
    assert config.task is None
    assert config.policy is None


def test_parts_of_a_task_may_be_left_out_where_nothing_acts_in_it(tiny):
    config = compose([*TINY_WORLD, "~grasp_generator"])
    assert config.grasp_generator is None
    assert config.task.plugin == "grasp"


@pytest.mark.parametrize("sign", ["", "+", "++"])
def test_a_plugin_is_chosen_with_or_without_a_sign(tiny, sign):
    assert compose([*TINY_WORLD, f"{sign}policy=tiny"]).policy == {"plugin": "tiny", "speed": 0.5}


def test_a_preset_brings_its_parts_and_the_command_line_wins(tiny):
    config = compose([*TINY_WORLD, "segmenter=composed"])
    assert (config.feature_extractor.plugin, config.online_head.plugin) == ("tiny", "tiny")
    assert config.segmenter.least_pixels == 6
    config = compose([*TINY_WORLD, "online_head=soft", "segmenter=composed", "segmenter.least_pixels=8"])
    assert config.online_head == {"plugin": "tiny", "penalty": 10.0}
    assert config.segmenter.least_pixels == 8


def test_variants_inherit_or_name_their_plugin(tiny):
    assert compose([*TINY_WORLD, "online_head=soft"]).online_head == {"plugin": "tiny", "penalty": 10.0}
    assert compose([*TINY_WORLD, "online_head=stiff"]).online_head == {"plugin": "tiny", "penalty": 1e-6}


def test_a_budget_changes_numbers_and_the_command_line_still_wins(tiny):
    assert compose([*TINY_WORLD, "segmenter=composed", "budget=paper"]).segmenter.least_pixels == 60
    words = [*TINY_WORLD, "segmenter=composed", "budget=paper", "segmenter.least_pixels=8"]
    assert compose(words).segmenter.least_pixels == 8


def test_an_experiment_stands_between_preset_and_command_line(tiny):
    config = compose([*TINY_WORLD, "experiment=table"])
    assert (config.segmenter.plugin, config.online_head.penalty, config.seed) == ("composed", 0.25, 7)
    assert compose([*TINY_WORLD, "experiment=table", "online_head.penalty=3"]).online_head.penalty == 3.0


def test_seed_and_device_of_the_run_reach_the_plugins_unless_they_have_their_own(tiny):
    assert compose([*TINY_WORLD, "segmenter=composed", "seed=5"]).segmenter.seed == 5
    assert compose([*TINY_WORLD, "segmenter=composed", "seed=5", "segmenter.seed=6"]).segmenter.seed == 6


def test_configuration_names_plugins_and_never_code(tiny):
    text = OmegaConf.to_yaml(compose([*TINY_WORLD, "segmenter=composed", "policy=tiny"]))
    assert "_target_" not in text
    assert "tiny_composed" not in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["segmenter=composd"], "no segmenter plugin named 'composd'. Did you mean 'composed'?"),
        (
            ["segmenter=composed", "segmenter.least_pixel=3"],
            "segmenter 'composed' has no parameter 'least_pixel'. Did you mean 'least_pixels'?",
        ),
        (["segmenter=composed", "+segmenter.added=3"], "segmenter 'composed' has no parameter 'added'."),
        (
            ["segmenter=composed", "segmenter.least_pixels=few"],
            "segmenter.least_pixels=few (of 'composed') has the wrong type; expected int",
        ),
        (["online_head=stiff", "online_head.penalty=x"], "has the wrong type; expected float"),
        (
            ["segmenter=composed", "~online_head"],
            "segmenter 'composed' needs an online_head; add online_head=NAME. Known: ",
        ),
        (["policy.speed=1"], "policy.speed is set, but no policy is chosen; add policy=NAME"),
        (["policy=tiny", "policy.speed=[1"], "input '[1'"),
        (["seed=abc"], "seed=abc has the wrong type; expected int"),
        (["scene.timstep=1"], "'scene' has no key 'timstep'. Did you mean 'timestep'?"),
        (["scene.timestep=x"], "scene.timestep: Value 'x' of type 'str' could not be converted to Float"),
        (["pipeline.teach.frames=x"], "pipeline.teach.frames: Value 'x'"),
        (["pipeline.teach.frams=3"], "'pipeline.teach' has no key 'frams'. Did you mean 'frames'?"),
        (["dataset=tiny"], "dataset=tiny is set, but nothing in this run reads a data set; leave it out"),
        (["budget=enormous"], "no budget configuration named 'enormous'. Known: laptop, paper"),
        (["seed=1,2"], "add -m"),
        (["device=${nothing}"], "nothing"),
    ],
)
def test_mistakes_stop_in_one_line(tiny, words, message):
    with pytest.raises(ConfigError) as caught:
        compose([*TINY_WORLD, *words])
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_data_set_may_be_chosen_where_a_plugin_reads_it(tiny, install):
    source = """
from icub_testing.tiny.skills import TinyPolicy
class Reads(TinyPolicy):
    def __init__(self, dataset=None): ...
"""
    install("reader", {"icub.policy": {"reads": "reads_data:Reads"}}, {"reads_data.py": source})
    assert compose([*TINY_WORLD, "policy=reads", "dataset=tiny"]).dataset.plugin == "tiny"


def test_a_broken_plugin_stops_only_runs_that_choose_it(tiny, install):
    install("broken", {"icub.policy": {"broken": "broken_module:Broken"}}, {"broken_module.py": "1/0"})
    assert compose([*TINY_WORLD, "policy=tiny"]).policy.plugin == "tiny"
    with pytest.raises(PluginError, match=r"'broken' .*cannot be imported: ZeroDivisionError: division by zero"):
        compose([*TINY_WORLD, "policy=broken"])


def test_a_missing_configuration_folder_is_reported_and_left_out(tiny, install, caplog):
    install("forgetful", {"icub.configs": {"forgetful": "forgetful_configs"}})
    with caplog.at_level(logging.WARNING):
        assert compose(TINY_WORLD).simulator.plugin == "tiny"
    assert "the configuration folder 'forgetful_configs' of forgetful does not exist" in caplog.text


def test_a_folder_of_ones_own_is_searched_too(tiny, tmp_path):
    (tmp_path / "online_head").mkdir()
    (tmp_path / "online_head" / "mine.yaml").write_text("plugin: tiny\npenalty: 0.125\n")
    config = compose([*TINY_WORLD, "online_head=mine"], config_dir=tmp_path)
    assert config.online_head.penalty == 0.125
    (tmp_path / "online_head" / "wrong.yaml").write_text("plugin: tiny\npenaltie: 0.125\n")
    with pytest.raises(ConfigError, match="online_head 'tiny' has no parameter 'penaltie'. Did you mean 'penalty'?"):
        compose([*TINY_WORLD, "online_head=wrong"], config_dir=tmp_path)


def test_an_assembly_builds_each_plugin_once_with_what_it_needs(tiny):
    plugins = Assembly(compose([*TINY_WORLD, "segmenter=composed", "online_head.penalty=0.5", "seed=4"]))
    segmenter = plugins.get("segmenter")
    assert segmenter.extractor is plugins.get("feature_extractor")
    assert segmenter.head._penalty == 0.5
    assert segmenter.seed == 4
    assert plugins.get("segmenter") is segmenter
    assert plugins.fresh("segmenter") is not segmenter
    assert plugins.fresh("segmenter").extractor is segmenter.extractor
    assert plugins.chosen("policy") is None
    with pytest.raises(ConfigError, match=r"no policy is chosen; add policy=NAME\. Known: .*resprect"):
        plugins.get("policy")


def test_plugins_that_need_each_other_are_told(install):
    source = """
from icub_testing.tiny.skills import TinyPolicy
from icub_testing.tiny.perception import TinySegmenter
class A(TinyPolicy):
    def __init__(self, segmenter): ...
class B(TinySegmenter):
    def __init__(self, policy): ...
"""
    install(
        "circle",
        {"icub.policy": {"a": "circle_module:A"}, "icub.segmenter": {"b": "circle_module:B"}},
        {"circle_module.py": source},
    )
    with pytest.raises(ConfigError, match="in a circle: policy -> segmenter -> policy"):
        Assembly({"policy": {"plugin": "a"}, "segmenter": {"plugin": "b"}}).get("policy")


def test_typed_groups_become_the_dataclasses_of_the_core(tiny):
    config = compose([*TINY_WORLD, "scene.table_center=[-0.6,0,0.8]", "scene.timestep=0.002"])
    scene = build_scene(config.scene, [])
    assert scene.timestep == 0.002
    assert scene.table is not None
    assert scene.table.center == (-0.6, 0.0, 0.8)


def test_the_task_s_numbers_arrive_in_the_types_of_its_constructor(tiny):
    config = compose([*TINY_WORLD, "task.max_steps=99", "task.x_range=[-0.5,-0.25]"])
    name, parameters = split_config("task", config.task)
    arguments = checked_parameters("task", name, load("task", name), parameters)
    assert arguments["max_steps"] == 99
    assert arguments["x_range"] == (-0.5, -0.25)
    assert isinstance(arguments["y_range"], tuple)


FOLDER = config_folders()[0]
PRESETS = sorted(file.relative_to(FOLDER) for file in FOLDER.glob("*/budget/*.yaml"))


@pytest.mark.parametrize("preset", PRESETS, ids=str)
def test_every_budget_preset_fits_its_plugin_and_changes_something(preset):
    kind = preset.parts[0]
    plugin, _, budget = preset.stem.rpartition("_")
    with_it = compose([f"{kind}={plugin}", f"budget={budget}"])
    without = compose([f"{kind}={plugin}"])
    assert with_it.budget == budget
    values = OmegaConf.load(FOLDER / preset)
    assert isinstance(values, DictConfig)
    assert {key: with_it[kind][key] for key in values} == values
    assert {key: without[kind][key] for key in values} != values


@pytest.mark.parametrize("experiment", [name for name in groups()["experiment"]])
def test_every_experiment_composes(experiment):
    assert compose(["+segmenter=falkon", "+policy=resprect", f"experiment={experiment}"]).pipeline.plugin == "main"


def test_the_main_job_composes_from_what_ships():
    config = compose(["+segmenter=falkon", "+policy=resprect"])
    chosen = {kind: config[kind].plugin for kind in KINDS if config[kind] is not None}
    assert chosen == {
        "feature_extractor": "compact", "online_head": "falkon", "segmenter": "falkon", "simulator": "mujoco",
        "grasp_generator": "superquadrics", "policy": "resprect", "robot": "icub", "objects": "ycb_primitives",
        "task": "grasp", "pipeline": "main",
    }  # fmt: skip


def test_a_data_set_that_the_caller_reads_composes(tiny):
    """`icub_core.load` asks for one without a run."""
    assert compose([*TINY_WORLD, "dataset=tiny"], read=["dataset"]).dataset.plugin == "tiny"
