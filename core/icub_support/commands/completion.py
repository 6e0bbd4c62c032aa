"""``icub completion``: scripts that ask ``icub _complete`` for candidates, so installed plugins complete too."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import entry_points

from icub_core.commands.installed import commands_by_name
from icub_core.kinds import KINDS
from icub_core.registry import available

SCRIPTS = {
    "bash": """\
# eval "$(icub completion bash)"
_icub() {
    # the line is taken as it was typed: bash would split words at '='
    local line="${COMP_LINE:0:COMP_POINT}" words candidate current
    read -ra words <<< "$line"
    [[ "$line" == *[[:space:]] ]] && words+=("")
    current="${words[${#words[@]}-1]}"
    COMPREPLY=()
    while IFS= read -r candidate; do
        # bash replaces only what follows the last '='
        if [[ "$current" == *=* && "$COMP_WORDBREAKS" == *=* ]]; then candidate="${candidate#*=}"; fi
        COMPREPLY+=("$candidate")
    done < <(icub _complete "${words[@]}" 2>/dev/null)
    if [[ "${COMPREPLY[0]}" == *= ]]; then compopt -o nospace; fi
}
complete -F _icub icub
""",
    "zsh": """\
# eval "$(icub completion zsh)"
_icub() {
    local -a candidates
    candidates=("${(@f)$(icub _complete "${words[@]:0:$CURRENT}" 2>/dev/null)}")
    compadd -S '' -- $candidates
}
compdef _icub icub
""",
    "fish": """\
# icub completion fish | source
complete -c icub -f -a '(icub _complete (commandline -opc) (commandline -ct) 2>/dev/null)'
""",
}


def main(arguments: Sequence[str]) -> int:
    """Print the completion script of a shell."""
    parser = argparse.ArgumentParser(prog="icub completion", description="Print a shell's completion script.")
    parser.add_argument("shell", choices=sorted(SCRIPTS))
    sys.stdout.write(SCRIPTS[parser.parse_args(list(arguments)).shell])
    return 0


def complete(words: Sequence[str]) -> int:
    """Print the candidates for the last of `words`, which begin with the command itself; returns the exit code."""
    sys.stdout.writelines(f"{candidate}\n" for candidate in candidates(list(words)))
    return 0


def candidates(words: list[str]) -> list[str]:
    """Return what the last word may become."""
    if len(words) < 2:
        return []
    current = words[-1]
    if len(words) == 2:
        return _starting(current, [*(name for name in commands_by_name() if name[0] != "_"), "--help", "--version"])
    command, position = words[1], len(words) - 2
    if command == "completion":
        return _starting(current, sorted(SCRIPTS)) if position == 1 else []
    if command in ("run", "train"):
        return _override(current, run=command == "run")
    if command == "benchmark" and position == 1:
        return _starting(current, sorted(entry.name for entry in entry_points(group="icub.benchmark")))
    if command == "plugins":
        return _plugins(words[2:], current)
    return []


def _plugins(words: list[str], current: str) -> list[str]:
    if len(words) == 1:
        return _starting(current, ["list", "show", "check"])
    if len(words) == 2:
        names = [name for kind in KINDS for name in available(kind)] if words[0] == "show" else []
        return _starting(current, [*KINDS, *sorted(set(names))])
    if len(words) == 3 and words[0] in ("show", "check") and words[1] in KINDS:
        return _starting(current, list(available(words[1])))
    return []


def _override(current: str, run: bool) -> list[str]:
    sign = "+" if current.startswith("+") else ""
    typed = current.lstrip("+")
    if run:
        from icub_core.config.folders import groups

        options = {group: [*names] for group, names in groups().items()}
    else:
        options = {kind: list(available(kind)) for kind in KINDS}
    group, equals, _ = typed.partition("=")
    if equals:
        return [f"{sign}{word}" for word in _starting(typed, [f"{group}={name}" for name in options.get(group, [])])]
    words = [f"{name}=" for name in options] + (["seed=", "device=", "run_dir="] if run else [])
    flags = ["--resume", "--multirun", "--cfg", "--help"] if run else ["--minutes", "--seed", "--run-dir", "--help"]
    return [f"{sign}{word}" for word in _starting(typed, words)] + ([] if sign else _starting(typed, flags))


def _starting(beginning: str, words: Sequence[str]) -> list[str]:
    return [word for word in words if word.startswith(beginning)]
