"""Examples are used from the checkout as if they were installed: their own metadata, put on the path."""

from __future__ import annotations

import importlib
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from icub_core import registry

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture(scope="session")
def announce(tmp_path_factory) -> Iterator[Callable[[str], Path]]:
    """Return ``announce(example)``, which makes the plugins of an example known and returns its folder."""
    with pytest.MonkeyPatch.context() as patch:

        def _announce(example: str) -> Path:
            folder = EXAMPLES / example
            project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
            site = tmp_path_factory.mktemp("site")
            info = site / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
            info.mkdir()
            (info / "METADATA").write_text(
                f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
            )
            sections = [
                f"[{group}]\n" + "".join(f"{name} = {target}\n" for name, target in entries.items())
                for group, entries in project["entry-points"].items()
            ]
            (info / "entry_points.txt").write_text("\n".join(sections))
            for path in (folder, site):
                patch.syspath_prepend(str(path))
            importlib.invalidate_caches()
            registry.rescan()
            return folder

        yield _announce
    registry.rescan()
