"""Builds a plugin by itself: what it is composed of is replaced by the tiny plugins."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from icub_core.config.schema import is_factory, signature
from icub_core.construct import build
from icub_core.kinds import KINDS
from icub_core.registry import load
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
        PluginError, ConfigError: As `icub_core.construct.build`.
    """
    wanted = signature(kind, name, load(kind, name)).dependencies
    missing = {key: is_factory(wanted[key].annotation) for key in wanted if key in KINDS and key not in given}

    def make() -> Any:
        dependencies = {key: tiny_class(key) if fresh else _tiny(key) for key, fresh in missing.items()}
        return build(kind, {"plugin": name, **(parameters or {})}, **dependencies, **given)

    return make


def _tiny(kind: str) -> Any:
    return tiny_class(kind)()
