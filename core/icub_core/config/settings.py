"""Settings that belong to no plugin: the run itself, its scene, and the groups typed by a dataclass of the core."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from icub_core.config.folders import TYPED_GROUPS
from icub_core.errors import ConfigError

if TYPE_CHECKING:
    from icub_core.scene import ObjectSpec, Scene


@dataclass
class RunSettings:
    """Top-level keys of a run.

    Attributes:
        seed: Of everything that is drawn at random; plugins with a parameter `seed` follow it.
        device: Torch device; plugins with a parameter `device` follow it.
        run_dir: Folder of the run, relative to where the command is typed.
    """

    seed: int = 0
    device: str = "cpu"
    run_dir: str = ""


@dataclass
class SceneSettings:
    """The room: table and physics step.

    Attributes:
        timestep: Physics step, seconds.
        table_center: World position of the middle of the table's box, meters.
        table_half_size: Half extents of that box, meters.
    """

    timestep: float = 0.005
    table_center: tuple[float, float, float] = (-0.68, 0.0, 0.9)
    table_half_size: tuple[float, float, float] = (0.5, 1.0, 0.05)


def build_scene(settings: DictConfig, objects: Sequence[ObjectSpec]) -> Scene:
    """Return the scene that the group `scene` describes, with `objects` that may appear in it."""
    from icub_core.scene import Scene, Table

    values = cast(SceneSettings, to_dataclass(settings))
    table = Table(center=values.table_center, half_size=values.table_half_size)
    return Scene(objects=tuple(objects), table=table, timestep=values.timestep)


def to_dataclass(node: DictConfig) -> Any:
    """Return the dataclass instance that a node of a typed group stands for; lists become tuples where it says so."""
    try:
        OmegaConf.resolve(node)
        found = OmegaConf.to_object(node)
    except OmegaConfBaseException as cause:
        raise ConfigError(str(cause).splitlines()[0]) from cause
    if not dataclasses.is_dataclass(found) or isinstance(found, type):
        raise ConfigError(
            f"the node {node} is not typed; expected a group among {sorted({g for g, _ in TYPED_GROUPS})}"
        )
    return _with_tuples(found)


def _with_tuples(found: Any) -> Any:
    """Turn the lists that OmegaConf gives into tuples where the dataclass, or one inside it, says tuple."""
    changed = {}
    for field in dataclasses.fields(found):
        value = getattr(found, field.name)
        if dataclasses.is_dataclass(value):
            changed[field.name] = _with_tuples(value)
        elif isinstance(value, list) and str(field.type).startswith("tuple"):
            changed[field.name] = tuple(value)
    return dataclasses.replace(found, **changed)


def typed_group_node(group: str, option: str) -> DictConfig | None:
    """Return the typed node of ``group=option``, or None when no dataclass describes it."""
    target = TYPED_GROUPS.get((group, option))
    if target is None:
        return None
    module, _, name = target.partition(":")
    node = cast(DictConfig, OmegaConf.structured(getattr(importlib.import_module(module), name)))
    OmegaConf.set_readonly(node, False)  # the dataclass may be frozen; its configuration is not
    return node


def check_run_settings(config: DictConfig) -> None:
    """Refuse a top-level value of the wrong type; raises ConfigError."""
    node = OmegaConf.structured(RunSettings)
    for field in dataclasses.fields(RunSettings):
        value = config.get(field.name)
        try:
            node[field.name] = value
        except OmegaConfBaseException as cause:
            raise ConfigError(f"{field.name}={value} has the wrong type; expected {field.type}") from cause


def check_device(config: DictConfig) -> None:
    """Refuse a device that torch does not know or that this machine lacks; raises ConfigError."""
    if config.device == "cpu":
        return
    import torch

    try:
        torch.zeros(1, device=config.device)
    except (RuntimeError, AssertionError) as cause:  # torch without CUDA asserts
        reason = str(cause).splitlines()[0]
        raise ConfigError(f"device={config.device} cannot be used: {reason}; device=cpu always can") from cause
