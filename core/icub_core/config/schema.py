"""A plugin's constructor signature is the schema of its configuration.

Parameters that are named like a plugin kind, or whose type is an abstract class or a callable, are dependencies: they
are passed as objects and never appear in a configuration.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, make_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, cast

from omegaconf import MISSING, DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from icub_core.errors import ConfigError, PluginError, suggestion
from icub_core.kinds import KINDS
from icub_core.registry import available
from icub_core.renames import renamed_parameters

SCALARS = (bool, int, float, str, Path)
RUN_SETTINGS = ("seed", "device")
"""Parameters that follow the run's setting of the same name unless the plugin's own node sets them."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a plugin's constructor; `default` is `inspect.Parameter.empty` when it must be given."""

    name: str
    annotation: Any
    default: Any

    @property
    def required(self) -> bool:
        """Whether a value must be given."""
        return self.default is inspect.Parameter.empty


@dataclass(frozen=True)
class Signature:
    """A constructor split into what a configuration holds and what the composition passes."""

    parameters: Mapping[str, Parameter]
    dependencies: Mapping[str, Parameter]


def signature(kind: str, name: str, cls: type) -> Signature:
    """Read the constructor of a plugin; raises PluginError for a type that a configuration cannot hold."""
    return _signature(kind, name, cls)


@functools.cache
def _signature(kind: str, name: str, cls: type) -> Signature:
    # what stands behind decorators, such as `renamed`, has the annotations' own scope
    constructor = inspect.unwrap(cast(Callable[..., None], cls.__init__))  # type: ignore[misc]
    if constructor is object.__init__:
        return Signature({}, {})
    hints = _hints(constructor)
    parameters: dict[str, Parameter] = {}
    dependencies: dict[str, Parameter] = {}
    for argument in list(inspect.signature(constructor).parameters.values())[1:]:
        if argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD, argument.POSITIONAL_ONLY):
            raise PluginError(
                f"the constructor of {kind} '{name}' takes '{argument}'; expected named parameters only, "
                "since its signature is its configuration"
            )
        parameter = Parameter(argument.name, hints.get(argument.name, Any), argument.default)
        if argument.name in KINDS or _is_dependency(parameter.annotation):
            dependencies[argument.name] = parameter
        elif _is_data(parameter.annotation):
            parameters[argument.name] = parameter
        else:
            raise PluginError(
                f"the parameter '{argument.name}' of {kind} '{name}' has type {type_name(parameter.annotation)}, which "
                "no configuration can hold; expected bool, int, float, str, Path, Enum, or list, tuple, dict of these"
            )
    return Signature(parameters, dependencies)


@functools.cache
def node_type(kind: str, name: str, cls: type) -> type:
    """Return the dataclass whose fields are the plugin's parameters, for OmegaConf to check values against."""
    fields: list[tuple[str, Any, Any]] = [("plugin", str, field(default=name))]
    for parameter in signature(kind, name, cls).parameters.values():
        default = MISSING if parameter.required else parameter.default
        fields.append((parameter.name, _for_omegaconf(parameter.annotation), _field(default)))
    made = make_dataclass(cls.__name__, fields)
    made.__module__ = cls.__module__
    try:
        OmegaConf.structured(made)
    except OmegaConfBaseException as cause:
        reason = str(cause).splitlines()[0]
        raise PluginError(f"the defaults of {kind} '{name}' do not fit their own types: {reason}") from cause
    return made


def typed_node(kind: str, name: str, cls: type, *, follow_run: bool = False) -> DictConfig:
    """Return a node with the plugin's defaults, which refuses unknown keys and values of the wrong type.

    Args:
        kind: Name of the kind.
        name: Registry name, written to the key ``plugin``.
        cls: The plugin.
        follow_run: Let the parameters `seed` and `device` follow the run's settings.
    """
    node = cast(DictConfig, OmegaConf.structured(node_type(kind, name, cls)))
    if follow_run:
        for setting in RUN_SETTINGS:
            if setting in signature(kind, name, cls).parameters:
                node[setting] = f"${{{setting}}}"
    return node


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
            if dataclasses.is_dataclass(wanted.parameters[key].annotation):
                node.merge_with({key: dataclasses.asdict(value) if _is_record(value) else value})
            else:
                node[key] = value
        except OmegaConfBaseException as cause:
            raise wrong_type(kind, name, wanted.parameters[key], value) from cause
    missing = [key for key in wanted.parameters if OmegaConf.is_missing(node, key)]
    if missing:
        raise ConfigError(f"{kind} '{name}' needs the parameter '{missing[0]}'; add {kind}.{missing[0]}=VALUE")
    plain = to_plain(node)
    arguments = {}
    for key, parameter in wanted.parameters.items():
        try:
            arguments[key] = _restore(plain[key], parameter.annotation)
        except TypeError as cause:
            raise wrong_type(kind, name, parameter, plain[key]) from cause
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


def wrong_type(kind: str, name: str, parameter: Parameter, value: Any) -> ConfigError:
    """Return the error for a value that is not of the parameter's type."""
    return ConfigError(
        f"{kind}.{parameter.name}={value} (of '{name}') has the wrong type; expected {type_name(parameter.annotation)}"
    )


def to_plain(node: Any) -> dict[str, Any]:
    """Return a resolved OmegaConf node as plain Python; raises ConfigError for an interpolation that leads nowhere."""
    try:
        return cast(dict[str, Any], OmegaConf.to_container(node, resolve=True))
    except OmegaConfBaseException as cause:
        raise ConfigError(str(cause).splitlines()[0]) from cause


def type_name(annotation: Any) -> str:
    """Return an annotation as a reader would write it."""
    if annotation is type(None):
        return "None"
    if isinstance(annotation, type) and not typing.get_args(annotation):
        members = f" ({', '.join(annotation.__members__)})" if issubclass(annotation, Enum) else ""
        return annotation.__name__ + members
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return " | ".join(type_name(a) for a in typing.get_args(annotation))
    return str(annotation).replace("typing.", "").replace("collections.abc.", "")


def _hints(constructor: Callable[..., None]) -> dict[str, Any]:
    """Resolve annotations one by one: a name imported only for type checkers marks an object, not a setting."""
    scope = getattr(constructor, "__globals__", {})
    hints: dict[str, Any] = {}
    for name, annotation in getattr(constructor, "__annotations__", {}).items():
        if isinstance(annotation, str):
            try:
                annotation = eval(
                    annotation, scope
                )  # the same as typing.get_type_hints, which fails for all if one fails
            except NameError:
                annotation = Callable
        hints[name] = annotation
    return hints


def _alternatives(annotation: Any) -> tuple[Any, ...]:
    """Members of a union without None; one element for anything else."""
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return tuple(a for a in typing.get_args(annotation) if a is not type(None))
    return (annotation,)


def _is_dependency(annotation: Any) -> bool:
    return all(
        a is Callable or typing.get_origin(a) is Callable or (isinstance(a, type) and inspect.isabstract(a))
        for a in _alternatives(annotation)
    )


def _is_data(annotation: Any) -> bool:
    if annotation is Any or annotation is inspect.Parameter.empty:
        return True
    choices = _alternatives(annotation)
    if len(choices) > 1:
        return all(choice in SCALARS for choice in choices)
    (only,) = choices
    if only in SCALARS or (isinstance(only, type) and issubclass(only, Enum)) or dataclasses.is_dataclass(only):
        return True
    if only in (list, tuple, dict):
        return True
    if typing.get_origin(only) in (list, tuple, dict):
        return all(a is Ellipsis or _is_data(a) for a in typing.get_args(only))
    return False


def _for_omegaconf(annotation: Any) -> Any:
    """Write sequences as plain lists: OmegaConf refuses nested and variadic tuples; `_restore` checks the members."""
    choices = _alternatives(annotation)
    if dataclasses.is_dataclass(annotation):
        return _omegaconf_class(cast(type, annotation))
    if len(choices) == 1 and (typing.get_origin(choices[0]) or choices[0]) in (tuple, list):
        return list[Any] if choices[0] is annotation else list[Any] | None
    return annotation


def _restore(value: Any, annotation: Any) -> Any:
    """Check the members of a sequence and give tuples back where the signature says so; TypeError for a misfit."""
    choices = _alternatives(annotation)
    if len(choices) > 1 or annotation is Any or (value is None and choices[0] is not annotation):
        return value
    only, members = choices[0], typing.get_args(choices[0])
    if dataclasses.is_dataclass(only):
        hints = typing.get_type_hints(only)
        return only(**{key: _restore(member, hints[key]) for key, member in value.items()})  # type: ignore[operator]
    sort = typing.get_origin(only) or only
    if sort not in (tuple, list):
        return _restore_scalar(value, only)
    if not isinstance(value, (list, tuple)):
        raise TypeError
    if sort is tuple and members and Ellipsis not in members:
        if len(members) != len(value):
            raise TypeError
        return tuple(_restore(v, m) for v, m in zip(value, members, strict=True))
    return sort(_restore(v, members[0]) if members else v for v in value)


@functools.cache
def _omegaconf_class(cls: Any) -> type:
    """Return a dataclass of the same fields that is not frozen: OmegaConf would make its nodes read-only."""
    hints = typing.get_type_hints(cls)
    return make_dataclass(cls.__name__, [(f.name, hints[f.name], _field(f.default)) for f in dataclasses.fields(cls)])


def _field(value: Any) -> Any:
    """Return a dataclass field with a default, also a mutable one."""
    if _is_record(value):
        return field(
            default_factory=functools.partial(_omegaconf_class(cast(type, type(value))), **dataclasses.asdict(value))
        )
    if isinstance(value, (list, dict)):
        return field(default_factory=functools.partial(_copy, value))
    return field(default=value)


def _is_record(value: Any) -> bool:
    return dataclasses.is_dataclass(value) and not isinstance(value, type)


def _restore_scalar(value: Any, only: Any) -> Any:
    if only is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if only in SCALARS and (not isinstance(value, only) or (only is int and isinstance(value, bool))):
        raise TypeError
    return value


def _copy(value: Any) -> Any:
    return list(value) if isinstance(value, list) else dict(value)
