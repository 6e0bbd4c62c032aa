"""Installs throw-away distributions: metadata and modules in a folder that is put on the path."""

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from icub_core import registry
from icub_core.config.folders import config_folders

Install = Callable[..., Path]


def _forget() -> None:
    importlib.invalidate_caches()
    registry.rescan()
    config_folders.cache_clear()


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Return ``install(name, entry_points={group: {name: target}}, files={path: text})``, which returns the folder."""
    before = set(sys.modules)

    def _install(name: str, entry_points: dict[str, dict[str, str]], files: dict[str, str] | None = None) -> Path:
        folder = tmp_path / "site" / name
        info = folder / f"{name.replace('-', '_')}-1.0.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        sections = [
            f"[{group}]\n" + "".join(f"{key} = {target}\n" for key, target in entries.items())
            for group, entries in entry_points.items()
        ]
        (info / "entry_points.txt").write_text("\n".join(sections))
        for path, text in (files or {}).items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(text)
        monkeypatch.syspath_prepend(str(folder))
        _forget()
        return folder

    yield _install
    monkeypatch.undo()
    for module in set(sys.modules) - before:  # a module of the same name must not be found again by the next test
        if str(tmp_path) in str(getattr(sys.modules[module], "__file__", "")):
            del sys.modules[module]
    _forget()
