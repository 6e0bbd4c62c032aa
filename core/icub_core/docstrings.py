"""First lines of docstrings, read from source files: listings say what things are without importing them."""

from __future__ import annotations

import ast
from importlib.util import find_spec
from pathlib import Path


def first_line(target: str) -> str:
    """Return the first line of what ``module:name`` documents, without its full stop; "" where there is none."""
    module, _, name = target.partition(":")
    file = _source(module)
    if file is None:
        return ""
    try:
        nodes = ast.parse(file.read_text(encoding="utf-8")).body
    except (OSError, SyntaxError, ValueError):
        return ""
    documented = (ast.ClassDef, ast.FunctionDef)
    text = next((ast.get_docstring(node) for node in nodes if isinstance(node, documented) and node.name == name), "")
    return (text or "").partition("\n")[0].strip().rstrip(".")


def _source(module: str) -> Path | None:
    """Find a module's file from its top-level name alone: `find_spec` of a submodule would import its parents."""
    top, *rest = module.split(".")
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):
        return None
    if spec is None:
        return None
    if not spec.submodule_search_locations:
        return Path(spec.origin) if spec.origin and not rest else None
    for place in spec.submodule_search_locations:
        base = Path(place, *rest)
        for file in (base.with_suffix(".py"), base / "__init__.py"):
            if file.is_file():
                return file
    return None
