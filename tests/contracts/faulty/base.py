"""Collects the faulty plugins, and makes the two faults that every kind can have."""

from typing import Any

from icub_core.kinds import KINDS
from icub_testing.tiny import tiny_class

FAULTY: dict[tuple[str, str], type] = {}


def breaks(kind: str, check: str) -> Any:
    """Mark a class as the plugin of `kind` that fails `check`, and no other."""

    def mark(cls: type) -> type:
        assert (kind, check) not in FAULTY, "one faulty plugin a check"
        FAULTY[kind, check] = cls
        return cls

    return mark


def _duck(kind: str) -> type:
    """Behaves like its kind in every respect, but is no subclass."""

    class Duck:
        def __init__(self) -> None:
            self._plugin = tiny_class(kind)()

        def __getattr__(self, name: str) -> Any:
            return getattr(self._plugin, name)

        def __len__(self) -> int:
            return len(self._plugin)

        def __getitem__(self, index: int) -> Any:
            return self._plugin[index]

        def __iter__(self) -> Any:
            return iter(self._plugin)

    return Duck


def _unconfigurable(kind: str) -> type:
    """Takes arguments that no configuration can name."""

    class Unconfigurable(tiny_class(kind)):  # type: ignore[misc]
        def __init__(self, *options: Any) -> None:
            super().__init__()

    return Unconfigurable


for _kind in KINDS:
    breaks(_kind, "check_interface")(_duck(_kind))
    breaks(_kind, "check_signature")(_unconfigurable(_kind))
