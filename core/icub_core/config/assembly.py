"""Builds the plugins of a composed configuration, each once, in the order in which they need one another."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any

from icub_core.config.schema import is_factory, signature
from icub_core.config.settings import build_scene
from icub_core.construct import build, factory, split_config
from icub_core.errors import ConfigError
from icub_core.interfaces.abilities import Closable
from icub_core.kinds import KINDS, get_kind
from icub_core.registry import load

SCENE = "scene"
"""Name of the constructor parameter that receives a function from objects to the run's `Scene`."""


class Assembly:
    """The plugins of one run.

        plugins = Assembly(compose(["segmenter=falkon", "policy=resprect"]))
        segmenter = plugins.get("segmenter")   # builds its feature extractor first

    A constructor's parameter that is named like a kind receives the run's instance of that kind; where it is annotated
    as a Callable it receives a zero-argument factory of fresh instances.
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
        """Return the name of the plugin of this kind, or None when it is left out."""
        node = self._config.get(get_kind(kind).name)
        return None if node is None else split_config(kind, node)[0]

    def choose(self, kind: str, name: str) -> None:
        """Choose a plugin, with its defaults, for a kind that the configuration leaves out."""
        self._config = {str(key): self._config.get(key) for key in self._config} | {kind: {"plugin": name}}

    def takes(self, kind: str) -> dict[str, Any]:
        """Return what the constructor of the chosen plugin of a kind takes: name to default."""
        name, _ = split_config(kind, self._config.get(get_kind(kind).name))
        wanted = signature(kind, name, load(kind, name))
        return {key: parameter.default for key, parameter in {**wanted.parameters, **wanted.dependencies}.items()}

    def get(self, kind: str) -> Any:
        """Return the run's instance of a kind.

        Raises:
            ConfigError: The kind is not chosen, something it needs is not, or two plugins need each other.
            PluginError: A plugin cannot be imported or constructed.
        """
        if kind not in self._built:
            self._built[kind] = self.fresh(kind)
        return self._built[kind]

    def fresh(self, kind: str, **given: Any) -> Any:
        """Build another instance, sharing what it is composed of.

        Args:
            kind: Name of the kind.
            **given: Parameters and dependencies to use instead of the configuration's.
        """
        name, parameters, dependencies = self._parts(kind, given)
        return build(kind, {"plugin": name, **parameters}, **{**dependencies, **given})

    def factory(self, kind: str, **given: Any) -> Any:
        """Return a zero-argument callable that builds a fresh instance at every call, checked once now."""
        name, parameters, dependencies = self._parts(kind, given)
        return factory(kind, {"plugin": name, **parameters}, **{**dependencies, **given})

    def _parts(self, kind: str, given: Mapping[str, Any]) -> tuple[str, dict[str, Any], dict[str, Any]]:
        if kind in self._under_way:
            raise ConfigError(f"plugins need each other in a circle: {' -> '.join((*self._under_way, kind))}")
        name, parameters = split_config(kind, self._config.get(get_kind(kind).name))
        self._under_way.append(kind)
        try:
            dependencies: dict[str, Any] = {}
            for wanted in signature(kind, name, load(kind, name)).dependencies.values():
                if wanted.name in given:
                    continue
                if wanted.name == SCENE and self._config.get(SCENE) is not None:
                    dependencies[SCENE] = functools.partial(build_scene, self._config[SCENE])
                elif wanted.name in KINDS and (wanted.required or self._config.get(wanted.name) is not None):
                    make = self.factory if is_factory(wanted.annotation) else self.get
                    dependencies[wanted.name] = make(wanted.name)
        finally:
            self._under_way.pop()
        return name, parameters, dependencies

    def close(self) -> None:
        """Close every plugin that was built here and holds something open; one that fails leaves no other open."""
        with ExitStack() as closing:
            for built in self._built.values():
                if isinstance(built, Closable):
                    closing.callback(built.close)
            self._built.clear()
