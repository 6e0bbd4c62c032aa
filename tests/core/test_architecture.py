"""The rules of the layout: how large the core is, who may import whom, what is packaged, what is documented.

Every rule is a function that lists what breaks it; a second test breaks each on purpose, to prove that it goes red.
"""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import shutil
import sys
import tomllib
import typing
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import pytest

from icub_core.construct import build
from icub_core.errors import IcubError
from icub_core.kinds import KINDS
from icub_core.registry import PluginInfo
from icub_support.commands.plugins import every_plugin, markdown_table, summary

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PACKAGES = sorted(path.parent for path in ROOT.glob("*/icub_*/__init__.py")) + sorted(
    path.parent for path in ROOT.glob("plugins/*/icub_*/__init__.py")
)
NAMES = {package.name: package for package in PACKAGES}
PLUGINS = {name for name, package in NAMES.items() if package.parents[1].name == "plugins"}
CORE, SUPPORT, KIT = "icub_core", "icub_support", "icub_testing"
CONFIGURATION, BENCHMARKS = "icub_configs", "icub_benchmarks"

MAX_LINES = 5_000
"""All lines of all modules of the core, formatter on."""
MAX_CLOSURE = 8
"""Files of the core that a module of `icub_core.interfaces` stands on, itself included."""
ENGINES = {"mujoco", "pybullet", "pinocchio", "placo", "torchvision", "coacd", "trimesh", "icub_models", "robosuite"}
MAY_IMPORT = {
    CORE: set(),  # the command line finds the contract kit through an entry point: the one arrow back up
    SUPPORT: {CORE},
    KIT: {CORE, SUPPORT},
    CONFIGURATION: set(),
    **{name: {CORE, SUPPORT} for name in PLUGINS},
    "icub_pipelines": {CORE, SUPPORT, "icub_tasks"},
    BENCHMARKS: {CORE, SUPPORT, *PLUGINS},  # they measure every package's parts
}
"""Package to the other packages of this project that it may import."""
LIGHT = (
    "icub_core", "icub_core.cli", "icub_core.registry", "icub_core.kinds", "icub_core.errors", "icub_core.aliases",
    "icub_core.gymnasium_ids", "icub_core.docstrings", "icub_core.config.folders", "icub_core.commands.installed",
    "icub_support", "icub_support.commands.plugins", "icub_support.commands.completion",
)  # fmt: skip
"""Modules that start without numpy, torch and hydra."""


def _own() -> list[PluginInfo]:
    """Plugins of this project, without third parties' that happen to be installed."""
    return [plugin for plugin in every_plugin() if plugin.distribution.startswith("icub-kit ")]


def modules_of(package: Path) -> dict[str, Path]:
    """Return the file of every module of a package by its dotted name."""
    found = {}
    for file in sorted(package.rglob("*.py")):
        parts = file.relative_to(package.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


def imports(name: str, file: Path, known: Collection[str], *, at_start: bool = False) -> set[str]:
    """Return the dotted names that a module imports, in functions and for type checkers too.

    ``from a import b`` is ``a.b`` where that is one of the `known` modules, else ``a``.

    Args:
        name: Dotted name of the module.
        file: Its file.
        known: Dotted names of modules.
        at_start: Only what is imported when the module itself is.
    """
    found: set[str] = set()
    waiting: list[ast.AST] = [ast.parse(file.read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                package = name.split(".") if file.name == "__init__.py" else name.split(".")[:-1]
                base = ".".join([*package[: len(package) - node.level + 1], *base.split(".")]).rstrip(".")
            inner = {alias.name: f"{base}.{alias.name}" for alias in node.names}
            found |= {dotted if dotted in known else base for dotted in inner.values()}
        if at_start and isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            continue
        if at_start and isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            waiting += node.orelse
            continue
        waiting += ast.iter_child_nodes(node)
    return found


def graph_of(package: Path) -> dict[str, set[str]]:
    """Return every module of a package with the modules of the same package that it imports, anywhere."""
    modules = modules_of(package)
    return {name: (imports(name, file, modules) & set(modules)) - {name} for name, file in modules.items()}


def lines_of(package: Path) -> int:
    """Return how many lines all modules of a package have."""
    return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in modules_of(package).values())


def forbidden_imports(package: Path, allowed: Collection[str], forbidden: Collection[str]) -> list[str]:
    """Return ``module -> imported`` for every import that is not allowed of this project's packages and other names."""
    modules = modules_of(package)
    bad = (set(NAMES) | set(forbidden)) - {package.name, *allowed}
    return [
        f"{name} -> {target}"
        for name, file in modules.items()
        for target in sorted(imports(name, file, modules))
        if target.partition(".")[0] in bad
    ]


def circles(graph: Mapping[str, Collection[str]]) -> list[list[str]]:
    """Return the sets of modules that reach one another, each sorted."""
    reached = {name: {end for step in graph[name] for end in closure(step, graph)} for name in graph}
    found = {tuple(sorted(o for o in reached[n] if n in reached[o])) for n in graph if n in reached[n]}
    return [list(circle) for circle in sorted(found)]


def closure(name: str, graph: Mapping[str, Collection[str]]) -> set[str]:
    """Return what a module stands on, itself included."""
    found, waiting = set(), [name]
    while waiting:
        current = waiting.pop()
        if current not in found:
            found.add(current)
            waiting += graph[current]
    return found


def strings_of(file: Path) -> Iterator[tuple[int, str]]:
    """Yield line and text of every string of a module that is no docstring, pieces of f-strings included."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    bodies = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    documentation = {
        id(node.value)
        for parent in ast.walk(tree)
        if isinstance(parent, bodies)
        for node in parent.body
        if isinstance(node, ast.Expr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documentation:
            yield node.lineno, node.value


def words_of(text: str) -> set[str]:
    """Return the words of a string as names are written: letters, digits, underscores, hyphens."""
    return set("".join(c if c.isalnum() or c in "_-" else " " for c in text).split())


def named(package: Path, names: Collection[str]) -> list[str]:
    """Return ``file:line name`` for every string of a package that holds one of the names as a word."""
    return [
        f"{file.relative_to(package)}:{line} {name}"
        for file in modules_of(package).values()
        for line, text in strings_of(file)
        for name in sorted(words_of(text) & set(names))
    ]


ENGLISH = {
    "icub": "the project, its command and its own entry points",
    "main": "the function that a command is",
    "folder": "an ordinary word of messages",
    "left": "an ordinary word of messages",
    "right": "an ordinary word of messages",
}
"""Names of plugins, hands and groups that are words of their own, and what the core means by them."""


@functools.cache
def names_of_plugins() -> frozenset[str]:
    """Return what the core must not know: plugins, object sets' objects, the robots' hands, groups, frames, cameras."""
    names = {plugin.name for plugin in _own()}
    for plugin in _own():
        try:
            if plugin.kind == "objects":
                names |= set(build("objects", plugin.name).names)
            elif plugin.kind == "robot":
                about = build("robot", plugin.name).description
                names |= {*about.groups, *(camera.name for camera in about.cameras), *about.hands}
                names |= {hand.frame for hand in about.hands.values()}
        except IcubError:  # a set that needs a folder, or files that are not installed here
            continue
    return frozenset(names - set(ENGLISH))


def unresolved(cls: type) -> list[str]:
    """Return what `typing.get_type_hints` says of a class and of its public methods where it fails."""
    found = []
    # alone, without its bases: those of another library may have hints that resolve for type checkers only
    alone = type(cls.__name__, (), {"__annotations__": inspect.get_annotations(cls), "__module__": cls.__module__})
    members = [alone, *(m for n, m in vars(cls).items() if not n.startswith("_") or n == "__init__")]
    for member in members:
        member = member.fget if isinstance(member, property) else inspect.unwrap(getattr(member, "__func__", member))
        if not (inspect.isfunction(member) or inspect.isclass(member)):
            continue
        try:
            typing.get_type_hints(member, include_extras=True)
        except Exception as error:  # whatever it is, a reader of hints meets it
            found.append(f"{cls.__name__}.{getattr(member, '__name__', '?')}: {error}")
    return found


def test_the_core_is_small():
    assert lines_of(NAMES[CORE]) <= MAX_LINES


def test_more_lines_than_permitted_are_noticed(tmp_path):
    copy = shutil.copytree(NAMES[CORE], tmp_path / CORE)
    before = lines_of(copy)
    (copy / "config" / "more.py").write_text("# a line\n" * 300)
    assert lines_of(copy) == before + 300


@pytest.mark.parametrize("name", sorted(NAMES))
def test_a_package_stands_on_those_below_it_alone(name):
    forbidden = ENGINES if name == CORE else ()
    assert forbidden_imports(NAMES[name], MAY_IMPORT[name], forbidden) == []


@pytest.mark.parametrize(
    "source",
    [
        "import icub_tasks.grasping.task\n",
        "from icub_tasks.grasping import task\n",
        "def late():\n    from icub_tasks.grasping.task import GraspingTask\n",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from icub_tasks.grasping.task import GraspingTask\n",
        "def late():\n    import mujoco\n",
        "import icub_testing\n",
    ],
)
def test_an_arrow_up_or_to_an_engine_is_noticed_wherever_it_stands(tmp_path, source):
    copy = shutil.copytree(NAMES[CORE], tmp_path / CORE)
    assert forbidden_imports(copy, MAY_IMPORT[CORE], ENGINES) == []
    (copy / "config" / "wrong.py").write_text(source)
    (found,) = forbidden_imports(copy, MAY_IMPORT[CORE], ENGINES)
    assert found.startswith("icub_core.config.wrong -> ")


def test_an_arrow_between_plugin_packages_is_noticed(tmp_path):
    copy = shutil.copytree(NAMES["icub_policies"], tmp_path / "icub_policies")
    assert forbidden_imports(copy, MAY_IMPORT["icub_policies"], ()) == []
    (copy / "wrong.py").write_text("def late():\n    from icub_tasks.grasping.task import GraspingTask\n")
    assert forbidden_imports(copy, MAY_IMPORT["icub_policies"], ()) == [
        "icub_policies.wrong -> icub_tasks.grasping.task"
    ]


@pytest.mark.parametrize("name", sorted(NAMES))
def test_no_modules_stand_on_a_circle(name):
    assert circles(graph_of(NAMES[name])) == []


@pytest.mark.parametrize(
    "back",
    [
        "import package.a\n",
        "from . import a\n",
        "from .a import x\n",
        "def late():\n    from package import a\n",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from package.a import x\n",
    ],
)
def test_a_circle_is_noticed_wherever_its_arrows_stand(tmp_path, back):
    package = tmp_path / "package"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "a.py").write_text("from package.b import x\n")
    (package / "b.py").write_text("from package.c import x\n")
    (package / "c.py").write_text("")
    assert circles(graph_of(package)) == []
    (package / "c.py").write_text(back)
    assert circles(graph_of(package)) == [["package.a", "package.b", "package.c"]]


def test_the_core_names_no_plugin_object_set_or_part_of_the_icub():
    assert {"falkon", "004_sugar_box", "right_arm", "grasp"} <= names_of_plugins()
    assert named(NAMES[CORE], names_of_plugins()) == []


@pytest.mark.parametrize(
    "source",
    [
        "NAME = 'falkon'\n",
        "def f(name='falkon'):\n    return name\n",
        "def f(x):\n    return f'{x}: try +segmenter=falkon'\n",
        "TABLE = {'falkon': 1}\n",
    ],
)
def test_a_name_in_a_string_is_noticed_and_one_in_a_docstring_is_not(tmp_path, source):
    package = tmp_path / "package"
    package.mkdir()
    (package / "__init__.py").write_text('"""Such as falkon."""\n\nX = 1\n"""Of falkon."""\n')
    (package / "a.py").write_text("falkon = 'falkons'\n")
    assert named(package, ["falkon"]) == []
    (package / "a.py").write_text(source)
    assert [entry.rpartition(" ")[2] for entry in named(package, ["falkon"])] == ["falkon"]


def _interfaces() -> dict[str, Path]:
    """Return the modules that a plugin's author meets: all but the abilities that several kinds share."""
    found = {n: f for n, f in modules_of(NAMES[CORE]).items() if n.startswith("icub_core.interfaces.")}
    del found["icub_core.interfaces.abilities"]
    return found


@pytest.mark.parametrize("name", sorted(_interfaces()))
def test_an_interface_stands_on_few_files_of_the_core(name):
    """What a package's own ``__init__`` runs is left out: it holds no knowledge that an interface needs."""
    reached = closure(name, graph_of(NAMES[CORE]))
    assert len(reached) <= MAX_CLOSURE, sorted(reached)


def test_no_interface_stands_on_the_abilities():
    graph = graph_of(NAMES[CORE])
    assert [name for name in _interfaces() if "icub_core.interfaces.abilities" in closure(name, graph)] == []


def test_an_interface_that_stands_on_much_is_noticed(tmp_path):
    copy = shutil.copytree(NAMES[CORE], tmp_path / CORE)
    (copy / "interfaces" / "wide.py").write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from icub_core.config.assembly import Assembly\n"
    )
    assert len(closure("icub_core.interfaces.wide", graph_of(copy))) > MAX_CLOSURE


@pytest.mark.parametrize("name", sorted(["icub_core.interfaces.abilities", *_interfaces()]))
def test_every_type_of_an_interface_resolves(name):
    module = importlib.import_module(name)
    classes = [c for c in vars(module).values() if inspect.isclass(c) and c.__module__ == name]
    assert classes or name == "icub_core.interfaces"
    assert [problem for cls in classes for problem in unresolved(cls)] == []


def test_a_type_that_does_not_resolve_is_noticed():
    class Wrong:
        def act(self, observation: Nowhere): ...  # noqa: F821

    class WrongProperty:
        @property
        def size(self) -> Nowhere: ...  # noqa: F821

    assert unresolved(Wrong) == ["Wrong.act: name 'Nowhere' is not defined"]
    assert unresolved(WrongProperty) == ["WrongProperty.size: name 'Nowhere' is not defined"]


def test_every_package_ships_its_types():
    assert [package.name for package in PACKAGES if not (package / "py.typed").exists()] == []


def test_nothing_but_the_standard_library_starts_the_command():
    files = modules_of(NAMES[CORE]) | modules_of(NAMES[SUPPORT])
    for name in LIGHT:
        found = imports(name, files[name], files, at_start=True)
        others = {target for target in found if target.partition(".")[0] not in sys.stdlib_module_names}
        assert others <= set(LIGHT), name


def test_pyproject_names_exactly_the_packages_of_the_tree():
    build = PROJECT["tool"]["hatch"]["build"]
    assert sorted(build["targets"]["wheel"]["packages"]) == sorted(str(p.relative_to(ROOT)) for p in PACKAGES)
    assert sorted(build["dev-mode-dirs"]) == sorted({str(p.parent.relative_to(ROOT)) for p in PACKAGES})
    assert sorted(PROJECT["tool"]["mypy"]["packages"]) == sorted(NAMES)
    assert set(PROJECT["tool"]["mypy"]["mypy_path"].split(":")) == set(build["dev-mode-dirs"])


def _defined(module: str, name: str = "") -> bool:
    """Return True if a module of the tree exists, and defines a class or function of that name."""
    package, *rest = module.split(".")
    base = NAMES[package].joinpath(*rest)
    file = base.with_suffix(".py") if base.with_suffix(".py").is_file() else base / "__init__.py"
    if not file.is_file():
        return False
    tree = ast.parse(file.read_text())
    return not name or name in {n.name for n in tree.body if isinstance(n, (ast.ClassDef, ast.FunctionDef))}


def test_entry_points_are_of_known_groups_and_lead_into_the_tree():
    groups = dict(PROJECT["project"]["entry-points"])
    assert _defined(groups.pop("icub.configs")["icub"])
    for old, new in {**groups.pop("icub.alias"), **groups.pop("icub.alias.permanent", {})}.items():
        assert _defined(new), f"{old}: {new}"
        assert old.startswith(f"{CORE}."), f"{old} is no name of before"
        assert not _defined(old), f"{old} is still there"
    for name in groups["icub.train"]:
        kind, _, plugin = name.partition(".")
        assert plugin in groups[KINDS[kind].entry_point_group], name
    known = {kind.entry_point_group for kind in KINDS.values()}
    others = {"hooks", "gymnasium", "benchmark", "train", "command", "contract_kit"}
    assert set(groups) <= known | {f"icub.{name}" for name in others}
    for group, entries in groups.items():
        for name, target in entries.items():
            module, _, inner = target.partition(":")
            assert _defined(module, inner.partition(".")[0]), f"{group} {name}: {target}"


def test_what_is_installed_is_what_pyproject_says():
    """Fails after an entry point was added: an editable installation learns of it by installing again."""
    groups = PROJECT["project"]["entry-points"]
    for kind in KINDS.values():
        assert {p.name for p in _own() if p.kind == kind.name} == set(groups.get(kind.entry_point_group, {}))


def _public(module: Path):
    """Yield every public module, class, function and method without a docstring."""
    tree = ast.parse(module.read_text(encoding="utf-8"))
    if not ast.get_docstring(tree):
        yield "module"
    waiting = [(node, "") for node in tree.body]
    while waiting:
        node, path = waiting.pop()
        if not isinstance(node, (ast.ClassDef, ast.FunctionDef)) or node.name.startswith("_"):
            continue
        marks = {ast.unparse(mark).rpartition(".")[2] for mark in node.decorator_list}
        if not ast.get_docstring(node) and not marks & {"overload", "override"}:
            yield path + node.name
        if isinstance(node, ast.ClassDef):
            waiting += [(child, f"{path}{node.name}.") for child in node.body]


@pytest.mark.parametrize("name", sorted(NAMES))
def test_everything_public_is_documented(name):
    missing = {str(m.relative_to(ROOT)): list(_public(m)) for m in modules_of(NAMES[name]).values()}
    assert {module: names for module, names in missing.items() if names} == {}


def test_every_plugin_says_what_it_is_in_its_first_line():
    assert [f"{plugin.kind} {plugin.name}" for plugin in _own() if not summary(plugin)] == []


def test_the_readme_lists_the_plugins_that_exist():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    begin, end = "<!-- plugins:begin -->", "<!-- plugins:end -->"
    assert begin in text
    assert end in text
    assert text.partition(begin)[2].partition(end)[0].strip() == markdown_table(_own()).strip(), (
        "the table in README.md is old; put the output of `icub plugins list --markdown` between its markers"
    )
