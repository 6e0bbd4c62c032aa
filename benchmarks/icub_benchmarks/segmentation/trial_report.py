"""Trials of several methods as a Markdown table and as a plot of precision over training time."""

from __future__ import annotations

import io
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path

from icub_benchmarks.segmentation.trial import Trial
from icub_benchmarks.segmentation.voc import RULES
from icub_core.files import write_bytes_atomically
from icub_support.detection import MEAN_NAMES

PARTS = ("rpn", "detection", "masks")
HEADINGS = (
    "mask mAP50", "mask mAP70", "box mAP50", "box mAP70", "features", "on-line RPN", "detection", "masks",
    "after the last frame", "a test frame",
)  # fmt: skip


def cell(values: Sequence[float], digits: int, *, signed: bool = False) -> str:
    """Return mean and deviation of some values, a dash for none; `signed` writes a plus, too."""
    if not values:
        return "-"
    spread = f" ± {statistics.stdev(values):.{digits}f}" if len(values) > 1 else ""
    return f"{statistics.fmean(values):{'+' if signed else ''}.{digits}f}{spread}"


def cells(trials: Sequence[Trial]) -> list[str]:
    """Return one cell for each of HEADINGS: percent and seconds."""
    return [
        *(cell([100 * getattr(t.metrics, name) for t in trials], 1) for name in MEAN_NAMES),
        cell([t.feature_seconds + t.parts.get("features", 0.0) for t in trials], 1),
        *(cell([t.parts[part] for t in trials if part in t.parts], 2) for part in PARTS),
        cell([t.update_seconds for t in trials], 2),
        cell([t.segment_seconds for t in trials], 3),
    ]


def markdown_table(rows: Mapping[str, Sequence[Trial]]) -> str:
    """Return a table with one row per method (four mAPs in percent, times in seconds), and one by VOC's rules."""
    lines = [f"| method | {' | '.join(HEADINGS)} |", f"| --- |{' ---: |' * len(HEADINGS)}"]
    lines += [f"| {name} | {' | '.join(cells(trials))} |" for name, trials in rows.items() if trials]
    return "\n".join([*lines, *_voc_table({name: trials for name, trials in rows.items() if trials}), ""])


def _voc_table(rows: Mapping[str, Sequence[Trial]]) -> list[str]:
    """Return the lines of a table of the four means by each of VOC's rules; none where no trial has them.

    A method some of whose trials lack them, because they were kept by a version that did not measure them, says so.
    """
    if not any(trial.voc for trials in rows.values() for trial in trials):
        return []
    headings = [f"{heading}, {rule}" for rule in RULES for heading in HEADINGS[: len(MEAN_NAMES)]]
    lines = ["", "By the rules of PASCAL VOC, the thesis's metric:", ""]
    lines += [f"| method | {' | '.join(headings)} |", f"| --- |{' ---: |' * len(headings)}"]
    for name, trials in rows.items():
        missing = sum(not t.voc for t in trials)
        if missing:
            values = [f"n/a ({len(trials) - missing} of {len(trials)} trials)"] * len(RULES) * len(MEAN_NAMES)
        else:
            values = [cell([100 * t.voc[rule][mean] for t in trials], 1) for rule in RULES for mean in MEAN_NAMES]
        lines.append(f"| {name} | {' | '.join(values)} |")
    return lines


def plot_over_time(path: Path, title: str, series: Mapping[str, Mapping[str, Sequence[Trial]]]) -> None:
    """Draw the four mAPs over the seconds after the last frame; methods of one series are joined by a line.

    Args:
        path: PNG file.
        title: Of the whole.
        series: By name, methods in order of training time, each with its trials.
    """
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import StrMethodFormatter

    figure = Figure(figsize=(12, 8), dpi=100, layout="constrained")
    panels = figure.subplots(2, 2).T.flatten()
    for axes, name, heading in zip(panels, MEAN_NAMES, HEADINGS, strict=False):
        for number, (label, methods) in enumerate(series.items()):
            done = [trials for trials in methods.values() if trials]
            if not done:
                continue
            values = [[100 * getattr(t.metrics, name) for t in trials] for trials in done]
            axes.errorbar(
                [statistics.fmean(t.update_seconds for t in trials) for trials in done],
                [statistics.fmean(v) for v in values],
                yerr=[statistics.stdev(v) if len(v) > 1 else 0.0 for v in values],
                marker="o", capsize=3, label=label, color=colormaps["tab20"](number % 20),
            )  # fmt: skip
        axes.set(xscale="log", xlabel="seconds after the last frame", ylabel=f"{heading}, %")
        for axis in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
            axis(StrMethodFormatter("{x:g}"))
        axes.tick_params(axis="x", which="both", labelsize=7, rotation=45)
        axes.grid(alpha=0.3)
    figure.legend(*panels[0].get_legend_handles_labels(), fontsize=8, loc="outside right center")
    figure.suptitle(title)
    content = io.BytesIO()
    FigureCanvasAgg(figure).print_png(content)
    write_bytes_atomically(path, content.getvalue())
