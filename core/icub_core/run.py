"""What the stages of a run share: seed, plugins, where to write, whom to tell, what was measured."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from icub_core.hooks import Events
from icub_core.interfaces.closable import Closable

logger = logging.getLogger(__name__)


class Plugins(Protocol):
    """The plugins that were composed for a run (`icub_core.config.assembly.Assembly`)."""

    def chosen(self, kind: str) -> str | None:
        """Return the name of the chosen plugin of a kind, or None."""

    def choose(self, kind: str, name: str) -> None:
        """Choose a plugin for a kind that the configuration leaves out."""

    def takes(self, kind: str) -> Mapping[str, Any]:
        """Return what the constructor of the chosen plugin of a kind takes: name to default."""

    def get(self, kind: str) -> Any:
        """Return the run's instance of a kind."""

    def fresh(self, kind: str, **given: Any) -> Any:
        """Build another instance."""


@dataclass
class Run:
    """One run.

    Attributes:
        run_dir: Where everything is written.
        seed: Of the run; every stage derives its own streams from it.
        events: Tells listeners.
        plugins: Of the composed configuration.
        config: The resolved configuration, plain.
        metrics: Flat figures, by key.
        seconds: Wall time by stage.
        notes: What the reader of the report must know.
        images: Caption and file of the images made.
    """

    run_dir: Path
    seed: int
    events: Events
    plugins: Plugins
    config: Mapping[str, Any] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    images: list[tuple[str, Path]] = field(default_factory=list)
    stage: str = ""
    _shared: dict[str, Any] = field(default_factory=dict)
    _closing: ExitStack = field(default_factory=ExitStack)

    def rng(self, purpose: str) -> np.random.Generator:
        """Return a random stream that depends only on the run's seed and the purpose."""
        return np.random.default_rng([self.seed, *purpose.encode()])

    def progress(self, fraction: float, text: str) -> None:
        """Announce how far the present stage is, 0 to 1."""
        self.events.emit("icub_progress", stage=self.stage, fraction=fraction, text=text)

    def note(self, text: str) -> None:
        """Tell the reader, in the log and in the report; the same text is said once."""
        if text not in self.notes:
            logger.warning(text)
            self.notes.append(text)

    def record(self, figures: Mapping[str, Any]) -> None:
        """Add figures and announce them."""
        self.metrics.update(figures)
        self.events.emit("icub_metrics", metrics=dict(figures))

    def shared(self, name: str, make: Callable[[], Any]) -> Any:
        """Return what several stages use, made by the first that asks; closed when the run ends, if it can be."""
        if name not in self._shared:
            made = self._shared[name] = make()
            if isinstance(made, Closable):
                self._closing.callback(made.close)
        return self._shared[name]

    def close(self) -> None:
        """Close what was shared, the latest first; one that fails leaves no other open."""
        self._shared.clear()
        self._closing.close()
