"""The contract of every kind as plain functions, one property each; no test framework is needed to run them.

    from icub_testing.checks import run_checks
    for result in run_checks("segmenter", MySegmenter):
        print(result.name, result.problem or "ok")

A check takes a factory without arguments and builds fresh plugins and fresh data, so that no check sees what another
one did. It raises `ContractError` with what was expected and what was got.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import perf_counter
from typing import Any

from icub_core.errors import ContractError, IcubError
from icub_core.kinds import get_kind
from icub_core.registry import interface

Make = Callable[[], Any]
Check = Callable[[Make], None]


@dataclass(frozen=True)
class CheckResult:
    """Outcome of one check; `problem` is empty when the contract is kept."""

    name: str
    summary: str
    seconds: float
    problem: str = ""


def checks(kind: str) -> dict[str, Check]:
    """Return every check of a kind by name: those all plugins share, then the kind's own."""
    module = importlib.import_module(f"icub_testing.checks_{get_kind(kind).name}")
    own = {name: check for name, check in vars(module).items() if _is_check(name, check, module.__name__)}
    return {"check_interface": _interface_check(kind), "check_signature": _signature_check(kind), **own}


def run_checks(kind: str, make: Make) -> Iterator[CheckResult]:
    """Run every check of a kind on the plugins that `make` builds, one after the other."""
    for name, check in checks(kind).items():
        start = perf_counter()
        problem = ""
        try:
            check(make)
        except ContractError as error:
            problem = str(error)
        except Exception as error:  # whatever a plugin raises where it should not is a broken contract
            problem = f"raised {type(error).__name__}: {error}" if not isinstance(error, IcubError) else str(error)
        yield CheckResult(name, summary(check), perf_counter() - start, " ".join(problem.split()))


def summary(check: Check) -> str:
    """Return the sentence that a check's docstring begins with."""
    return (inspect.getdoc(check) or "").strip().splitlines()[0].rstrip(".")


def _is_check(name: str, check: object, module: str) -> bool:
    return name.startswith("check_") and inspect.isfunction(check) and check.__module__ == module


def _interface_check(kind: str) -> Check:
    def check_interface(make: Make) -> None:
        """It is an instance of its kind's interface."""
        plugin = make()
        if not isinstance(plugin, interface(kind)):
            raise ContractError(f"expected a subclass of {interface(kind).__name__}; got {type(plugin).__name__}")

    return check_interface


def _signature_check(kind: str) -> Check:
    def check_signature(make: Make) -> None:
        """Its constructor's signature is a configuration: simple types and defaults that fit them."""
        from icub_core.config.schema import signature
        from icub_core.construct import checked_parameters

        cls = type(make())
        wanted = signature(kind, cls.__name__, cls)
        given = {key for key, parameter in wanted.parameters.items() if parameter.required}
        if not given:
            checked_parameters(kind, cls.__name__, cls, {})

    return check_signature
