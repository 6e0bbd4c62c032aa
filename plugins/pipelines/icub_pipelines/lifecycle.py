"""What every pipeline does around its stages: announce, time, and leave a complete run folder."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf

from icub_core.hooks import Events
from icub_pipelines.console import ConsoleView
from icub_pipelines.context import RunContext
from icub_pipelines.report import write_metrics, write_provenance, write_report


def carry_out(cfg: DictConfig, run_dir: Path, stages: Callable[[RunContext], None]) -> dict[str, Any]:
    """Run a pipeline's stages in a run folder and write what stays: provenance, metrics.json, report.html.

    Args:
        cfg: Composed configuration.
        run_dir: Where everything is written.
        stages: Does the work, and records its figures in the context.

    Returns:
        The flat figures of metrics.json.
    """
    events = Events.discover([ConsoleView()])
    context = RunContext(run_dir, int(cfg.seed), events)
    config = cast(dict[str, Any], OmegaConf.to_container(cfg, resolve=True))
    write_provenance(run_dir, context.seed, command=shlex.join(["icub", "run", *sys.argv[1:]]))
    events.emit("icub_run_start", config=config, run_dir=run_dir)
    error: BaseException | None = None
    started = time.perf_counter()
    try:
        stages(context)
        _finish(context, cfg, time.perf_counter() - started)
    except BaseException as cause:
        error = cause
        raise
    finally:
        events.emit("icub_run_end", metrics=context.metrics, run_dir=run_dir, error=error)
    return context.metrics


def _finish(context: RunContext, cfg: DictConfig, seconds: float) -> None:
    # a run that goes on where another was interrupted counts the other's stages too
    context.metrics["run.seconds"] = max(seconds, sum(context.seconds.values()))
    write_metrics(context.run_dir, context.metrics)
    write_report(
        context.run_dir,
        "icub run",
        context.metrics,
        context.seconds,
        context.pictures,
        context.notes,
        OmegaConf.to_yaml(cfg, resolve=True),
    )
