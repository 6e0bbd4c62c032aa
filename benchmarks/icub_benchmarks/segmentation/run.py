"""Segmenters against one another: four mAPs (mean and deviation over runs) and the training time in its parts.

    icub benchmark segmentation                                       # all methods, both rendered tasks, three runs
    icub benchmark segmentation --full                                # and those that train the whole network: slow
    icub benchmark segmentation --curves                              # and precision over training time
    icub benchmark segmentation --ablation                            # what each ingredient adds, taught by showing
    icub benchmark segmentation --quick                               # few frames, one run: does it work?
    icub benchmark segmentation --methods ours falkon,segmenter.mode=faithful --tasks tabletop --runs 1
    icub benchmark segmentation --tasks "ycb_video,path=/data/ycbv"   # any dataset plugin

Trials are kept one by one in the work folder: the same line resumes an interrupted benchmark. They are known by task,
method and their whole configuration, not by the code: measure again with --fresh after changing it.

A table (Markdown) and plots appear beside the results file, which is segmentation.json, or segmentation_full.json when
methods are among the results that train the whole network.

Source: the shape of thesis tables 10.1, 11.1 to 11.6, 11.9 and 11.10 and figures 10.3, 11.6 and 11.7.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from icub_benchmarks.figures import Figure
from icub_benchmarks.results import command_line, make_parser, work_folder, write_figures
from icub_benchmarks.segmentation.methods import ABLATION, CURVES, FULL, METHODS, O_OS, OURS, OUTPUT_LAYERS, Method
from icub_benchmarks.segmentation.trial import Trial
from icub_benchmarks.segmentation.trial_report import HEADINGS, cell, cells, markdown_table, plot_over_time
from icub_benchmarks.segmentation.trials import SHOWING, TASKS, Runs, find_task, run_all
from icub_core import registry
from icub_core.errors import ConfigError, unknown_name
from icub_core.files import write_text_atomically
from icub_support.detection import MEAN_NAMES

MAIN_TASK = "tabletop"
TABLE_WIDTH = 190
"""Columns when the output is a file or a pipe."""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns the exit code."""
    options = _parser().parse_args(argv)
    console = Console(stderr=True)
    if options.quick:
        options.train_frames, options.test_frames, options.runs = 24, 8, 1
    if options.ablation:
        options.tasks, options.methods = [SHOWING], list(dict.fromkeys([OURS, *(options.methods or ABLATION)]))
    methods = _methods(options)
    try:
        runs = run_all([find_task(text) for text in options.tasks], methods, options, console)
    except KeyboardInterrupt:
        console.print("stopped; the same line resumes after the last finished trial")
        return 130
    stem = options.results / ("segmentation_full" if any(m.name in FULL for m in methods) else "segmentation")
    command = command_line("segmentation", argv)
    _write_tables(runs, options, stem, command)
    _print_tables(runs)
    write_figures(stem.with_suffix(".json"), _figures(runs, options.ablation), command=command)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = make_parser("segmentation", __doc__)
    parser.add_argument(
        "--tasks", nargs="+", default=sorted(TASKS, reverse=True), help="tabletop, handheld, showing, DATASET,key=value"
    )
    parser.add_argument(
        "--methods", nargs="+", help=f"{', '.join([*METHODS, *FULL])}, or SEGMENTER[,key=value,...] (default: not full)"
    )
    parser.add_argument("--full", action="store_true", help="also train the whole of Mask R-CNN")
    parser.add_argument("--curves", action="store_true", help="also precision over training time and over r")
    parser.add_argument("--ablation", action="store_true", help="what each ingredient adds, on the task 'showing'")
    parser.add_argument("--quick", action="store_true", help="few frames, one run: does it work?")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--train-frames", type=int, default=160)
    parser.add_argument("--test-frames", type=int, default=80)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--fresh", action="store_true", help="measure again what was measured before")
    parser.add_argument("--work", type=Path, default=work_folder("segmentation"), help="folder of the trials")
    return parser


def _methods(options: argparse.Namespace) -> list[Method]:
    named = {**METHODS, **FULL, **(ABLATION if options.ablation else {})}
    chosen = options.methods or [*METHODS, *(FULL if options.full else ())]
    if options.curves:
        chosen = list(dict.fromkeys([*chosen, *(m for methods in CURVES.values() for m in methods)]))
    methods = [Method(name, named.get(name, name)) for name in chosen]
    for method in methods:
        plugin = method.text.split(",")[0]
        if plugin not in registry.available("segmenter"):
            raise ConfigError(unknown_name("method", plugin, [*named, *registry.available("segmenter")]))
    return methods


def _mean(values: Sequence[float], unit: str) -> Figure:
    spread = statistics.stdev(values) if len(values) > 1 else None
    return Figure(statistics.fmean(values), unit, spread, len(values))


def _figures(runs: Runs, ablation: bool = False) -> dict[str, Figure]:
    figures = {}
    for (task, method), done in runs.items():
        trials = [run.trial for run in done]
        prefix = f"segmentation.{'ablation' if ablation else task}.{method}"
        for name in MEAN_NAMES:
            figures[f"{prefix}.{name}"] = _mean([getattr(t.metrics, name) for t in trials], "1")
        if ablation:
            continue
        figures[f"{prefix}.feature_seconds"] = _mean([t.feature_seconds for t in trials], "s")
        figures[f"{prefix}.update_seconds"] = _mean([t.update_seconds for t in trials], "s")
        figures[f"{prefix}.segment_seconds"] = _mean([t.segment_seconds for t in trials], "s")
        for part in sorted({p for t in trials for p in t.parts}):
            figures[f"{prefix}.{part}_seconds"] = _mean([t.parts.get(part, 0.0) for t in trials], "s")
    return figures if ablation else figures | _comparisons(runs)


def _comparisons(runs: Runs) -> dict[str, Figure]:
    """Compare ours with the baselines on the tabletop task, run by run, where both were measured."""
    figures = {}
    ours = runs.get((MAIN_TASK, OURS), [])
    if ours:
        figures["segmentation.heads_share"] = _mean([run.heads_share for run in ours], "1")
    pairs = [(a.trial, b.trial) for a, b in zip(ours, runs.get((MAIN_TASK, OUTPUT_LAYERS), []), strict=False)]
    if pairs:
        whole, baseline = zip(*pairs, strict=True)
        ratios = [b.update_seconds / a.update_seconds for a, b in pairs]
        gains = _points(whole, "map50_segm", baseline)
        figures["segmentation.speedup_output_layers"] = _mean(ratios, "1")
        figures["segmentation.map50_segm_minus_output_layers"] = _mean(gains, "points")
    pairs = [(a.trial, b.trial) for a, b in zip(ours, runs.get((MAIN_TASK, O_OS), []), strict=False)]
    if pairs:
        whole, baseline = zip(*pairs, strict=True)
        gains_by_name = [_mean(_points(whole, name, baseline), "points") for name in MEAN_NAMES]
        figures["segmentation.ours_minus_oos"] = min(gains_by_name, key=lambda figure: figure.value)
    return figures


def _by_task(runs: Runs) -> dict[str, dict[str, list[Trial]]]:
    tables: dict[str, dict[str, list[Trial]]] = {}
    for (task, method), done in runs.items():
        tables.setdefault(task, {})[method] = [run.trial for run in done]
    return tables


def _write_tables(runs: Runs, options: argparse.Namespace, stem: Path, command: str) -> None:
    """Write tables and plots beside the results file; an ablation has files of its own."""
    if options.ablation:
        stem = stem.with_name(f"{stem.name}_ablation")
    text = [f"# Segmentation\n\n`{command}`\n\nmAP in percent, times in seconds, mean ± deviation over runs.\n"]
    for task, rows in _by_task(runs).items():
        frames = f"{options.train_frames} frames to learn from, {options.test_frames} to be examined on"
        text.append(f"## {task}: {frames}\n\n{_changes(rows) if options.ablation else markdown_table(rows)}")
        if options.ablation:
            continue
        lines: dict[str, dict[str, list[Trial]]] = {}
        if options.curves:
            lines = {name: {m: rows[m] for m in methods if m in rows} for name, methods in CURVES.items()}
            for points in lines.values():
                order = sorted(points, key=lambda m: statistics.fmean(t.update_seconds for t in points[m]))
                points.update({m: points.pop(m) for m in order})
        drawn = {m for points in lines.values() for m in points}
        lines |= {name: {name: trials} for name, trials in rows.items() if name not in drawn}
        plot_over_time(stem.with_name(f"{stem.name}_{task}.png"), f"{task}: precision and training time", lines)
    write_text_atomically(stem.with_suffix(".md"), "\n".join(text))


def _changes(rows: dict[str, list[Trial]]) -> str:
    """Return a Markdown table of what each change does to the four mAPs, run by run against ours."""
    names = HEADINGS[: len(MEAN_NAMES)]
    lines = [f"| changed | {' | '.join(names)} |", f"| --- |{' ---: |' * len(names)}"]
    for method, trials in rows.items():
        reference = None if method == OURS else rows[OURS]
        means = [cell(_points(trials, name, reference), 1, signed=reference is not None) for name in MEAN_NAMES]
        lines.append(f"| {method} | {' | '.join(means)} |")
    return "\n".join(lines) + "\n"


def _points(trials: Sequence[Trial], name: str, reference: Sequence[Trial] | None = None) -> list[float]:
    """Return an mAP of each trial in points, or what it has more than the reference's of the same run."""
    values = [100 * getattr(trial.metrics, name) for trial in trials]
    if reference is None:
        return values
    return [value - 100 * getattr(r.metrics, name) for value, r in zip(values, reference, strict=True)]


def _print_tables(runs: Runs) -> None:
    terminal = Console()
    console = terminal if terminal.is_terminal else Console(width=TABLE_WIDTH)
    for task, rows in _by_task(runs).items():
        table = Table(title=f"{task}: mAP in percent, times in seconds")
        for heading in ("method", *HEADINGS):
            table.add_column(heading, justify="left" if heading == "method" else "right")
        for method, trials in rows.items():
            table.add_row(method, *cells(trials))
        console.print(table)
