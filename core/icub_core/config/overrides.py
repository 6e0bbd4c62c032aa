"""What a user types after ``icub run``, made into what Hydra takes, with every misspelling stopped.

Hydra accepts ``+segmentr=falkon`` silently as a new key, and refuses ``+segmenter=falkon`` for a group of the defaults
list. Here ``+group=x``, ``++group=x`` and ``group=x`` mean the same, ``~group`` and ``group=null`` leave a stage out,
and a key whose first word is unknown is an error.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence

from icub_core.errors import ConfigError, suggestion, unknown_name
from icub_core.kinds import KINDS

NONE = "none"
"""Option of every kind that leaves its stage out; Hydra itself knows no way to undo a choice."""

FLAGS_WITH_VALUE = {
    "--cfg", "-c", "--package", "-p", "--config-path", "-cp", "--config-name", "-cn", "--config-dir", "-cd",
    "--info", "-i",
}  # fmt: skip
_OVERRIDE = re.compile(r"^(?P<sign>\+\+|\+|~)?(?P<key>[^=\s]+?)(?:=(?P<value>.*))?$", re.DOTALL)
_PLAIN_CHOICES = re.compile(r"^[\w.-]+(,[\w.-]+)*$")


def rewrite(arguments: Sequence[str], groups: Mapping[str, Collection[str]], settings: Collection[str]) -> list[str]:
    """Return the arguments for Hydra.

    Args:
        arguments: Flags and overrides as typed.
        groups: Options of every top-level group.
        settings: Top-level keys that are no groups.

    Raises:
        ConfigError: A word that is no override, an unknown group or key, an unknown option, with the nearest valid one.
    """
    rewritten = []
    passes_value = False
    for argument in arguments:
        if passes_value or argument.startswith("-"):
            passes_value = argument in FLAGS_WITH_VALUE
            rewritten.append(argument)
        else:
            rewritten.append(_rewrite_one(argument, groups, settings))
    return rewritten


def _rewrite_one(argument: str, groups: Mapping[str, Collection[str]], settings: Collection[str]) -> str:
    match = _OVERRIDE.match(argument)
    sign, key, value = (match["sign"] or "", match["key"], match["value"]) if match else ("", argument, None)
    if value is None and sign != "~":
        raise ConfigError(f"'{argument}' is not KEY=VALUE{_choice_named(argument, groups)}")
    top = re.split(r"[./@]", key)[0]
    if top == "hydra":
        return argument
    if top not in groups and top not in settings:
        hint = suggestion(top, [*groups, *settings]).replace("'?", f"{key[len(top) :]}={value}'?" if value else "'?")
        raise ConfigError(
            f"there is no plugin kind or setting named '{top}'.{hint} Known: {', '.join([*groups, *settings])}"
        )
    if key != top:
        # `+policy.alfa=1` would add a key that no plugin reads; keys inside a mapping parameter may be added
        keep_sign = sign == "~" or key.count(".") > 1 or "@" in key
        return argument if keep_sign else argument[len(sign) :]
    if top not in groups:
        return argument if sign == "~" else argument[len(sign) :]
    if top not in KINDS and sign == "~":
        return argument
    choices = [NONE if choice == "null" else choice for choice in (value or NONE).split(",")]
    if sign == "~":
        choices = [NONE]
    if not _PLAIN_CHOICES.match(",".join(choices)):  # sweeps such as glob(*) are Hydra's business
        return argument[len(sign) :]
    for choice in choices:
        if choice not in groups[top] and not (choice == NONE and top in KINDS):
            raise ConfigError(
                unknown_name(f"{top} plugin" if top in KINDS else f"{top} configuration", choice, groups[top])
            )
    return f"{top}={','.join(choices)}"


def _choice_named(word: str, groups: Mapping[str, Collection[str]]) -> str:
    choices = [f"'{group}={word}'" for group, options in groups.items() if word in options]
    if choices:
        return f". Did you mean {' or '.join(choices)}?"
    return "; expected words such as policy=NAME or policy.seed=3"
