"""Inline code such as `segmenter.masks=combined` or `mode=faithful` names a parameter that takes this value."""

import dataclasses
import re
import typing
from typing import Any

import pytest
import yaml

from icub_core import registry
from icub_core.config.folders import TYPED_GROUPS, groups
from icub_core.config.schema import restore, signature
from icub_core.config.settings import RunSettings, typed_group_node
from icub_core.kinds import KINDS
from tests.docs.pages import EXAMPLE, inline_code, pages

_ASSIGNMENT = re.compile(r"[+~]*(?P<key>[a-z]\w*(?:\.\w+)*)=(?P<value>\S+)")
_PARAMETER = re.compile(rf"(?:{'|'.join(KINDS)})(?:\.[a-z]\w*)+")


def annotations(kind: str, path: list[str]) -> list[Any]:
    """Return the annotation that a path such as ``grasp.visual`` has in each plugin of a kind that knows it."""
    found = []
    for name in registry.available(kind):
        cls = registry.load(kind, name)
        known = {key: parameter.annotation for key, parameter in signature(kind, name, cls).parameters.items()}
        for step in path[:-1]:
            inner = known.get(step)
            known = typing.get_type_hints(inner, include_extras=True) if dataclasses.is_dataclass(inner) else {}
        if path[-1] in known:
            found.append(known[path[-1]])
    return found


def takes(annotation: Any, value: str) -> bool:
    if re.search(r"[A-Z]{2}", value):  # stands for the reader's own, such as FOLDER
        return True
    try:
        restore(yaml.safe_load(value), annotation)
    except TypeError:
        return False
    return True


def is_attribute(kind: str, path: list[str]) -> bool:
    """Return True for what the kind's interface declares, such as `robot.description` and what lies behind it."""
    return hasattr(registry.interface(kind), path[0])


def problem(key: str, value: str | None) -> str | None:
    """Return what is wrong with a key, with or without a value; None if nothing is."""
    kind, *path = key.split(".")
    if not path:
        if kind in groups():
            values = re.split(r"[,_]", value) if kind == "budget" else (value or "").split(",")
            known = {*groups()[kind], *EXAMPLE, "null", "NAME", ""}
            return None if kind not in KINDS or set(values) <= known else f"there is no {kind} {value}"
        if kind in {field.name for field in dataclasses.fields(RunSettings)}:
            return None
        candidates = [found for each in KINDS for found in annotations(each, [kind])]
    elif kind in KINDS:
        if value is None and is_attribute(kind, path):
            return None
        candidates = annotations(kind, path)
    elif any(group == kind for group, _ in TYPED_GROUPS):
        nodes = [typed_group_node(group, option) for group, option in TYPED_GROUPS if group == kind]
        return None if any(path[0] in node for node in nodes if node is not None) else f"{kind} has no {path[0]}"
    else:
        return f"'{kind}' is no kind of plugin"
    if not candidates:
        return f"no plugin has the parameter {key}"
    if value is not None and not any(takes(annotation, value) for annotation in candidates):
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
            elif _PARAMETER.fullmatch(word):
                wrong.append(problem(word, None))
    assert [text for text in wrong if text] == []


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("segmenter.lowest_score", None),
        ("pipeline.grasp.visuals", "true"),
        ("segmenter.composites", "many"),
        ("policy", "resprekt"),
        ("solver_", "auto"),
    ],
)
def test_a_wrong_parameter_is_noticed(key, value):
    assert problem(key, value) is not None
