"""Finds plugins by entry point and loads the one that is chosen.

Finding reads the metadata of installed distributions and imports nothing; a plugin's code is imported when `load` is
called for it. A third party needs one entry-point line in its own pyproject::

    [project.entry-points."icub.segmenter"]
    depth_blob = "my_package.depth_blob:DepthBlob"
"""

from __future__ import annotations

import functools
import importlib
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from icub_core.errors import PluginError, unknown_name
from icub_core.kinds import KINDS, get_kind


@dataclass(frozen=True)
class PluginInfo:
    """What is known about a plugin without importing it.

    Attributes:
        kind: Name of its kind.
        name: Registry name.
        target: ``module:Class``.
        distribution: Name and version of the distribution that announces it.
        conflicts: Other distributions that announce the same name with another target; such a name cannot be loaded.
    """

    kind: str
    name: str
    target: str
    distribution: str
    conflicts: tuple[str, ...] = ()


def _distribution(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an unknown distribution"


@functools.cache
def _scan() -> dict[str, dict[str, PluginInfo]]:
    """Read the entry points of every kind once a process."""
    found: dict[str, dict[str, PluginInfo]] = {}
    everything = entry_points()
    for kind in KINDS.values():
        by_name: dict[str, PluginInfo] = {}
        for entry in sorted(everything.select(group=kind.entry_point_group), key=lambda e: (e.name, e.value)):
            first = by_name.get(entry.name)
            if first is None:
                by_name[entry.name] = PluginInfo(kind.name, entry.name, entry.value, _distribution(entry))
            elif first.target != entry.value or first.distribution != _distribution(entry):
                conflicts = (*first.conflicts, _distribution(entry))
                by_name[entry.name] = PluginInfo(kind.name, first.name, first.target, first.distribution, conflicts)
        found[kind.name] = by_name
    return found


def rescan() -> None:
    """Forget what was found, so that distributions installed since then are seen."""
    _scan.cache_clear()


def available(kind: str) -> dict[str, PluginInfo]:
    """Return the plugins of `kind` by name, sorted, without importing any of them."""
    return dict(_scan()[get_kind(kind).name])


def info(kind: str, name: str) -> PluginInfo:
    """Return what is known about one plugin; raises PluginError with the nearest valid name."""
    known = available(kind)
    if name not in known:
        raise PluginError(unknown_name(f"{kind} plugin", name, known))
    return known[name]


def interface(kind: str) -> type:
    """Import and return the abstract base class of `kind`."""
    module, _, cls = get_kind(kind).interface.partition(":")
    found: type = getattr(importlib.import_module(module), cls)
    return found


def load(kind: str, name: str) -> type[Any]:
    """Import a plugin's class.

    Raises:
        PluginError: No such kind or name; two distributions announce the name; the import fails; the target is not a
            class of its kind.
    """
    plugin = info(kind, name)
    if plugin.conflicts:
        owners = ", ".join((plugin.distribution, *plugin.conflicts))
        raise PluginError(
            f"the {kind} name '{name}' is announced by more than one distribution: {owners}; uninstall all but one"
        )
    origin = f"the {kind} plugin '{name}' ({plugin.target}, from {plugin.distribution})"
    try:
        target = EntryPoint(name=name, value=plugin.target, group=KINDS[kind].entry_point_group).load()
    except (Exception, SystemExit) as cause:
        version = KINDS[kind].version
        raise PluginError(
            f"{origin} cannot be imported: {one_line(cause)} (here the interface '{kind}' has version {version})"
        ) from cause
    base = interface(kind)
    if not (isinstance(target, type) and issubclass(target, base)):
        raise PluginError(f"{origin} is not a subclass of {base.__module__}.{base.__name__}")
    return target


def one_line(cause: BaseException) -> str:
    """Return ``Type: first line`` of an exception."""
    lines = str(cause).strip().splitlines()
    return f"{type(cause).__name__}: {lines[0]}" if lines else type(cause).__name__
