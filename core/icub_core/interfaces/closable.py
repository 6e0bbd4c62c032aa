"""The ability to be closed, which plugins of any kind may have."""

from __future__ import annotations

from typing import Protocol, runtime_checkable


@runtime_checkable
class Closable(Protocol):
    """Any plugin that holds files, processes or an engine."""

    def close(self) -> None:
        """Free what is held; may be called twice."""
