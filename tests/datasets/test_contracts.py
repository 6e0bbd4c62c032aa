"""Every dataset plugin keeps the contract of its kind, and its constructor is a valid configuration."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from icub_core.construct import constructor_arguments
from icub_datasets.coco import Coco
from icub_datasets.ho3d import SEQUENCES, Ho3d
from icub_datasets.image_folder import ImageFolder
from icub_datasets.rendered.handheld import RenderedHandheld
from icub_datasets.rendered.tabletop import RenderedTabletop
from icub_datasets.ycb_video import YcbVideo
from icub_testing.contracts import DatasetContract

_spec = importlib.util.spec_from_file_location("dataset_layouts", Path(__file__).parent / "layouts.py")
layouts = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(layouts)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One folder with a small copy of every set, and the cache of the rendered ones."""
    root = tmp_path_factory.mktemp("sets")
    layouts.write_ycb_video(root / "ycb_video")
    layouts.write_image_folder(root / "image_folder")
    (root / "coco").mkdir()
    layouts.write_coco(root / "coco")
    for name in SEQUENCES["test"]:
        layouts.write_ho3d_sequence(root / "ho3d" / "train" / name, 3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ICUB_CACHE", str(root / "cache"))
        yield root


class TestYcbVideo(DatasetContract):
    @pytest.fixture
    def make_plugin(self, folder):
        return lambda: YcbVideo(path=folder / "ycb_video", split="test")


class TestHo3d(DatasetContract):
    @pytest.fixture
    def make_plugin(self, folder):
        return lambda: Ho3d(path=folder / "ho3d", split="test")


class TestCoco(DatasetContract):
    @pytest.fixture
    def make_plugin(self, folder):
        return lambda: Coco(path=folder / "coco")


class TestImageFolder(DatasetContract):
    @pytest.fixture
    def make_plugin(self, folder):
        return lambda: ImageFolder(path=folder / "image_folder")


class TestRenderedTabletop(DatasetContract):
    @pytest.fixture
    def make_plugin(self, folder):
        return lambda: RenderedTabletop(frames=4, width=96, height=72)


class TestRenderedHandheld(DatasetContract):
    @pytest.fixture
    def make_plugin(self, folder):
        return lambda: RenderedHandheld(frames=2, width=96, height=72)


@pytest.mark.parametrize("cls", [YcbVideo, Ho3d, Coco, ImageFolder, RenderedTabletop, RenderedHandheld])
def test_constructors_are_configurations(cls):
    given = {"frames": 5} if cls in (RenderedTabletop, RenderedHandheld) else {"path": "somewhere"}
    arguments = constructor_arguments("dataset", cls.__name__, cls, given, {})
    assert arguments["split"]
    if "path" in given:
        assert arguments["path"] == Path("somewhere")
        assert arguments["on_error"] == "refuse"
