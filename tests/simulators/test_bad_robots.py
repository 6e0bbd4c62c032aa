"""A robot description that does not fit its files is one clear line, in either engine."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from icub_core.errors import SimulationError
from icub_core.scene import Scene


def refused(engine, description, drawn: bool = False) -> str:
    def use() -> None:
        engine.load(description, Scene())
        if drawn:
            engine.render("head_cam", 32, 24)

    with pytest.raises(SimulationError) as caught:
        use()
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_a_missing_mesh_is_named(engine, icub, tmp_path):
    """At the latest when it is drawn: MuJoCo's physics reads no mesh that does not collide."""
    text = Path(icub.description.urdf).read_text()
    mesh = re.search(r'filename="([^"]+)"', text)[1]
    (tmp_path / "robot.urdf").write_text(text.replace(mesh, "/nowhere/lost.stl"))
    message = refused(engine, replace(icub.description, urdf=tmp_path / "robot.urdf"), drawn=True)
    assert "/nowhere/lost.stl" in message


def test_a_joint_that_does_not_exist_is_named(engine, icub):
    names = ("ghost_joint", *icub.description.joint_names[1:])
    message = refused(engine, replace(icub.description, joint_names=names))
    assert "'ghost_joint'" in message
    assert "icub" in message


def test_half_a_file_is_named(engine, icub, tmp_path):
    text = Path(icub.description.urdf).read_text()
    (tmp_path / "half.urdf").write_text(text[: len(text) // 2])
    assert "half.urdf" in refused(engine, replace(icub.description, urdf=tmp_path / "half.urdf"))
