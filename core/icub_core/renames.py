"""Old names of constructor parameters, which are accepted for one release with a warning.

    @renamed(lam="penalty")
    class Ridge(OnlineHead):
        def __init__(self, penalty: float = 1.0) -> None: ...

Then ``Ridge(lam=2.0)`` and the configuration key ``online_head.lam`` mean `penalty`.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from icub_core.errors import ConfigError

Class = TypeVar("Class", bound=type)


def renamed(**names: str) -> Callable[[Class], Class]:
    """Let the constructor of a class, and its configuration, accept parameters by their old names, OLD="NEW"."""

    def mark(cls: Class) -> Class:
        constructor = cls.__init__  # type: ignore[misc]

        @functools.wraps(constructor)
        def with_old_names(self: Any, *arguments: Any, **values: Any) -> None:
            constructor(self, *arguments, **renamed_parameters(cls, values))

        with_old_names.renamed_parameters = names  # type: ignore[attr-defined]
        cls.__init__ = with_old_names  # type: ignore[misc]
        return cls

    return mark


def new_name(cls: type, name: str) -> str | None:
    """Return what a parameter that was called `name` is called now; None if that is no old name."""
    # kept by the constructor, since a subclass with a constructor of its own has other parameters
    names: Mapping[str, str] = getattr(cls.__init__, "renamed_parameters", {})  # type: ignore[misc]
    return names.get(name)


def renamed_parameters(cls: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by their present names; warns of old ones.

    Raises:
        ConfigError: A parameter is given by its old and by its new name.
    """
    current: dict[str, Any] = {}
    for name, value in values.items():
        new = new_name(cls, name)
        if new is None:
            current[name] = value
            continue
        if new in values:
            raise ConfigError(f"'{name}' of {cls.__name__} is the old name of '{new}'; expected only one of them")
        message = f"'{name}' of {cls.__name__} is now called '{new}'; the old name goes with the next release"
        warnings.warn(message, DeprecationWarning, stacklevel=3)
        current[new] = value
    return current
