"""What every stage of a run shares: seed, where to write, whom to tell, what was measured."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from icub_core.files import write_text_atomically
from icub_core.hooks import Events

logger = logging.getLogger(__name__)


@dataclass
class RunContext:
    """One run.

    Attributes:
        run_dir: Where everything is written.
        seed: Of the run; every stage derives its own streams from it.
        events: Tells listeners.
        metrics: Flat figures, by key.
        seconds: Wall time by stage.
        notes: What the reader of the report must know.
        images: Caption and file of the images made.
    """

    run_dir: Path
    seed: int
    events: Events
    metrics: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    pictures: list[tuple[str, Path]] = field(default_factory=list)
    _stage: str = ""

    def rng(self, purpose: str) -> np.random.Generator:
        """Return a random stream that depends only on the run's seed and the purpose."""
        return np.random.default_rng([self.seed, *purpose.encode()])

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage and announce its start and end."""
        self._stage = name
        started = time.perf_counter()
        with self.events.stage(name):
            yield
        self.seconds[name] = time.perf_counter() - started
        self.metrics[f"{name}.seconds"] = self.seconds[name]
        logger.info("stage %s took %.1f s", name, self.seconds[name])

    def progress(self, fraction: float, text: str) -> None:
        """Announce how far the present stage is, 0 to 1."""
        self.events.emit("icub_progress", stage=self._stage, fraction=fraction, text=text)

    def note(self, text: str) -> None:
        """Tell the reader, in the log and in the report."""
        logger.warning(text)
        self.notes.append(text)

    def record(self, figures: dict[str, Any]) -> None:
        """Add figures and announce them."""
        self.metrics.update(figures)
        self.events.emit("icub_metrics", metrics=dict(figures))

    def remember(self, stage: str) -> None:
        """Note in the run folder that everything up to `stage` is done, with its figures."""
        content: dict[str, Any] = {"metrics": self.metrics, "seconds": self.seconds, "notes": self.notes}
        content["images"] = [[caption, path.name] for caption, path in self.pictures]
        write_text_atomically(self.run_dir / f"done_{stage}.json", json.dumps(content, indent=2) + "\n")

    def recall(self, stage: str) -> bool:
        """Take over the figures of a stage that an interrupted run in this folder has done; say whether it was."""
        path = self.run_dir / f"done_{stage}.json"
        if not path.exists():
            return False
        content = json.loads(path.read_text())
        self.metrics.update(content["metrics"])
        self.seconds.update(content["seconds"])
        self.notes[:] = content["notes"]
        self.pictures[:] = [(caption, self.run_dir / name) for caption, name in content["images"]]
        return True
