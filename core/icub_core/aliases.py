"""Old module names that keep working.

A distribution that has moved a module announces it by an entry point: the old name, and the new one as its value.
Importing a name of the group ``icub.alias`` gives the new module and a DeprecationWarning; such a name goes with the
next release. A name of the group ``icub.alias.permanent`` stays, and is no reason to warn.
"""

from __future__ import annotations

import functools
import importlib
import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.metadata import entry_points
from types import ModuleType

ENTRY_POINT_GROUP = "icub.alias"
PERMANENT_GROUP = "icub.alias.permanent"
PACKAGE = "icub_core."


class _AliasFinder(MetaPathFinder, Loader):
    """Stands behind the ordinary finders: it is asked only for modules that do not exist."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return a spec for an old name, or for a module below one."""
        if not fullname.startswith(PACKAGE) or new_name(fullname) is None:
            return None
        return ModuleSpec(fullname, self, is_package=True)

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Import the module under its new name."""
        moved = new_name(spec.name)
        assert moved is not None
        module = importlib.import_module(moved)
        if not is_permanent(spec.name):
            warnings.warn(f"{spec.name} is now {moved}; the old name goes with the next release", DeprecationWarning, 2)
        # the import system writes the old name's spec into whatever it is given, so it is given a stand-in
        stand_in = ModuleType(spec.name, module.__doc__)
        stand_in.__getattr__ = functools.partial(getattr, module)  # type: ignore[method-assign]
        return stand_in

    def exec_module(self, module: ModuleType) -> None:
        """Nothing is left to do."""


@functools.cache
def _moved(group: str) -> dict[str, str]:
    return {entry.name: entry.value for entry in entry_points(group=group)}


def _longest(name: str, moved: Mapping[str, str]) -> str:
    """Return the longest old name that a module's name begins with, or ""."""
    parts = name.split(".")
    known = (".".join(parts[:length]) for length in range(len(parts), 1, -1))
    return next((old for old in known if old in moved), "")


def new_name(old: str) -> str | None:
    """Return where a module is now, by the longest old name that it begins with; None where it has not moved."""
    moved = _moved(ENTRY_POINT_GROUP) | _moved(PERMANENT_GROUP)
    known = _longest(old, moved)
    return moved[known] + old[len(known) :] if known else None


def is_permanent(old: str) -> bool:
    """Return True if an old name stays."""
    permanent = _moved(PERMANENT_GROUP)
    return _longest(old, _moved(ENTRY_POINT_GROUP) | permanent) in permanent


def install_aliases() -> None:
    """Let old names be imported; calling it again changes nothing."""
    if not any(isinstance(finder, _AliasFinder) for finder in sys.meta_path):
        sys.meta_path.append(_AliasFinder())
