"""Inline code such as `segmenter.masks=combined` or `mode=faithful` names a parameter that takes this value."""

import dataclasses
import re
import typing

import pytest
import yaml
from tests.docs.pages import EXAMPLE, figures, inline_code, pages

from icub_core import registry
from icub_core.config.folders import groups
from icub_core.config.schema import signature
from icub_core.config.settings import RunSettings, SceneSettings
from icub_core.construct import checked_parameters
from icub_core.errors import ConfigError
from icub_core.kinds import KINDS

_ASSIGNMENT = re.compile(r"[+~]*(?P<key>[a-z]\w*(?:\.\w+)*)=(?P<value>\S+)")
_PARAMETER = re.compile(rf"(?:{'|'.join(KINDS)})(?:\.[a-z]\w*)+")


def owners(kind: str, path: list[str]) -> list[tuple[str, type]]:
    """Return the plugins of a kind that have a parameter such as ``grasp.visual``."""
    found = []
    for name in registry.available(kind):
        cls = registry.load(kind, name)
        known = {key: parameter.annotation for key, parameter in signature(kind, name, cls).parameters.items()}
        for step in path[:-1]:
            inner = known.get(step)
            known = typing.get_type_hints(inner) if dataclasses.is_dataclass(inner) else {}
        if path[-1] in known:
            found.append((name, cls))
    return found


def takes(kind: str, name: str, cls: type, path: list[str], value: str) -> bool:
    if re.search(r"[A-Z]{2}", value):  # stands for the reader's own, such as FOLDER
        return True
    given = yaml.safe_load(value)
    for step in reversed(path):
        given = {step: given}
    try:
        checked_parameters(kind, name, cls, given)
    except ConfigError as refusal:
        return "needs the parameter" in str(refusal)  # another one, which the page does not repeat
    return True


def problem(key: str, value: str | None) -> str | None:
    """Return what is wrong with a key, with or without a value; None if nothing is."""
    kind, *path = key.split(".")
    if not path and kind in groups():
        known = {*groups()[kind], *EXAMPLE, "null", "NAME", ""}
        return None if set((value or "").split(",")) <= known else f"there is no {kind} {value}"
    if not path and kind in {field.name for field in dataclasses.fields(RunSettings)}:
        return None
    if kind == "scene" and path:
        return None if path[0] in {field.name for field in dataclasses.fields(SceneSettings)} else f"no {key}"
    if path and kind not in KINDS:
        return f"'{kind}' is no kind of plugin"
    if value is None and path and hasattr(registry.interface(kind), path[0]):
        return None  # an attribute of every plugin of the kind, such as robot.description
    kinds, path = ([kind], path) if path else (list(KINDS), [kind])
    candidates = [(each, name, cls) for each in kinds for name, cls in owners(each, path)]
    if not candidates:
        return f"no plugin has the parameter {key}"
    if value is not None and not any(takes(*candidate, path, value) for candidate in candidates):
        return f"no plugin takes {key}={value}"
    return None


@pytest.mark.parametrize("page", [case for case in pages() if case.id != "CHANGELOG.md"])
def test_inline_parameters_exist(page):
    wrong = []
    for code in inline_code(page):
        words = code.split()
        if words[0] in ("icub", "script/run", "script/test", "python", "pip", "pytest", "...") or "(" in code:
            continue
        for word in words:
            match = _ASSIGNMENT.fullmatch(word)
            if match:
                wrong.append(problem(match["key"], match["value"]))
            elif _PARAMETER.fullmatch(word) and word not in figures():
                wrong.append(problem(word, None))
    assert [text for text in wrong if text] == []


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("segmenter.lowest_score", None),
        ("pipeline.grasp.visuals", "true"),
        ("segmenter.composites", "many"),
        ("task.lift", "-1"),
        ("policy", "resprekt"),
        ("solver_", "auto"),
    ],
)
def test_a_wrong_parameter_is_noticed(key, value):
    assert problem(key, value) is not None
