"""Finds plugins by entry point and loads the one that is chosen.

Finding reads the metadata of installed distributions and imports nothing; a plugin's code is imported when `load` is
called for it. A third party needs one entry-point line in its own pyproject::

    [project.entry-points."icub.segmenter"]
    depth_blob = "my_package.depth_blob:DepthBlob"
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, Literal, overload

from icub_core.errors import ConfigError, IcubError, PluginError, unknown_name
from icub_core.kinds import KINDS, Kind, get_kind

if TYPE_CHECKING:
    from icub_core.interfaces.dataset import Dataset
    from icub_core.interfaces.feature_extractor import FeatureExtractor
    from icub_core.interfaces.grasp_generator import GraspGenerator
    from icub_core.interfaces.object_set import ObjectSet
    from icub_core.interfaces.online_head import OnlineHead
    from icub_core.interfaces.policy import Policy
    from icub_core.interfaces.robot import Robot
    from icub_core.interfaces.segmenter import Segmenter
    from icub_core.interfaces.simulator import Simulator

Config = str | Mapping[str, Any]
"""A registry name, or a mapping with the key ``plugin`` and the constructor's parameters."""


@dataclass(frozen=True)
class PluginInfo:
    """What is known about a plugin without importing it.

    Attributes:
        kind: Name of its kind.
        name: Registry name.
        target: ``module:Class``.
        distribution: Name and version of the distribution that announces it.
        baselines: Other distributions that announce the same name with another target; such a name cannot be loaded.
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


@overload
def load(kind: Literal["feature_extractor"], name: str) -> type[FeatureExtractor]: ...
@overload
def load(kind: Literal["online_head"], name: str) -> type[OnlineHead]: ...
@overload
def load(kind: Literal["segmenter"], name: str) -> type[Segmenter]: ...
@overload
def load(kind: Literal["grasp_generator"], name: str) -> type[GraspGenerator]: ...
@overload
def load(kind: Literal["policy"], name: str) -> type[Policy]: ...
@overload
def load(kind: Literal["simulator"], name: str) -> type[Simulator]: ...
@overload
def load(kind: Literal["robot"], name: str) -> type[Robot]: ...
@overload
def load(kind: Literal["objects"], name: str) -> type[ObjectSet]: ...
@overload
def load(kind: Literal["dataset"], name: str) -> type[Dataset]: ...
@overload
def load(kind: str, name: str) -> type[Any]: ...
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
        raise PluginError(f"{origin} cannot be imported: {one_line(cause)}") from cause
    base = interface(kind)
    if not (isinstance(target, type) and issubclass(target, base)):
        raise PluginError(f"{origin} is not a subclass of {base.__module__}.{base.__name__}")
    return target


@overload
def build(kind: Literal["feature_extractor"], config: Config, **dependencies: Any) -> FeatureExtractor: ...
@overload
def build(kind: Literal["online_head"], config: Config, **dependencies: Any) -> OnlineHead: ...
@overload
def build(kind: Literal["segmenter"], config: Config, **dependencies: Any) -> Segmenter: ...
@overload
def build(kind: Literal["grasp_generator"], config: Config, **dependencies: Any) -> GraspGenerator: ...
@overload
def build(kind: Literal["policy"], config: Config, **dependencies: Any) -> Policy: ...
@overload
def build(kind: Literal["simulator"], config: Config, **dependencies: Any) -> Simulator: ...
@overload
def build(kind: Literal["robot"], config: Config, **dependencies: Any) -> Robot: ...
@overload
def build(kind: Literal["objects"], config: Config, **dependencies: Any) -> ObjectSet: ...
@overload
def build(kind: Literal["dataset"], config: Config, **dependencies: Any) -> Dataset: ...
@overload
def build(kind: str, config: Config, **dependencies: Any) -> Any: ...
def build(kind: str, config: Config, **dependencies: Any) -> Any:
    """Construct a plugin with checked parameters.

    Args:
        kind: Name of the kind.
        config: A registry name, or a mapping with the key ``plugin`` and the constructor's parameters (a node of the
            composed configuration).
        **dependencies: Built plugins and other objects that the constructor asks for, such as ``feature_extractor=fx``;
            a kind that is passed as a factory takes a zero-argument callable (see `factory`). Names of ordinary
            parameters are accepted too and override `config`.

    Raises:
        PluginError: See `load`; also when the constructor itself fails for a reason it does not explain.
        ConfigError: An unknown parameter, a value of the wrong type, a missing parameter or dependency.
    """
    name, parameters = split_config(kind, config)
    cls = load(kind, name)
    from icub_core.config.schema import constructor_arguments

    arguments = constructor_arguments(kind, name, cls, parameters, dependencies)
    try:
        return cls(**arguments)
    except IcubError:
        raise
    except Exception as cause:
        raise PluginError(f"the {kind} plugin '{name}' cannot be constructed: {one_line(cause)}") from cause


def factory(kind: str, config: Config, **dependencies: Any) -> Callable[[], Any]:
    """Return a zero-argument callable that builds a fresh instance at every call, checked once now.

    Raises: As `build`, now rather than at the first call.
    """
    name, parameters = split_config(kind, config)
    cls = load(kind, name)
    from icub_core.config.schema import constructor_arguments

    constructor_arguments(kind, name, cls, parameters, dependencies)
    return functools.partial(build, kind, {"plugin": name, **parameters}, **dependencies)


def split_config(kind: str, config: Config | None) -> tuple[str, dict[str, Any]]:
    """Split a node into the registry name and plain, resolved parameters; raises ConfigError without a name."""
    get_kind(kind)
    if isinstance(config, str):
        return config, {}
    if config is None:
        raise ConfigError(f"no {kind} is chosen; add {kind}=NAME. Known: {', '.join(available(kind)) or 'none'}")
    if hasattr(
        config, "_get_root"
    ):  # an OmegaConf node: interpolations need its parents, so resolve them before it is cut off
        from icub_core.config.schema import to_plain

        config = to_plain(config)
    parameters = dict(config)
    name = parameters.pop("plugin", None)
    if not isinstance(name, str):
        raise ConfigError(
            f"a {kind} configuration has plugin={name!r}; expected a name. Known: {', '.join(available(kind))}"
        )
    return name, parameters


def one_line(cause: BaseException) -> str:
    """Return ``Type: first line`` of an exception."""
    lines = str(cause).strip().splitlines()
    return f"{type(cause).__name__}: {lines[0]}" if lines else type(cause).__name__


def kinds() -> tuple[Kind, ...]:
    """Return every kind in the order of a run's composition."""
    return tuple(KINDS.values())
