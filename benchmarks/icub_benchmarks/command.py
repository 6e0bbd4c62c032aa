"""``icub benchmark NAME``: run a measurement.

Benchmarks are functions ``main(argv)`` announced by entry points of the group ``icub.benchmark``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points

from icub_core.errors import ConfigError, PluginError, unknown_name

ENTRY_POINT_GROUP = "icub.benchmark"


def main(arguments: Sequence[str]) -> int:
    """Measure figures."""
    known = benchmarks()
    if not arguments or arguments[0] in ("-h", "--help"):
        names = "".join(f"  {name}\n" for name in sorted(known)) or "  none is installed\n"
        sys.stdout.write(f"usage: icub benchmark NAME [ARGUMENT ...]\n\nbenchmarks:\n{names}")
        return 0
    name, *rest = arguments
    if name not in known:
        raise ConfigError(unknown_name("benchmark", name, known))
    entry = known[name]
    try:
        function = entry.load()
    except Exception as cause:
        raise PluginError(f"the benchmark '{name}' ({entry.value}) cannot be imported: {cause}") from cause
    try:
        return int(function(rest) or 0)
    except SystemExit as end:
        if isinstance(end.code, str):
            sys.stderr.write(f"{end.code}\n")
        return end.code if isinstance(end.code, int) else int(end.code is not None)


def benchmarks() -> dict[str, EntryPoint]:
    """Return every benchmark by name, without importing any."""
    return {entry.name: entry for entry in entry_points(group=ENTRY_POINT_GROUP)}
