"""Every error a user can meet, one line each: what was given, what was expected, the nearest valid choice."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

MAX_NAMES = 30
"""Names that a message lists; an object set may have a thousand."""


class IcubError(Exception):
    """Base of all errors raised on purpose; the command line prints its message without a traceback."""


class ConfigError(IcubError):
    """A configuration key, value or group that does not exist or has the wrong type."""


class PluginError(IcubError):
    """A plugin that does not exist, cannot be imported, or is not of its kind."""


class ContractError(IcubError):
    """A plugin that breaks the contract of its kind."""


class DataError(IcubError):
    """An input (image, cloud, mesh, file of a data set) that cannot be used."""


class WeightsError(IcubError):
    """A weight file that is missing, truncated, or of another architecture."""


class CheckpointError(IcubError):
    """A checkpoint that cannot be written or read back."""


class NotFittedError(IcubError):
    """A learner was asked to predict before it was taught anything."""


class SimulationError(IcubError):
    """A world that cannot be built or rendered on this machine."""


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return ``" Did you mean 'x'?"`` for the nearest of `known`, or an empty string."""
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f" Did you mean '{near[0]}'?" if near else ""


def unknown_name(what: str, name: str, known: Iterable[str]) -> str:
    """Return the standard one-line message for a name that does not exist.

    Args:
        what: The sort of thing that was named, such as ``"segmenter plugin"``.
        name: The name that was given.
        known: The names that would have been valid.
    """
    names = sorted(known)
    listed = ", ".join(names[:MAX_NAMES]) + (f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else "")
    return f"no {what} named '{name}'.{suggestion(name, names)} Known: {listed or 'none'}"
