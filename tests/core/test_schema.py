"""A constructor's signature is its configuration: types are checked, dependencies are told apart."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Optional

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from icub_core.config.schema import signature, typed_node
from icub_core.construct import checked_parameters, constructor_arguments
from icub_core.errors import ConfigError, PluginError

if TYPE_CHECKING:
    from icub_core.interfaces.robot import Robot


class Mode(Enum):
    fast = 1
    exact = 2


class Encoder(ABC):
    @abstractmethod
    def encode(self): ...


class Plugin:
    def __init__(
        self,
        feature_extractor,
        count: int = 3,
        rate: float = 0.5,
        flag: bool = False,
        path: Path = Path("x"),
        mode: Mode = Mode.fast,
        label: Optional[str] = None,  # noqa: UP045  # both spellings must work
        pair: tuple[float, float] = (1.0, 2.0),
        names: tuple[str, ...] = (),
        corners: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (1.0, 1.0)),
        weights: list[float] = [1.0],  # noqa: B006  # a plugin may do this
        table: dict[str, float] = {},  # noqa: B006
        size: float | None = None,
        callback: Callable[[int], None] | None = None,
        encoder: Encoder | None = None,
        robot: "Robot | None" = None,
    ):
        self.arguments = {key: value for key, value in locals().items() if key != "self"}


def _arguments(**values):
    return constructor_arguments("segmenter", "plugin", Plugin, values, {"feature_extractor": object()})


def test_kinds_callables_and_abstract_classes_are_dependencies():
    found = signature("segmenter", "plugin", Plugin)
    assert set(found.dependencies) == {"feature_extractor", "callback", "encoder", "robot"}
    assert [key for key, d in found.dependencies.items() if d.required] == ["feature_extractor"]
    assert "plugin" not in found.parameters


def test_defaults_arrive_as_they_were_written():
    built = Plugin(**_arguments())
    for key, parameter in signature("segmenter", "plugin", Plugin).parameters.items():
        assert built.arguments[key] == parameter.default, key
        assert type(built.arguments[key]) is type(parameter.default), key


@pytest.mark.parametrize(
    ("given_", "arrives"),
    [
        ({"count": "7"}, {"count": 7}),
        ({"rate": 2}, {"rate": 2.0}),
        ({"flag": "true"}, {"flag": True}),
        ({"path": "a/b"}, {"path": Path("a/b")}),
        ({"mode": "exact"}, {"mode": Mode.exact}),
        ({"label": "x"}, {"label": "x"}),
        ({"pair": [3, 4]}, {"pair": (3.0, 4.0)}),
        ({"names": ["a", "b"]}, {"names": ("a", "b")}),
        ({"corners": [[1, 2], [3, 4]]}, {"corners": ((1.0, 2.0), (3.0, 4.0))}),
        ({"weights": [1, 2]}, {"weights": [1.0, 2.0]}),
        ({"table": {"a": 1}}, {"table": {"a": 1.0}}),
        ({"size": 3}, {"size": 3.0}),
        ({"size": None}, {"size": None}),
    ],
)
def test_values_take_the_type_of_their_parameter(given_, arrives):
    arguments = _arguments(**given_)
    for key, value in arrives.items():
        assert arguments[key] == value
        assert type(arguments[key]) is type(value)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"count": "many"}, "int"),
        ({"count": 1.5}, "int"),
        ({"rate": "fast"}, "float"),
        ({"rate": None}, "float"),
        ({"flag": "perhaps"}, "bool"),
        ({"mode": "slow"}, r"Mode \(fast, exact\)"),
        ({"pair": [1.0]}, r"tuple\[float, float\]"),
        ({"pair": ["a", "b"]}, r"tuple\[float, float\]"),
        ({"names": [1, 2]}, r"tuple\[str, \.\.\.\]"),
        ({"corners": [[1, 2], [3]]}, "tuple"),
        ({"weights": ["a"]}, r"list\[float\]"),
        ({"table": {"a": "b"}}, r"dict\[str, float\]"),
    ],
)
def test_a_wrong_type_is_refused_with_the_right_one(values, expected):
    (key,) = values
    with pytest.raises(ConfigError, match=rf"segmenter\.{key}=.* has the wrong type; expected .*{expected}"):
        _arguments(**values)


def test_an_unknown_parameter_names_the_nearest_and_all():
    with pytest.raises(ConfigError, match=r"has no parameter 'cuont'\. Did you mean 'count'\? Known: count, rate"):
        _arguments(cuont=3)


def test_a_dependency_is_no_setting():
    with pytest.raises(ConfigError, match="is an object, not a setting; choose it with feature_extractor=NAME"):
        _arguments(feature_extractor="compact")


def test_a_required_parameter_must_be_given():
    class Needs:
        def __init__(self, root: Path): ...

    with pytest.raises(ConfigError, match=r"dataset 'needs' needs the parameter 'root'; add dataset\.root=VALUE"):
        checked_parameters("dataset", "needs", Needs, {})
    assert checked_parameters("dataset", "needs", Needs, {"root": "a"}) == {"root": Path("a")}


@pytest.mark.parametrize("annotation", [Sequence[int], np.ndarray, set, bytes])
def test_types_that_no_configuration_can_hold_are_refused(annotation):
    class Odd:
        def __init__(self, value: annotation): ...

    with pytest.raises(PluginError, match="'value' of policy 'odd' has type .*, which no configuration can hold"):
        signature("policy", "odd", Odd)


def test_open_ended_arguments_are_refused():
    class Open:
        def __init__(self, **options: int): ...

    with pytest.raises(PluginError, match=r"takes '\*\*options: int'; expected named parameters only"):
        signature("policy", "open", Open)


def test_a_default_that_does_not_fit_its_type_is_the_plugins_fault():
    class Misfit:
        def __init__(self, count: int = "three"): ...  # type: ignore[assignment]

    with pytest.raises(PluginError, match="the defaults of policy 'misfit' do not fit their own types"):
        checked_parameters("policy", "misfit", Misfit, {})


def test_a_class_without_a_constructor_has_no_parameters():
    class Bare:
        pass

    assert constructor_arguments("policy", "bare", Bare, {}, {}) == {}


def test_mutable_defaults_are_not_shared_between_nodes():
    first, second = (typed_node("segmenter", "plugin", Plugin) for _ in range(2))
    first.weights.append(9.0)
    assert second.weights == [1.0]


@settings(deadline=None, max_examples=50)
@given(
    count=st.integers(-(2**40), 2**40),
    rate=st.floats(allow_nan=False, allow_infinity=False),
    names=st.lists(
        st.text(st.characters(exclude_characters="${}\\", exclude_categories=["Cs"]), max_size=8), max_size=4
    ),
    pair=st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)),
)
def test_values_of_the_right_type_arrive_unchanged(count, rate, names, pair):
    arguments = _arguments(count=count, rate=rate, names=names, pair=list(pair))
    assert arguments["count"] == count
    assert arguments["rate"] == rate
    assert arguments["names"] == tuple(names)
    assert arguments["pair"] == pair
