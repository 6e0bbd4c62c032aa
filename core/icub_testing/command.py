"""What ``icub plugins check`` calls: the contract of a kind, tried on plugins, as a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from icub_core.errors import ConfigError
from icub_testing.checks import run_checks
from icub_testing.fakes import with_tiny_dependencies


def check_plugins(kind: str, names: Sequence[str], parameters: Mapping[str, Any] | None = None) -> int:
    """Check plugins of one kind and print what was found; returns 0 when every contract is kept, 1 otherwise.

    Raises:
        PluginError: A plugin does not exist or cannot be imported.
        ConfigError: No plugin of the kind is installed, or parameters that do not fit.
    """
    from rich.console import Console

    if not names:
        raise ConfigError(f"no {kind} plugin is installed")
    console = Console(highlight=False, markup=False)
    broken = 0
    for name in names:
        make = with_tiny_dependencies(kind, name, parameters)
        make()  # a plugin that cannot be built at all is one error, not one per check
        total = failed = 0
        console.print(f"{kind}={name}", style="bold")
        for result in run_checks(kind, make):
            total += 1
            failed += bool(result.problem)
            mark, style = ("FAIL", "red") if result.problem else ("ok", "green")
            console.print(f"  {mark:<4}", style=style, end="")
            console.print(f"  {result.name.removeprefix('check_'):<24} {result.summary}", soft_wrap=True)
            if result.problem:
                console.print(f"        {result.problem}", soft_wrap=True)
        console.print(f"  {total - failed} of {total} kept\n")
        broken += failed > 0
    return int(broken > 0)
