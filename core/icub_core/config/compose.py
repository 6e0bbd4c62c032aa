"""Composes the configuration of a run from overrides, for the command line and as a library.

from icub_core.config.compose import compose
cfg = compose(["segmenter=falkon", "policy=resprect", "seed=3"])
"""

from __future__ import annotations

import functools
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from icub_core.config.folders import config_folders, groups
from icub_core.config.overrides import rewrite
from icub_core.config.schema import signature
from icub_core.config.settings import check_run_settings
from icub_core.config.sources import register
from icub_core.construct import checked_parameters, missing_dependency, split_config, unknown_parameter, wrong_type
from icub_core.errors import ConfigError, suggestion
from icub_core.kinds import KINDS
from icub_core.registry import load, one_line
from icub_core.renames import new_name, renamed_parameters

VERSION_BASE = "1.3"
PRIMARY = "config"
LATE = "task"
"""A task is built by the stage that acts in it; a run without such a stage may leave its parts out."""


def compose(
    overrides: Sequence[str] = (),
    config_dir: Path | None = None,
    *,
    with_hydra: bool = False,
    read: Collection[str] = (),
) -> DictConfig:
    """Compose and check the configuration of a run.

    Args:
        overrides: As typed after ``icub run``.
        config_dir: Another folder to search, as ``--config-dir``.
        with_hydra: Keep Hydra's own node, for a run folder and its log.
        read: Kinds whose plugins the caller itself uses; others that no plugin of the run asks for are refused.

    Raises:
        ConfigError: An unknown name, a wrong type or a plugin that another one needs and that is not chosen.
        PluginError: A chosen plugin that cannot be imported.
    """
    register()
    rewritten = rewrite(overrides, *vocabulary(config_dir))
    if config_dir is not None:
        rewritten.append(f"hydra.searchpath=[file://{Path(config_dir).resolve()}]")
    with (
        one_line_errors(),
        hydra.initialize_config_dir(version_base=VERSION_BASE, config_dir=str(config_folders()[0]), job_name="icub"),
    ):
        config = _composed(rewritten, with_hydra)
        check(config, read)
        return config


def _composed(overrides: list[str], with_hydra: bool) -> DictConfig:
    """Compose; overrides by old names of parameters are replaced, with a warning."""
    try:
        return hydra.compose(PRIMARY, overrides=overrides, return_hydra_config=with_hydra)
    except (HydraException, OmegaConfBaseException) as error:
        current = with_new_names(overrides, error)
        if current is None:
            raise
        return _composed(current, with_hydra)


def with_new_names(overrides: Sequence[str], error: BaseException) -> list[str] | None:
    """Return overrides in which the key that Hydra refused stands by its new name; None if it is no old name."""
    cause = error if isinstance(error, OmegaConfBaseException) else error.__cause__
    if not isinstance(cause, OmegaConfBaseException) or not cause.full_key:
        return None
    kind, _, key = str(cause.full_key).partition(".")
    parent = cause.parent_node
    if kind not in KINDS or not isinstance(parent, DictConfig) or "plugin" not in parent:
        return None
    cls = load(kind, str(parent["plugin"]))
    if new_name(cls, key) is None:
        return None
    (new,) = renamed_parameters(cls, {key: None})
    return [f"{kind}.{new}={o.partition('=')[2]}" if o.partition("=")[0] == f"{kind}.{key}" else o for o in overrides]


def vocabulary(config_dir: Path | None = None) -> tuple[Mapping[str, tuple[str, ...]], tuple[str, ...]]:
    """Return the known groups with their options, and the other top-level keys."""
    folders = config_folders() + ((Path(config_dir),) if config_dir is not None else ())
    return groups(folders), _settings()


@functools.cache
def _settings() -> tuple[str, ...]:
    primary = OmegaConf.load(config_folders()[0] / f"{PRIMARY}.yaml")
    return tuple(str(key) for key in primary if key not in ("defaults", "hydra", *KINDS))


def check(config: DictConfig, read: Collection[str] = ()) -> None:
    """Refuse what composition alone lets through: wrong settings, added keys, a plugin that is missing or unused."""
    check_run_settings(config)
    asked = set(read)
    for kind in KINDS:
        node = config.get(kind)
        if node is None:
            continue
        name, parameters = split_config(kind, node)
        cls = load(kind, name)
        checked_parameters(kind, name, cls, parameters)
        for dependency in signature(kind, name, cls).dependencies.values():
            asked.add(dependency.name)
            if kind == LATE or not dependency.required or dependency.name not in KINDS:
                continue
            if config.get(dependency.name) is None:
                raise missing_dependency(kind, name, dependency.name)
    # the stages of a run see the simulated world, so recorded data would be ignored
    for kind, what in (("dataset", "data set"), ("episodes", "recorded episode")):
        if config.get(kind) is not None and kind not in asked:
            name, _ = split_config(kind, config[kind])
            raise ConfigError(
                f"{kind}={name} is set, but nothing in this run reads a {what}; leave it out: "
                f"{what}s are for benchmarks and programs"
            )


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Turn what Hydra and OmegaConf raise into a ConfigError of one line with the nearest valid name."""
    try:
        yield
    except (HydraException, OmegaConfBaseException) as error:
        raise _translated(error) from error


def _translated(error: BaseException) -> ConfigError:
    cause = error if isinstance(error, OmegaConfBaseException) else error.__cause__
    if not isinstance(cause, OmegaConfBaseException) or not cause.full_key:
        first = str(error).strip().splitlines()[0]
        return ConfigError(f"{first}; to sweep over values add -m" if first.startswith("Ambiguous value") else first)
    path = str(cause.full_key)
    group, _, key = path.partition(".")
    parent = cause.parent_node
    if key and group in KINDS and isinstance(parent, DictConfig) and "plugin" in parent:
        name = str(parent["plugin"])
        wanted = signature(group, name, load(group, name))
        if key in wanted.parameters:
            return wrong_type(group, name, wanted.parameters[key], _value(cause))
        return unknown_parameter(group, name, key, wanted)
    if isinstance(parent, DictConfig) and cause.key not in parent:
        if key and group in KINDS and not parent:
            return ConfigError(f"{path} is set, but no {group} is chosen; add {group}=NAME")
        known = [str(k) for k in parent if k != "hydra"]
        name = path.rpartition(".")[0]
        where = f"'{name}'" if name else "the configuration"
        return ConfigError(
            f"{where} has no key '{cause.key}'.{suggestion(str(cause.key), known)} Known: {', '.join(known) or 'none'}"
        )
    return ConfigError(f"{path}: {one_line(cause).partition(': ')[2]}")


def _value(cause: OmegaConfBaseException) -> str:
    """Return the refused value as OmegaConf quotes it."""
    quoted = str(cause).split("'")
    return quoted[1] if len(quoted) > 1 else "?"
