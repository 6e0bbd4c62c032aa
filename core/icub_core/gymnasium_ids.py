"""Gymnasium's ids of tasks: a distribution announces them by entry points of the group ``icub.gymnasium``.

The entry point's name is the id, its value what makes the environment::

    [project.entry-points."icub.gymnasium"]
    "icub/Grasp-v0" = "icub_tasks.grasping.gym:make"

``import icub_core`` registers them, at once or as soon as Gymnasium is imported; it never imports Gymnasium itself.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.metadata import entry_points
from importlib.util import find_spec
from types import ModuleType

ENTRY_POINT_GROUP = "icub.gymnasium"
AWAITED = "gymnasium.envs"
"""The package whose import completes Gymnasium's registry."""


def register() -> None:
    """Register every id that is not known yet, now or when Gymnasium is imported."""
    if AWAITED in sys.modules:
        _register()
    elif not any(isinstance(finder, _Awaiting) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Awaiting())


def _register() -> None:
    registration = sys.modules["gymnasium.envs.registration"]
    for entry in entry_points(group=ENTRY_POINT_GROUP):
        if entry.name not in registration.registry:
            registration.register(id=entry.name, entry_point=entry.value)


class _Awaiting(MetaPathFinder):
    """Lets the ordinary finders find `AWAITED`, and registers once it is loaded."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the ordinary spec of `AWAITED` with a loader that registers afterwards; None for anything else."""
        if fullname != AWAITED:
            return None
        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is not None and spec.loader is not None:
            spec.loader = _ThenRegister(spec.loader)
        return spec


class _ThenRegister(Loader):
    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        self._loader.exec_module(module)
        _register()
