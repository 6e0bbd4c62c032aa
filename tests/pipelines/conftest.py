"""The tiny plugins as an installed distribution, for runs that take a second."""

import importlib
import logging

import pytest

from icub_core import registry
from icub_testing.tiny import TINY


@pytest.fixture
def tiny_world(tmp_path, monkeypatch):
    """Install the tiny plugins, work in an empty folder, and return the words that choose them."""
    folder = tmp_path / "site"
    info = folder / "tiny-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: tiny\nVersion: 1.0\n")
    points = "".join(f"[icub.{kind}]\ntiny = {target}\n" for kind, target in TINY.items())
    (info / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.chdir(tmp_path)
    importlib.invalidate_caches()
    registry.rescan()
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield [f"{kind}=tiny" for kind in ("robot", "simulator", "objects", "grasp_generator", "policy")]
    root.handlers[:], root.level = handlers, level
    monkeypatch.undo()
    registry.rescan()
