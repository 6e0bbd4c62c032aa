"""Minimal reference plugins, used as test doubles and to validate the checks."""

from importlib import import_module
from typing import Any

TINY: dict[str, str] = {
    "feature_extractor": "icub_testing.tiny.perception:TinyFeatureExtractor",
    "online_head": "icub_testing.tiny.perception:TinyHead",
    "segmenter": "icub_testing.tiny.perception:TinySegmenter",
    "grasp_generator": "icub_testing.tiny.skills:TinyGraspGenerator",
    "policy": "icub_testing.tiny.skills:TinyPolicy",
    "simulator": "icub_testing.tiny.simulator:TinySimulator",
    "robot": "icub_testing.tiny.robot:TinyRobot",
    "objects": "icub_testing.tiny.things:TinyObjects",
    "dataset": "icub_testing.tiny.things:TinyDataset",
    "episodes": "icub_testing.tiny.things:TinyEpisodes",
    "task": "icub_testing.tiny.task:TinyTask",
    "pipeline": "icub_testing.tiny.pipeline:TinyPipeline",
}
"""Kind to ``module:Class`` of its tiny plugin."""


def tiny_class(kind: str) -> Any:
    """Import and return the tiny plugin of a kind."""
    module, _, cls = TINY[kind].partition(":")
    return getattr(import_module(module), cls)
