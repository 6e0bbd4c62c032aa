"""The command ``icub``. Only the standard library is imported here; each command imports what it needs.

Exit codes: 0 all well; 1 a run or a check failed; 2 the command line or the configuration is wrong; 130 interrupted.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from icub_core import __version__
from icub_core.commands.installed import commands_by_name
from icub_core.errors import ConfigError, IcubError, PluginError, unknown_name

DEBUG_VARIABLE = "ICUB_DEBUG"
"""Environment variable that asks for tracebacks."""

EPILOG = f"icub COMMAND --help says more. {DEBUG_VARIABLE}=1 shows tracebacks of expected errors too."


class Interrupted(KeyboardInterrupt):
    """Ctrl-C in a command that can be continued; the message says how."""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the first word; everything after it belongs to the command."""
    from icub_core.docstrings import first_line

    commands = "\n".join(
        f"  {name:<12}{first_line(entry.value)}" for name, entry in commands_by_name().items() if name[0] != "_"
    )
    made = argparse.ArgumentParser(
        prog="icub",
        usage="icub [-h] [--version] COMMAND ...",
        description=f"Perception and grasping for the iCub, composed of plugins.\n\ncommands:\n{commands}",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument("--version", action="version", version=f"icub {__version__}")
    made.add_argument("command", metavar="COMMAND", help=argparse.SUPPRESS)
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        return _dispatch(words)
    except Interrupted as interruption:
        return _say(str(interruption), 130)
    except KeyboardInterrupt:
        return _say("icub: interrupted", 130)
    except BrokenPipeError:  # the reader of a pipe has gone, such as `head`
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115  # stays open until the interpreter flushes it
        return 0
    except IcubError as error:
        if os.environ.get(DEBUG_VARIABLE) == "1":
            raise
        return _say(
            f"icub: error: {' '.join(str(error).split())}", 2 if isinstance(error, (ConfigError, PluginError)) else 1
        )


def _dispatch(words: list[str]) -> int:
    # what follows the command is cut off before argparse, so that flags for Hydra pass through
    if not words or words[0].startswith("-"):
        parser().parse_args(words[:1] or ["--help"])
    known = commands_by_name()
    if words[0] not in known:
        raise ConfigError(unknown_name("command", words[0], known))
    entry = known[words[0]]
    try:
        function = entry.load()
    except Exception as cause:
        raise PluginError(f"the command '{entry.name}' ({entry.value}) cannot be imported: {cause}") from cause
    code: int = function(words[1:])
    return code


def _say(line: str, code: int) -> int:
    sys.stderr.write(line + "\n")
    return code


if __name__ == "__main__":
    # run as a script this module exists twice; the commands raise the exceptions of the imported one
    from icub_core.cli import main as imported_main

    sys.exit(imported_main())
