"""Builds the plugins of a composed configuration, each once, in the order in which they need one another."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, overload

from icub_core.config.schema import signature
from icub_core.errors import ConfigError
from icub_core.interfaces.dataset import Dataset
from icub_core.interfaces.feature_extractor import FeatureExtractor
from icub_core.interfaces.grasp_generator import GraspGenerator
from icub_core.interfaces.object_set import ObjectSet
from icub_core.interfaces.online_head import OnlineHead
from icub_core.interfaces.policy import Policy
from icub_core.interfaces.robot import Robot
from icub_core.interfaces.segmenter import Segmenter
from icub_core.interfaces.simulator import Simulator
from icub_core.kinds import KINDS, get_kind
from icub_core.registry import build, factory, load, split_config


class Assembly:
    """The plugins of one run.

        plugins = Assembly(compose(["segmenter=falkon", "policy=resprect"]))
        segmenter = plugins.get("segmenter")   # builds its feature extractor first

    A constructor's parameter that is named like a kind receives the run's instance of that kind; `online_head` receives
    a zero-argument factory, since a segmenter needs several heads.
    """

    def __init__(self, config: Mapping[str, Any]) -> None:
        """Remember the configuration; nothing is built yet.

        Args:
            config: A node per kind, as composed; kinds that are absent or None are not chosen.
        """
        self._config = config
        self._built: dict[str, Any] = {}
        self._under_way: list[str] = []

    def chosen(self, kind: str) -> str | None:
        """Return the name of the plugin of this kind, or None when the stage is left out."""
        node = self._config.get(get_kind(kind).name)
        return None if node is None else split_config(kind, node)[0]

    @overload
    def get(self, kind: Literal["feature_extractor"]) -> FeatureExtractor: ...
    @overload
    def get(self, kind: Literal["segmenter"]) -> Segmenter: ...
    @overload
    def get(self, kind: Literal["grasp_generator"]) -> GraspGenerator: ...
    @overload
    def get(self, kind: Literal["policy"]) -> Policy: ...
    @overload
    def get(self, kind: Literal["simulator"]) -> Simulator: ...
    @overload
    def get(self, kind: Literal["robot"]) -> Robot: ...
    @overload
    def get(self, kind: Literal["objects"]) -> ObjectSet: ...
    @overload
    def get(self, kind: Literal["dataset"]) -> Dataset: ...
    @overload
    def get(self, kind: Literal["online_head"]) -> Callable[[], OnlineHead]: ...
    @overload
    def get(self, kind: str) -> Any: ...
    def get(self, kind: str) -> Any:
        """Return the run's instance of a kind, or the factory of a kind that is passed as one.

        Raises:
            ConfigError: The kind is not chosen, something it needs is not, or two plugins need each other.
            PluginError: A plugin cannot be imported or constructed.
        """
        if kind not in self._built:
            self._built[kind] = self.fresh(kind)
        return self._built[kind]

    def fresh(self, kind: str) -> Any:
        """Build another instance, sharing what it is composed of; vector environments need several simulators."""
        if kind in self._under_way:
            raise ConfigError(f"plugins need each other in a circle: {' -> '.join((*self._under_way, kind))}")
        name, parameters = split_config(kind, self._config.get(get_kind(kind).name))
        self._under_way.append(kind)
        try:
            dependencies = {
                parameter.name: self.get(parameter.name)
                for parameter in signature(kind, name, load(kind, name)).dependencies.values()
                if self._wanted(parameter.name, parameter.required)
            }
        finally:
            self._under_way.pop()
        make = factory if get_kind(kind).passed_as_factory else build
        return make(kind, {"plugin": name, **parameters}, **dependencies)

    def _wanted(self, name: str, required: bool) -> bool:
        """Whether a dependency is built here: objects that are no plugins are not, optional plugins when chosen."""
        return name in KINDS and (required or self._config.get(name) is not None)

    def close(self) -> None:
        """Close the simulator, if one was built."""
        if "simulator" in self._built:
            self._built.pop("simulator").close()
