"""Constructs plugins from checked parameters.

`build` makes one plugin from a registry name and parameters; who goes with whom is decided by
`icub_core.config.assembly`, which passes what a plugin is composed of.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from icub_core.config.schema import Parameter, Signature, UnfitError, node_type, restore, signature, to_plain, type_name
from icub_core.errors import ConfigError, IcubError, PluginError, suggestion
from icub_core.kinds import KINDS, get_kind
from icub_core.registry import available, load, one_line
from icub_core.renames import renamed_parameters

Config = str | Mapping[str, Any]
"""A registry name, or a mapping with the key ``plugin`` and the constructor's parameters."""


def build(kind: str, config: Config, **dependencies: Any) -> Any:
    """Construct a plugin with checked parameters.

    Args:
        kind: Name of the kind.
        config: A registry name, or a mapping with the key ``plugin`` and the constructor's parameters (a node of the
            composed configuration).
        **dependencies: Built plugins and other objects that the constructor asks for, such as ``feature_extractor=fx``;
            a parameter that is annotated as a Callable takes a zero-argument factory. Names of ordinary parameters
            are accepted too and override `config`.

    Raises:
        PluginError: See `icub_core.registry.load`; also when the constructor fails for a reason it does not explain.
        ConfigError: An unknown parameter, a value of the wrong type, a missing parameter or dependency.
    """
    name, parameters = split_config(kind, config)
    cls = load(kind, name)
    arguments = constructor_arguments(kind, name, cls, parameters, dependencies)
    try:
        return cls(**arguments)
    except IcubError:
        raise
    except Exception as cause:
        raise PluginError(
            f"the {kind} plugin '{name}' cannot be constructed: {one_line(cause)} (a plugin that was written for an "
            f"earlier version of the interface? '{kind}' has version {get_kind(kind).version} here)"
        ) from cause


def factory(kind: str, config: Config, **dependencies: Any) -> Callable[[], Any]:
    """Return a zero-argument callable that builds a fresh instance at every call, checked once now.

    Raises: As `build`, now rather than at the first call.
    """
    name, parameters = split_config(kind, config)
    constructor_arguments(kind, name, load(kind, name), parameters, dependencies)
    return functools.partial(build, kind, {"plugin": name, **parameters}, **dependencies)


def split_config(kind: str, config: Config | None) -> tuple[str, dict[str, Any]]:
    """Split a node into the registry name and plain, resolved parameters; raises ConfigError without a name."""
    get_kind(kind)
    if isinstance(config, str):
        return config, {}
    if config is None:
        raise ConfigError(f"no {kind} is chosen; add {kind}=NAME. Known: {', '.join(available(kind)) or 'none'}")
    # interpolations of an OmegaConf node need its parents, so they are resolved before it is cut off
    parameters = to_plain(config) if OmegaConf.is_config(config) else dict(config)
    name = parameters.pop("plugin", None)
    if not isinstance(name, str):
        raise ConfigError(
            f"a {kind} configuration has plugin={name!r}; expected a name. Known: {', '.join(available(kind))}"
        )
    return name, parameters


def constructor_arguments(
    kind: str, name: str, cls: type, parameters: Mapping[str, Any], given: Mapping[str, Any]
) -> dict[str, Any]:
    """Check values and objects against a constructor and return its keyword arguments.

    Args:
        kind: Name of the kind.
        name: Registry name.
        cls: The plugin.
        parameters: Values from a configuration.
        given: Dependencies, and values that override `parameters`.

    Raises:
        ConfigError: In one line, with the nearest valid name.
    """
    wanted = signature(kind, name, cls)
    objects = {key: value for key, value in given.items() if key in wanted.dependencies}
    values = {key: value for key, value in given.items() if key not in wanted.dependencies}
    arguments = checked_parameters(kind, name, cls, {**parameters, **values})
    for key, dependency in wanted.dependencies.items():
        if objects.get(key) is None and dependency.required:
            raise missing_dependency(kind, name, key)
    return {**arguments, **objects}


def checked_parameters(kind: str, name: str, cls: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return every parameter of a constructor with its value or default, converted to its type; raises ConfigError."""
    wanted = signature(kind, name, cls)
    node = cast(DictConfig, OmegaConf.structured(node_type(kind, name, cls)))
    for key, value in renamed_parameters(cls, values).items():
        if key not in wanted.parameters:
            raise unknown_parameter(kind, name, key, wanted)
        try:
            if dataclasses.is_dataclass(value) and not isinstance(value, type):
                value = dataclasses.asdict(value)
            OmegaConf.update(node, key, value, merge=isinstance(value, Mapping))
        except OmegaConfBaseException as cause:
            raise wrong_type(kind, name, wanted.parameters[key], value) from cause
    missing = [key for key in wanted.parameters if OmegaConf.is_missing(node, key)]
    if missing:
        raise ConfigError(f"{kind} '{name}' needs the parameter '{missing[0]}'; add {kind}.{missing[0]}=VALUE")
    plain = to_plain(node)
    arguments = {}
    for key, parameter in wanted.parameters.items():
        try:
            arguments[key] = restore(plain[key], parameter.annotation)
        except UnfitError as cause:
            inner = Parameter(f"{key}.{cause.path}", cause.annotation, parameter.default)
            raise wrong_type(kind, name, inner, cause.value, str(cause)) from cause
        except TypeError as cause:
            raise wrong_type(kind, name, parameter, plain[key], str(cause)) from cause
    return arguments


def missing_dependency(kind: str, name: str, key: str) -> ConfigError:
    """Return the error for an object that a plugin needs and that nothing provides."""
    hint = f"; add {key}=NAME. Known: {', '.join(available(key)) or 'none'}" if key in KINDS else ""
    return ConfigError(f"{kind} '{name}' needs {'an' if key[0] in 'aeiou' else 'a'} {key}{hint}")


def unknown_parameter(kind: str, name: str, key: str, wanted: Signature) -> ConfigError:
    """Return the error for a parameter that the plugin does not have."""
    if key in wanted.dependencies:
        return ConfigError(f"'{key}' of {kind} '{name}' is an object, not a setting; choose it with {key}=NAME")
    known = list(wanted.parameters)
    return ConfigError(
        f"{kind} '{name}' has no parameter '{key}'.{suggestion(key, known)} Known: {', '.join(known) or 'none'}"
    )


def wrong_type(kind: str, name: str, parameter: Parameter, value: Any, why: str = "") -> ConfigError:
    """Return the error for a value that is not of the parameter's type, or none of its choices, or out of bounds."""
    why = why or f"has the wrong type; expected {type_name(parameter.annotation)}"
    return ConfigError(f"{kind}.{parameter.name}={value} (of '{name}') {why}")
