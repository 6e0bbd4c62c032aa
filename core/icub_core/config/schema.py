"""A plugin's constructor signature is the schema of its configuration.

Parameters that are named like a plugin kind, or whose type is an abstract class or a callable, are dependencies: they
are passed as objects and never appear in a configuration.
"""

from __future__ import annotations

import builtins
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

from icub_core.bounds import Bounds
from icub_core.errors import ConfigError, PluginError, suggestion
from icub_core.kinds import KINDS

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
        """Return True if a value must be given."""
        return self.default is inspect.Parameter.empty


@dataclass(frozen=True)
class Signature:
    """A constructor split into what a configuration holds and what the composition passes."""

    parameters: Mapping[str, Parameter]
    dependencies: Mapping[str, Parameter]


def _read_signature(kind: str, name: str, cls: type) -> Signature:
    """Read the constructor of a plugin; raises PluginError for a type that a configuration cannot hold."""
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
        unnamed = parameter.annotation is Any or not _is_data(parameter.annotation)  # a list of names is a setting
        if (argument.name in KINDS and unnamed) or _is_dependency(parameter.annotation):
            dependencies[argument.name] = parameter
        elif _is_data(parameter.annotation):
            parameters[argument.name] = parameter
        else:
            raise PluginError(
                f"the parameter '{argument.name}' of {kind} '{name}' has type {type_name(parameter.annotation)}, which "
                "no configuration can hold; expected bool, int, float, str, Path, Enum, or list, tuple, dict of these"
            )
    return Signature(parameters, dependencies)


signature: Callable[[str, str, type], Signature] = functools.cache(_read_signature)
"""Read the constructor of a plugin once; see `_read_signature`."""


def _make_node_type(kind: str, name: str, cls: type) -> type:
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


node_type: Callable[[str, str, type], type] = functools.cache(_make_node_type)
"""Return the dataclass of a plugin's parameters, one per plugin; see `_make_node_type`."""


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


def to_plain(node: Any) -> dict[str, Any]:
    """Return a resolved OmegaConf node as plain Python; raises ConfigError for an interpolation that leads nowhere."""
    try:
        return cast(dict[str, Any], OmegaConf.to_container(node, resolve=True))
    except OmegaConfBaseException as cause:
        raise ConfigError(str(cause).splitlines()[0]) from cause


def restore(value: Any, annotation: Any) -> Any:
    """Return a plain value as the annotation's type: tuples, dataclasses, floats; choices and bounds are checked.

    Raises:
        TypeError: The value does not fit; the message says why, or is empty where the type alone explains it.
    """
    choices = _alternatives(annotation)
    if len(choices) > 1 or annotation is Any or (value is None and choices[0] is not annotation):
        return value
    only = choices[0]
    if typing.get_origin(only) is typing.Annotated:
        inner, *notes = typing.get_args(only)
        value = restore(value, inner)
        for note in notes:
            if isinstance(note, Bounds):
                note.check(value)
        return value
    if typing.get_origin(only) is typing.Literal:
        if value not in typing.get_args(only):
            raise TypeError(unknown_choice(value, typing.get_args(only)))
        return value
    if dataclasses.is_dataclass(only):
        if dataclasses.is_dataclass(value):
            return value
        hints = typing.get_type_hints(only, include_extras=True)
        return only(**{key: _restore_field(key, member, hints[key]) for key, member in value.items()})  # type: ignore[operator]
    members = typing.get_args(only)
    sort = typing.get_origin(only) or only
    if sort not in (tuple, list):
        return _restore_scalar(value, only)
    if not isinstance(value, (list, tuple)):
        raise TypeError
    if sort is tuple and members and Ellipsis not in members:
        if len(members) != len(value):
            raise TypeError
        return tuple(restore(v, m) for v, m in zip(value, members, strict=True))
    return sort(restore(v, members[0]) if members else v for v in value)


class UnfitError(TypeError):
    """A field of a dataclass has a value that does not fit.

    Attributes:
        path: Names of fields that lead to it, with dots.
        value: What was given.
        annotation: What was expected.
    """

    def __init__(self, path: str, value: Any, annotation: Any, why: str) -> None:
        super().__init__(why)
        self.path, self.value, self.annotation = path, value, annotation


def _restore_field(key: str, value: Any, annotation: Any) -> Any:
    try:
        return restore(value, annotation)
    except UnfitError as inner:
        raise UnfitError(f"{key}.{inner.path}", inner.value, inner.annotation, str(inner)) from inner
    except TypeError as why:
        raise UnfitError(key, value, annotation, str(why)) from why


def unknown_choice(value: Any, known: tuple[Any, ...]) -> str:
    """Return what is wrong with a value that is none of the choices."""
    return f"expected one of {', '.join(map(str, known))}.{suggestion(str(value), map(str, known))}"


def type_name(annotation: Any) -> str:
    """Return an annotation as a reader would write it."""
    if annotation is type(None):
        return "None"
    if typing.get_origin(annotation) is typing.Annotated:
        inner, *notes = typing.get_args(annotation)
        return " ".join([type_name(inner), *(str(note) for note in notes if isinstance(note, Bounds))])
    if typing.get_origin(annotation) is typing.Literal:
        return f"one of {', '.join(map(str, typing.get_args(annotation)))}"
    if isinstance(annotation, type) and not typing.get_args(annotation):
        members = f" ({', '.join(annotation.__members__)})" if issubclass(annotation, Enum) else ""
        return annotation.__name__ + members
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return " | ".join(type_name(a) for a in typing.get_args(annotation))
    return str(annotation).replace("typing.", "").replace("collections.abc.", "")


class _Scope(dict[str, Any]):
    """Names of a constructor's module; one that is imported only for type checkers marks an object, not a setting."""

    def __init__(self, known: Mapping[str, Any]) -> None:
        super().__init__()
        self._known = known

    def __missing__(self, name: str) -> Any:
        if name in self._known or hasattr(builtins, name):
            raise KeyError(name)  # found by the lookup that follows
        return Callable


def _hints(constructor: Callable[..., None]) -> dict[str, Any]:
    scope = getattr(constructor, "__globals__", {})
    return typing.get_type_hints(constructor, localns=_Scope(scope), include_extras=True)


def _alternatives(annotation: Any) -> tuple[Any, ...]:
    """Return the members of a union without None; one element for anything else."""
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return tuple(a for a in typing.get_args(annotation) if a is not type(None))
    return (annotation,)


def is_factory(annotation: Any) -> bool:
    """Return True if a dependency is asked for as a zero-argument factory of instances."""
    return any(a is Callable or typing.get_origin(a) is Callable for a in _alternatives(annotation))


def _is_dependency(annotation: Any) -> bool:
    return all(
        a is Callable or typing.get_origin(a) is Callable or (isinstance(a, type) and inspect.isabstract(a))
        for a in _alternatives(annotation)
    )


def _bare(annotation: Any) -> Any:
    """Return the type behind `Annotated` and `Literal`."""
    if typing.get_origin(annotation) is typing.Annotated:
        return _bare(typing.get_args(annotation)[0])
    if typing.get_origin(annotation) is typing.Literal:
        kinds = {type(choice) for choice in typing.get_args(annotation)}
        return kinds.pop() if len(kinds) == 1 else Any
    return annotation


def _is_data(annotation: Any) -> bool:
    annotation = _bare(annotation)
    if annotation is Any or annotation is inspect.Parameter.empty:
        return True
    choices = tuple(_bare(choice) for choice in _alternatives(annotation))
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
    if len(choices) > 1:
        return annotation
    bare, optional = _bare(choices[0]), choices[0] is not annotation
    if dataclasses.is_dataclass(bare):
        bare = _omegaconf_class(bare)
    elif (typing.get_origin(bare) or bare) in (tuple, list):
        bare = list[Any]
    return bare | None if optional else bare


def _make_omegaconf_class(cls: Any) -> type:
    """Return a dataclass like `cls` whose annotations OmegaConf understands."""
    hints = typing.get_type_hints(cls, include_extras=True)
    fields: list[tuple[str, Any, Any]] = []
    for item in dataclasses.fields(cls):
        value = MISSING if item.default is dataclasses.MISSING else item.default
        if item.default_factory is not dataclasses.MISSING:
            value = item.default_factory()
        fields.append((item.name, _for_omegaconf(hints[item.name]), _field(value)))
    made = make_dataclass(cls.__name__, fields)
    made.__module__ = cls.__module__
    return made


_omegaconf_class: Callable[[Any], type] = functools.cache(_make_omegaconf_class)


def _field(value: Any) -> Any:
    """Return a dataclass field with a default, also a mutable one."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return field(default_factory=functools.partial(_for_node, value))
    if isinstance(value, tuple):
        value = list(value)
    if isinstance(value, (list, dict)):
        return field(default_factory=functools.partial(_copy, value))
    return field(default=value)


def _for_node(value: Any) -> Any:
    cls = _omegaconf_class(type(value))
    values = {item.name: getattr(value, item.name) for item in dataclasses.fields(value)}
    return cls(
        **{
            key: _for_node(v) if dataclasses.is_dataclass(v) else (list(v) if isinstance(v, tuple) else v)
            for key, v in values.items()
        }
    )


def _restore_scalar(value: Any, only: Any) -> Any:
    if only is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if only in SCALARS and (not isinstance(value, only) or (only is int and isinstance(value, bool))):
        raise TypeError
    return value


def _copy(value: Any) -> Any:
    return list(value) if isinstance(value, list) else dict(value)
