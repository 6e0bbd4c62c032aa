"""Live progress of a run in the terminal, and its closing table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from icub_core.hooks import listen
from icub_core.pipeline.report import formatted

CLOSING_FIGURES = (
    "segmentation.train_seconds", "segmentation.map50_segm", "segmentation.map70_segm", "segmentation.map50_bbox",
    "segmentation.map70_bbox", "plan.share_with_plan", "grasp.success_rate", "grasp.episodes", "grasp.faults",
    "run.seconds",
)  # fmt: skip
"""What the closing table shows, when it was measured; metrics.json has everything."""


class ConsoleView:
    """Listens to a run and draws one line a stage; without a terminal, one line when a stage ends."""

    def __init__(self, console: Console | None = None) -> None:
        """Draw on `console`, by default standard error."""
        self._console = console or Console(stderr=True)
        self._progress = Progress(
            SpinnerColumn(finished_text="[green]✓"),
            TextColumn("{task.fields[stage]:<7}"),
            BarColumn(bar_width=28),
            TimeElapsedColumn(),
            TextColumn("{task.description}"),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._tasks: dict[str, TaskID] = {}

    @listen
    def icub_run_start(self, run_dir: Path) -> None:
        """Begin drawing."""
        self._console.print(f"run folder: {run_dir}", soft_wrap=True)
        self._progress.start()

    @listen
    def icub_stage_start(self, stage: str) -> None:
        """Add a line."""
        self._tasks[stage] = self._progress.add_task("", total=1.0, stage=stage)

    @listen
    def icub_progress(self, stage: str, fraction: float, text: str) -> None:
        """Move the bar of the stage."""
        if stage in self._tasks:
            self._progress.update(self._tasks[stage], completed=fraction, description=text)

    @listen
    def icub_stage_end(self, stage: str, seconds: float) -> None:
        """Fill the bar of the stage."""
        self._progress.update(self._tasks[stage], completed=1.0)
        if not self._console.is_terminal:
            self._console.print(f"{stage}: {seconds:.1f} s", soft_wrap=True)

    @listen
    def icub_run_end(self, metrics: Mapping[str, Any], run_dir: Path, error: BaseException | None) -> None:
        """Stop drawing; show the closing table of a run that ended well."""
        self._progress.stop()
        if error is not None:
            return
        table = Table("figure", "value", title="result")
        for key in CLOSING_FIGURES:
            if key in metrics:
                table.add_row(key, formatted(metrics[key]))
        self._console.print(table)
        self._console.print(f"report: {run_dir / 'report.html'}", soft_wrap=True)
