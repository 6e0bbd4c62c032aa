"""See, grasp, compose: the interfaces of the iCub kit, and the calls that most users need.

    import icub_core as icub
    env = icub.make_env("grasp", objects=["004_sugar_box"], num_envs=4)

Names are imported when they are first used: ``import icub_core`` by itself reads nothing but package metadata.
docs/public_api.md says which names are public and how long they stay.
"""

from importlib import import_module
from typing import Any

from icub_core.aliases import install_aliases
from icub_core.gymnasium_ids import register

__version__ = "0.2.0"

_PUBLIC = {
    "Assembly": "icub_core.config.assembly",
    "CameraView": "icub_core.scene",
    "CheckpointError": "icub_core.errors",
    "ConfigError": "icub_core.errors",
    "DataError": "icub_core.errors",
    "Dataset": "icub_core.interfaces.dataset",
    "EpisodeResults": "icub_core.rollouts",
    "FeatureExtractor": "icub_core.interfaces.feature_extractor",
    "Grasp": "icub_core.data",
    "GraspGenerator": "icub_core.interfaces.grasp_generator",
    "GraspProposals": "icub_core.data",
    "HandDescription": "icub_core.robot_description",
    "IcubError": "icub_core.errors",
    "Instance": "icub_core.data",
    "ObjectSet": "icub_core.interfaces.object_set",
    "ObjectSpec": "icub_core.scene",
    "OnlineHead": "icub_core.interfaces.online_head",
    "Pipeline": "icub_core.interfaces.pipeline",
    "PluginError": "icub_core.errors",
    "PointCloud": "icub_core.data",
    "Policy": "icub_core.interfaces.policy",
    "RgbdFrame": "icub_core.data",
    "Robot": "icub_core.interfaces.robot",
    "RobotDescription": "icub_core.robot_description",
    "Run": "icub_core.run",
    "Scene": "icub_core.scene",
    "Segmenter": "icub_core.interfaces.segmenter",
    "SimulationError": "icub_core.errors",
    "Simulator": "icub_core.interfaces.simulator",
    "Stage": "icub_core.interfaces.pipeline",
    "Task": "icub_core.interfaces.task",
    "World": "icub_core.interfaces.world",
    "build": "icub_core.construct",
    "compose": "icub_core.config.compose",
    "evaluate": "icub_core.rollouts",
    "listen": "icub_core.hooks",
    "load": "icub_core.api",
    "make_env": "icub_core.api",
}
"""Public name to the module that holds it."""

__all__ = [*_PUBLIC, "__version__"]  # noqa: PLE0604 - strings, all of them


def __getattr__(name: str) -> Any:
    module = _PUBLIC.get(name)
    if module is None:
        raise AttributeError(f"module 'icub_core' has no attribute '{name}'")
    return getattr(import_module(module), name)


def __dir__() -> list[str]:
    return sorted(__all__)


install_aliases()
register()
