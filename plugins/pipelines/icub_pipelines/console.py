"""Live progress of a run in the terminal, and its closing table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from icub_core.hooks import listen
from icub_pipelines.report import formatted

CLOSING_FIGURES = (
    "segmentation.train_seconds", "segmentation.map50_segm", "segmentation.map70_segm", "segmentation.map50_bbox",
    "segmentation.map70_bbox", "plan.share_with_plan", "grasp.success_rate", "grasp.episodes", "grasp.faults",
    "showing.objects", "showing.teach_seconds", "showing.update_seconds", "showing.corrected", "showing.taken_for",
    "showing.false_positives_before", "showing.false_positives_after", "showing.corrected_recall",
    "showing.map50_segm_before", "showing.map50_segm_after", "run.seconds",
)  # fmt: skip
"""What the closing table shows, when it was measured; metrics.json has everything."""


class ConsoleView:
    """Listens to a run and draws one line per stage; without a terminal, one line when a stage ends."""

    def __init__(self, console: Console | None = None) -> None:
        """Draw on `console`, by default standard error."""
        self._console = console or Console(stderr=True)
        self._progress: Progress | None = None
        self._task = TaskID(0)

    @listen
    def icub_run_start(self, run_dir: Path) -> None:
        """Say where everything is written."""
        self._console.print(f"run folder: {run_dir}", soft_wrap=True)

    @listen
    def icub_stage_start(self, stage: str) -> None:
        """Draw a line that moves until the stage ends; between stages the terminal is free, for questions say."""
        self._progress = Progress(
            SpinnerColumn(finished_text="[green]✓"),
            TextColumn("{task.fields[stage]:<7}"),
            BarColumn(bar_width=28),
            TimeElapsedColumn(),
            TextColumn("{task.description}"),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._task = self._progress.add_task("", total=1.0, stage=stage)
        self._progress.start()

    @listen
    def icub_progress(self, fraction: float, text: str) -> None:
        """Move the bar of the stage."""
        if self._progress is not None:
            self._progress.update(self._task, completed=fraction, description=text)

    @listen
    def icub_stage_end(self, stage: str, seconds: float) -> None:
        """Fill the bar of the stage and let its line stand."""
        if self._progress is not None:
            self._progress.update(self._task, completed=1.0)
            self._progress.stop()
            self._progress = None
        if not self._console.is_terminal:
            self._console.print(f"{stage}: {seconds:.1f} s", soft_wrap=True)

    @listen
    def icub_run_end(self, metrics: Mapping[str, Any], run_dir: Path, error: BaseException | None) -> None:
        """Show the closing table of a run that ended well."""
        if error is not None:
            return
        table = Table("figure", "value", title="result")
        for key in CLOSING_FIGURES:
            if key in metrics:
                table.add_row(key, formatted(metrics[key]))
        self._console.print(table)
        self._console.print(f"report: {run_dir / 'report.html'}", soft_wrap=True)
