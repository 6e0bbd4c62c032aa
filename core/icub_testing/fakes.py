"""Builds a plugin by itself: what it is composed of is replaced by the tiny plugins."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from icub_core.config.schema import signature
from icub_core.kinds import KINDS, get_kind
from icub_core.registry import build, load
from icub_testing.tiny import tiny_class


def with_tiny_dependencies(
    kind: str, name: str, parameters: Mapping[str, Any] | None = None, **given: Any
) -> Callable[[], Any]:
    """Return a factory of fresh instances of a plugin, for `icub_testing.checks.run_checks`.

    Args:
        kind: Name of the kind.
        name: Registry name.
        parameters: Constructor parameters that differ from the defaults.
        **given: Dependencies to use instead of the tiny ones.

    Raises:
        PluginError, ConfigError: As `icub_core.registry.build`.
    """
    wanted = signature(kind, name, load(kind, name)).dependencies
    missing = [key for key in wanted if key in KINDS and key not in given]

    def make() -> Any:
        dependencies = {key: _tiny(key) for key in missing}
        return build(kind, {"plugin": name, **(parameters or {})}, **dependencies, **given)

    return make


def _tiny(kind: str) -> Any:
    cls = tiny_class(kind)
    return cls if get_kind(kind).passed_as_factory else cls()
