"""report.html: what a run measured, in one self-contained file."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from icub_core.files import write_text_atomically
from icub_core.hooks import listen
from icub_core.run import Run

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #1c2430 }
table { border-collapse: collapse; margin: .6rem 0 } td, th { padding: .25rem .8rem; border-bottom: 1px solid #d8dde4 }
td.n { text-align: right; font-variant-numeric: tabular-nums } img { max-width: 100%; border-radius: 4px }
pre { background: #f4f6f8; padding: .8rem; overflow-x: auto } h2 { margin-top: 2rem }
"""
_MEDIA = {".png": "image/png", ".jpg": "image/jpeg", ".gif": "image/gif"}


class Report:
    """Listens to a run and writes report.html when it ended well."""

    @listen
    def icub_run_end(self, run: Run, run_dir: Path, error: BaseException | None) -> None:
        """Write the report."""
        if error is None:
            configuration = yaml.safe_dump(dict(run.config), sort_keys=False)
            write_report(run_dir, "icub run", run.metrics, run.seconds, run.images, run.notes, configuration)


def write_report(
    run_dir: Path,
    title: str,
    metrics: Mapping[str, Any],
    stages: Mapping[str, float],
    images: Sequence[tuple[str, Path]],
    notes: Sequence[str],
    configuration: str,
) -> None:
    """Write report.html.

    Args:
        run_dir: Run folder.
        title: Heading.
        metrics: Flat figures.
        stages: Seconds by stage.
        images: Caption and file of each image; they are embedded.
        notes: Lines the reader must know, such as which stage used ground truth.
        configuration: Resolved configuration as YAML.
    """
    parts = [f"<h1>{html.escape(title)}</h1>"]
    parts += [f"<p>{html.escape(note)}</p>" for note in notes]
    parts.append("<h2>Figures</h2>" + _table(metrics))
    parts.append("<h2>Stages, seconds</h2>" + _table(stages))
    for caption, path in images:
        if path.exists():
            encoded = base64.b64encode(path.read_bytes()).decode()
            parts.append(f"<h2>{html.escape(caption)}</h2><img src='data:{_MEDIA[path.suffix]};base64,{encoded}'>")
    provenance = run_dir / "provenance.json"
    parts.append(f"<h2>Configuration</h2><pre>{html.escape(configuration)}</pre>")
    if provenance.exists():
        parts.append(f"<h2>Provenance</h2><pre>{html.escape(provenance.read_text())}</pre>")
    head = f"<meta charset='utf-8'><title>{html.escape(title)}</title><style>{_STYLE}</style>"
    write_text_atomically(run_dir / "report.html", f"<!doctype html>{head}{''.join(parts)}\n")


def _table(rows: Mapping[str, Any]) -> str:
    cells = "".join(
        f"<tr><td>{html.escape(key)}</td><td class='n'>{html.escape(formatted(value))}</td></tr>"
        for key, value in rows.items()
    )
    return f"<table>{cells}</table>"


def formatted(value: Any) -> str:
    """Return a figure as a person would write it: four digits for floats, text as it is."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
