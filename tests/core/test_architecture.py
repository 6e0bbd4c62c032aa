"""The rules of the layout: who may import whom, what is packaged, what is documented."""

import ast
import sys
import tomllib
from pathlib import Path

import pytest

from icub_core.commands.plugins import every_plugin, markdown_table, summary
from icub_core.kinds import KINDS
from icub_core.registry import PluginInfo

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PACKAGES = sorted(path.parent for path in ROOT.glob("*/icub_*/__init__.py")) + sorted(
    path.parent for path in ROOT.glob("plugins/*/icub_*/__init__.py")
)
NAMES = {package.name: package for package in PACKAGES}
ENGINES = {"mujoco", "pybullet", "pinocchio", "placo", "torchvision", "coacd", "trimesh", "icub_models", "robosuite"}
CONFIGURATION = "icub_configs"
LIGHT = (
    "__init__.py", "cli.py", "registry.py", "kinds.py", "errors.py", "commands/plugins.py", "commands/completion.py",
    "config/folders.py",
)  # fmt: skip
"""Modules of the core that start without numpy, torch and hydra."""


def _own() -> list[PluginInfo]:
    """Plugins of this project, without third parties' that happen to be installed."""
    return [plugin for plugin in every_plugin() if plugin.distribution.startswith("icub-kit ")]


def _modules(package: Path) -> list[Path]:
    return sorted(package.rglob("*.py"))


def _imports(module: Path, everywhere: bool) -> set[str]:
    """Return the top-level names that a module imports: when it is imported itself, or `everywhere`."""
    tree = ast.parse(module.read_text(encoding="utf-8"))
    found = set()
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module.partition(".")[0])
        if not everywhere and isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            waiting += node.orelse
            continue
        waiting += ast.iter_child_nodes(node)
    return found


def test_there_are_eight_packages_with_types():
    assert len(PACKAGES) == 8
    assert [package.name for package in PACKAGES if not (package / "py.typed").exists()] == []


def test_the_core_imports_no_plugin_and_no_engine():
    plugins = set(NAMES) - {"icub_core", CONFIGURATION}
    for module in _modules(NAMES["icub_core"]):
        assert not _imports(module, everywhere=True) & plugins, module
        assert not _imports(module, everywhere=False) & ENGINES, module


@pytest.mark.parametrize("name", sorted(set(NAMES) - {"icub_core"}))
def test_a_plugin_package_imports_no_other_plugin_package(name):
    others = set(NAMES) - {"icub_core", name}
    for module in _modules(NAMES[name]):
        assert not _imports(module, everywhere=True) & others, module


def test_nothing_but_the_standard_library_starts_the_command():
    allowed = sys.stdlib_module_names | {"icub_core"}
    for name in LIGHT:
        module = NAMES["icub_core"] / name
        assert _imports(module, everywhere=False) <= allowed, module


def test_pyproject_names_exactly_the_packages_of_the_tree():
    build = PROJECT["tool"]["hatch"]["build"]
    assert sorted(build["targets"]["wheel"]["packages"]) == sorted(str(p.relative_to(ROOT)) for p in PACKAGES)
    assert sorted(build["dev-mode-dirs"]) == sorted(str(p.parent.relative_to(ROOT)) for p in PACKAGES)
    assert sorted(PROJECT["tool"]["mypy"]["packages"]) == sorted(NAMES)
    assert set(PROJECT["tool"]["mypy"]["mypy_path"].split(":")) == set(build["dev-mode-dirs"])


def test_entry_points_are_of_known_kinds_and_lead_to_classes_in_the_tree():
    groups = PROJECT["project"]["entry-points"]
    known = {kind.entry_point_group for kind in KINDS.values()} | {
        "icub.configs",
        "icub.hooks",
        "icub.benchmark",
        "icub.train",
    }
    assert set(groups) <= known
    for group, entries in groups.items():
        if group == "icub.configs":
            continue
        for name, target in entries.items():
            module, _, cls = target.partition(":")
            package, *rest = module.split(".")
            base = NAMES[package].joinpath(*rest)
            file = base.with_suffix(".py") if base.with_suffix(".py").is_file() else base / "__init__.py"
            assert file.is_file(), f"{group} {name}: {target}"
            made = (ast.ClassDef, ast.FunctionDef)
            names = {node.name for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, made)}
            assert cls.partition(".")[0] in names, f"{group} {name}: {target}"


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
    missing = {str(m.relative_to(ROOT)): list(_public(m)) for m in _modules(NAMES[name])}
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
