"""``icub plugins``: what is installed, what it takes, whether it keeps its kind's contract."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import entry_points
from typing import Any

from icub_core.docstrings import first_line
from icub_core.errors import ConfigError, PluginError, unknown_name
from icub_core.kinds import KINDS, get_kind
from icub_core.registry import PluginInfo, available, info

CONTRACT_KIT = "icub.contract_kit"
"""Entry-point group of a function ``check(kind, names, parameters) -> exit code``."""


def main(arguments: Sequence[str]) -> int:
    """List, show or check plugins."""
    parser = argparse.ArgumentParser(prog="icub plugins", description="What is installed, and whether it works.")
    actions = parser.add_subparsers(dest="action", required=True, metavar="list|show|check")
    listing = actions.add_parser("list", help="every plugin of every kind; imports none of them")
    listing.add_argument("kind", nargs="?", help=f"only this kind: {', '.join(KINDS)}")
    listing.add_argument("--markdown", action="store_true", help="as the table of the README")
    showing = actions.add_parser("show", help="parameters, types and defaults of a plugin")
    showing.add_argument("words", nargs="+", metavar="[KIND] NAME")
    checking = actions.add_parser("check", help="try the contract of a kind on a plugin")
    checking.add_argument("kind", metavar="KIND")
    checking.add_argument("name", metavar="NAME", nargs="?", help="a plugin; without it --all")
    checking.add_argument("--all", action="store_true", help="every plugin of the kind")
    checking.add_argument("--set", action="append", default=[], metavar="PARAMETER=VALUE", help="of the constructor")
    options = parser.parse_args(list(arguments))
    if options.action == "list":
        plugins = every_plugin(options.kind)
        sys.stdout.write(markdown_table(plugins) if options.markdown else plain_table(plugins))
        return 0
    if options.action == "show":
        return _show(options.words)
    names = sorted(available(options.kind)) if options.all or options.name is None else [options.name]
    return _check(get_kind(options.kind).name, names, dict(_assignment(word) for word in options.set))


def _check(kind: str, names: Sequence[str], parameters: dict[str, Any]) -> int:
    """Let the contract kit check plugins: it stands on the core, so the core finds it as an entry point."""
    kits = list(entry_points(group=CONTRACT_KIT))
    if not kits:
        raise PluginError(f"no contract checks are installed (entry-point group {CONTRACT_KIT})")
    code: int = kits[0].load()(kind, names, parameters)
    return code


def _assignment(word: str) -> tuple[str, Any]:
    key, equals, value = word.partition("=")
    if not equals:
        raise ConfigError(f"'{word}' is not PARAMETER=VALUE")
    import yaml

    return key, yaml.safe_load(value)


def every_plugin(kind: str | None = None) -> list[PluginInfo]:
    """Return all plugins, of one kind when it is given, in the order of the kinds."""
    kinds = [get_kind(kind).name] if kind is not None else list(KINDS)
    return [plugin for name in kinds for plugin in available(name).values()]


def summary(plugin: PluginInfo) -> str:
    """Return the first line of a plugin's docstring, read from its file without importing anything."""
    return first_line(plugin.target)


def plain_table(plugins: Sequence[PluginInfo]) -> str:
    """Return the plugins as aligned text."""
    rows = [("KIND", "NAME", "WHAT IT IS", "FROM")]
    rows += [(p.kind, p.name, _doubtful(p) or summary(p), p.distribution) for p in plugins]
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    return "".join(f"{k:<{widths[0]}}  {n:<{widths[1]}}  {s:<{widths[2]}}  {d}".rstrip() + "\n" for k, n, s, d in rows)


def markdown_table(plugins: Sequence[PluginInfo]) -> str:
    """Return the plugins as the table of the README, kinds without a plugin included."""
    lines = ["| kind | name | what it is |", "| --- | --- | --- |"]
    for plugin in plugins:
        lines.append(f"| {plugin.kind} | `{plugin.name}` | {summary(plugin).replace('|', chr(92) + '|')} |")
    return "\n".join(lines) + "\n"


def _doubtful(plugin: PluginInfo) -> str:
    return f"CANNOT BE USED: also announced by {', '.join(plugin.conflicts)}" if plugin.conflicts else ""


def _show(words: Sequence[str]) -> int:
    for plugin in _find(words):
        sys.stdout.write(description(plugin))
    return 0


def _find(words: Sequence[str]) -> list[PluginInfo]:
    """Return the plugins meant by ``NAME`` or ``KIND NAME``; a name may exist in several kinds."""
    if len(words) > 2:
        raise ConfigError(f"'{' '.join(words)}' is not NAME or KIND NAME")
    if len(words) == 2:
        return [info(words[0], words[1])]
    found = [plugin for plugin in every_plugin() if plugin.name == words[0]]
    if not found:
        raise PluginError(unknown_name("plugin", words[0], {p.name for p in every_plugin()}))
    return found


def description(plugin: PluginInfo) -> str:
    """Import a plugin and return its docstring and parameters as text."""
    from icub_core.config.schema import signature, type_name
    from icub_core.registry import load

    cls = load(plugin.kind, plugin.name)
    parts = signature(plugin.kind, plugin.name, cls)
    lines = [f"{plugin.kind}={plugin.name}   ({plugin.target}, from {plugin.distribution})", ""]
    lines += [f"  {line}".rstrip() for line in (cls.__doc__ or "(no description)").strip().splitlines()[:1]]
    lines.append("")
    for parameter in parts.parameters.values():
        default = "required" if parameter.required else f"= {parameter.default!r}"
        lines.append(f"  {plugin.kind}.{parameter.name}: {type_name(parameter.annotation)} {default}")
    for parameter in parts.dependencies.values():
        lines.append(f"  needs {parameter.name}" + ("" if parameter.required else " (optional)"))
    return "\n".join(lines) + "\n\n"
