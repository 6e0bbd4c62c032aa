"""``icub benchmark NAME``: run a measurement that writes into benchmarks/results.

Benchmarks are the scripts of the folder ``benchmarks`` of a checkout, and functions ``main(argv)`` announced by entry
points of the group ``icub.benchmark``.
"""

from __future__ import annotations

import functools
import runpy
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from pathlib import Path

from icub_core.errors import ConfigError, PluginError, unknown_name

ENTRY_POINT_GROUP = "icub.benchmark"


def main(arguments: Sequence[str]) -> int:
    """Run ``icub benchmark``; returns the exit code."""
    known = benchmarks()
    if not arguments or arguments[0] in ("-h", "--help"):
        names = "".join(f"  {name}\n" for name in sorted(known)) or "  none: this is not a checkout\n"
        sys.stdout.write(f"usage: icub benchmark NAME [ARGUMENT ...]\n\nbenchmarks:\n{names}")
        return 0
    name, *rest = arguments
    if name not in known:
        raise ConfigError(unknown_name("benchmark", name, known))
    return int(known[name](rest) or 0)


def benchmarks() -> dict[str, Callable[[Sequence[str]], int | None]]:
    """Return every benchmark by name; announced ones are imported when they are called."""
    folder = Path(__file__).resolve().parents[3] / "benchmarks"
    found: dict[str, Callable[[Sequence[str]], int | None]] = {
        script.stem: functools.partial(_run_script, script)
        for script in sorted(folder.glob("*.py"))
        if not script.stem.startswith("_")
    }
    for entry in entry_points(group=ENTRY_POINT_GROUP):
        found[entry.name] = functools.partial(_run_entry, entry.name)
    return found


def _run_script(script: Path, arguments: Sequence[str]) -> int:
    """Run a script as `python SCRIPT` would: its folder is searched first, so that it can be of several modules."""
    typed, sys.argv = sys.argv, [str(script), *arguments]
    sys.path.insert(0, str(script.parent))
    try:
        runpy.run_path(str(script), run_name="__main__")
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    finally:
        sys.argv = typed
        sys.path.remove(str(script.parent))
    return 0


def _run_entry(name: str, arguments: Sequence[str]) -> int | None:
    (entry,) = entry_points(group=ENTRY_POINT_GROUP, name=name)
    try:
        function = entry.load()
    except Exception as cause:
        raise PluginError(f"the benchmark '{name}' ({entry.value}) cannot be imported: {cause}") from cause
    result: int | None = function(list(arguments))
    return result
