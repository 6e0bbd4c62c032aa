"""Carries out a pipeline: leaves out, times, resumes and reports its stages, in one loop."""

from __future__ import annotations

import json
import logging
import shlex
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf

from icub_core.config.assembly import Assembly
from icub_core.errors import DataError
from icub_core.files import write_text_atomically
from icub_core.hooks import Events
from icub_core.interfaces.pipeline import Pipeline, Stage
from icub_core.provenance import machine, versions
from icub_core.run import Run

logger = logging.getLogger(__name__)


def carry_out(cfg: DictConfig, run_dir: Path, listeners: Sequence[object] = ()) -> dict[str, Any]:
    """Run the chosen pipeline in a run folder and write what stays: provenance.json and metrics.json.

    Args:
        cfg: Composed and checked configuration.
        run_dir: Where everything is written; stages that an interrupted run has finished there are not done again.
        listeners: Told beside the installed ones.

    Returns:
        The flat figures of metrics.json.
    """
    plugins = Assembly(cfg)
    config = cast(dict[str, Any], OmegaConf.to_container(cfg, resolve=True))
    run = Run(run_dir, int(cfg.seed), Events.discover(listeners), plugins, config)
    provenance = {
        "command": shlex.join(["icub", "run", *sys.argv[1:]]),
        "seed": run.seed,
        "versions": versions(),
        "machine": machine(),
    }
    write_text_atomically(run_dir / "provenance.json", json.dumps(provenance, indent=2) + "\n")
    run.events.emit("icub_run_start", config=config, run_dir=run_dir)
    error: BaseException | None = None
    started = time.perf_counter()
    try:
        pipeline: Pipeline = plugins.get("pipeline")
        do_stages(run, pipeline.stages(run))
        # a resumed run counts the stages of the interrupted one too
        run.metrics["run.seconds"] = max(time.perf_counter() - started, sum(run.seconds.values()))
        write_text_atomically(run_dir / "metrics.json", json.dumps(run.metrics, indent=2) + "\n")
    except BaseException as cause:
        error = cause
        raise
    finally:
        try:
            run.events.emit("icub_run_end", run=run, metrics=run.metrics, run_dir=run_dir, error=error)
        finally:
            with closing(plugins), closing(run):
                pass
    return run.metrics


def do_stages(run: Run, stages: Sequence[Stage]) -> None:
    """Do the stages whose plugins are chosen and that this run folder does not hold yet."""
    again = False
    for stage in stages:
        missing = [kind for kind in stage.needs if run.plugins.chosen(kind) is None]
        if missing:
            if stage.without:
                run.note(stage.without)
            continue
        if not again and _recall(run, stage):
            continue
        again = True  # what followed it belongs to another past
        run.stage = stage.name
        started = time.perf_counter()
        with run.events.stage(stage.name):
            stage.run(run)
        run.seconds[stage.name] = time.perf_counter() - started
        run.metrics[f"{stage.name}.seconds"] = run.seconds[stage.name]
        logger.info("stage %s took %.1f s", stage.name, run.seconds[stage.name])
        _remember(run, stage)


def _record_of(run: Run, stage: Stage) -> Path:
    return run.run_dir / f"done_{stage.name.replace(' ', '_')}.json"


def _remember(run: Run, stage: Stage) -> None:
    """Note in the run folder that everything up to a stage is done, with its figures."""
    content: dict[str, Any] = {"metrics": run.metrics, "seconds": run.seconds, "notes": run.notes}
    content["images"] = [[caption, path.name] for caption, path in run.images]
    write_text_atomically(_record_of(run, stage), json.dumps(content, indent=2) + "\n")


def _recall(run: Run, stage: Stage) -> bool:
    """Restore the figures, and through `Stage.resume` the memory, of a finished stage; return True if it was."""
    path = _record_of(run, stage)
    if not path.exists():
        return False
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        metrics, seconds = dict(content["metrics"]), dict(content["seconds"])
        notes, images = list(content["notes"]), [(str(caption), str(name)) for caption, name in content["images"]]
    except (ValueError, KeyError, TypeError, OSError) as cause:
        raise DataError(f"{path} is damaged; delete it to do the stage '{stage.name}' again") from cause
    if stage.resume is not None and not stage.resume(run):
        return False
    run.metrics.update(metrics)
    run.seconds.update(seconds)
    run.notes[:] = [*run.notes, *(note for note in notes if note not in run.notes)]
    run.images[:] = [(caption, run.run_dir / name) for caption, name in images]
    logger.info("the stage %s was done before in %s", stage.name, run.run_dir)
    return True
