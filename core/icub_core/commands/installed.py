"""The commands that are installed: entry points of the group ``icub.command``."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

ENTRY_POINT_GROUP = "icub.command"
"""A command is a function ``main(arguments) -> exit code``; the first line of its docstring is its help."""


def commands_by_name() -> dict[str, EntryPoint]:
    """Return every announced command, without importing any."""
    found = entry_points(group=ENTRY_POINT_GROUP)
    return {entry.name: entry for entry in sorted(found, key=lambda entry: entry.name)}
