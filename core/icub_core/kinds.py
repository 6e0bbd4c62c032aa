"""The kinds of plugins: what each is called everywhere and which interface it implements.

One word is the key of the registry, the group of the configuration, the suffix of the entry-point group and, in a
constructor, the name of the parameter that receives an instance of that kind (or a zero-argument factory of instances,
where the annotation is a Callable).
"""

from __future__ import annotations

from dataclasses import dataclass

from icub_core.errors import PluginError, unknown_name

ENTRY_POINT_PREFIX = "icub."


@dataclass(frozen=True)
class Kind:
    """One kind of plugin.

    Attributes:
        name: Key in the registry and group in the configuration.
        interface: ``module:Class`` of the abstract base class; imported only when a plugin is loaded.
        summary: What plugins of this kind do, in a few words.
        version: Of the interface; it rises when a plugin that kept the contract must be changed to keep it again.
    """

    name: str
    interface: str
    summary: str
    version: int = 1

    @property
    def entry_point_group(self) -> str:
        """Group under which distributions announce plugins of this kind."""
        return ENTRY_POINT_PREFIX + self.name


def _kind(name: str, module: str, cls: str, summary: str, version: int = 1) -> Kind:
    return Kind(name, f"icub_core.interfaces.{module}:{cls}", summary, version)


KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        _kind("feature_extractor", "feature_extractor", "FeatureExtractor", "pre-trained features and regions"),
        _kind("online_head", "online_head", "OnlineHead", "classifiers trained in seconds on features"),
        _kind("segmenter", "segmenter", "Segmenter", "learns objects from a stream and finds them again"),
        _kind("grasp_generator", "grasp_generator", "GraspGenerator", "hand poses from a point cloud", 2),
        _kind("policy", "policy", "Policy", "controls arm and hand in a task", 2),
        _kind("simulator", "simulator", "Simulator", "physics and cameras", 2),
        _kind("robot", "robot", "Robot", "description and kinematics", 2),
        _kind("objects", "object_set", "ObjectSet", "named objects to put on a table"),
        _kind("dataset", "dataset", "Dataset", "annotated images"),
        _kind("episodes", "episodes", "Episodes", "recorded motions of a robot"),
        _kind("task", "task", "Task", "episodes with rewards, as a batch of worlds"),
        _kind("pipeline", "pipeline", "Pipeline", "what a run does, stage by stage"),
    )
}


def get_kind(name: str) -> Kind:
    """Return the kind called `name`; raises PluginError with the nearest valid one."""
    if name not in KINDS:
        raise PluginError(unknown_name("plugin kind", name, KINDS))
    return KINDS[name]
