"""Meshes of another icub-models installation for the hands, with a small stand-in for that installation."""

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from icub_core.errors import DataError
from icub_robots import models
from icub_robots.description import describe

COLLADA = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>
  <library_geometries><geometry id="g"><mesh>
    <source id="p"><float_array id="a" count="12">0 0 0 0.02 0 0 0 0.03 0 0 0 0.04</float_array>
      <technique_common><accessor source="#a" count="4" stride="3">
        <param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
      </accessor></technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
    <triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/>
      <p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"/></node></visual_scene>
  </library_visual_scenes>
  <scene><instance_visual_scene url="#s"/></scene>
</COLLADA>
"""
LINK = """<link name="{name}"><visual><origin xyz="0.001 0 0" rpy="0 0 0"/><geometry>
<mesh filename="package://iCub/meshes/tetra.dae" scale="1 1 1"/></geometry></visual>
<collision><max_contacts>1</max_contacts><origin xyz="0 0 0.002" rpy="0 0 0"/><geometry>
<mesh filename="package://iCub/meshes/tetra.dae" scale="1 1 1"/></geometry></collision></link>"""


@pytest.fixture
def installation(tmp_path, monkeypatch):
    share = tmp_path / "share" / "iCub"
    (share / "robots" / models.HAND_MODEL).mkdir(parents=True)
    (share / "meshes").mkdir()
    links = "".join(LINK.format(name=name) for name in ("r_hand", "r_hand_index_1"))
    (share / "robots" / models.HAND_MODEL / "model.urdf").write_text(f"<robot name='x'>{links}</robot>")
    (share / "meshes" / "tetra.dae").write_text(COLLADA)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return share


@pytest.mark.parametrize(
    ("variable", "ending"),
    [("GAZEBO_MODEL_PATH", "robots"), ("YARP_DATA_DIRS", "."), ("ROS_PACKAGE_PATH", "..")],
)
def test_hands_take_the_meshes_of_a_full_installation(installation, monkeypatch, variable, ending):
    monkeypatch.setenv(variable, f"/nowhere:{installation / ending}")
    d = describe(model=models.HAND_MODEL)
    root = ET.parse(d.urdf).getroot()
    links = {link.get("name"): link for link in root.findall("link")}
    for name in ("r_hand", "r_hand_index_1"):
        assert len(links[name].findall("visual")) == len(links[name].findall("collision")) == 1
        assert name not in d.capsule_links
    assert "r_hand_index_2" in d.capsule_links  # not in the stand-in: keeps its capsule
    mesh = links["r_hand_index_1"].find("collision/geometry/mesh")
    converted = trimesh.load(mesh.get("filename"))
    assert np.allclose(converted.bounds, [[0, 0, 0], [0.02, 0.03, 0.04]], atol=1e-7)
    assert converted.volume == pytest.approx(0.02 * 0.03 * 0.04 / 6, rel=1e-5)
    plain = describe()
    assert d.joint_names == plain.joint_names
    assert pin.buildModelFromUrdf(str(d.urdf)).nq == len(d.joint_names)


def test_without_it_one_line_says_what_is_missing(monkeypatch):
    for variable in models.SEARCH_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    if models._packaged(models.HAND_MODEL) is not None:
        pytest.skip("a full icub-models is installed here")
    with pytest.raises(DataError, match="'iCubGazeboV2_5_visuomanip' is not installed.*GAZEBO_MODEL_PATH"):
        describe(model=models.HAND_MODEL)


def test_a_missing_or_broken_mesh_is_named(installation, monkeypatch):
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(installation / "robots"))
    (installation / "meshes" / "tetra.dae").write_text("<COLLADA>")
    with pytest.raises(DataError, match=r"tetra\.dae cannot be read"):
        describe(model=models.HAND_MODEL)
    (installation / "meshes" / "tetra.dae").unlink()
    with pytest.raises(DataError, match=r"tetra\.dae .* is missing"):
        describe(model=models.HAND_MODEL)
