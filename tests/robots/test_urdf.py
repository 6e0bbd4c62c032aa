"""One URDF for all loaders: regenerated identically, never half written, and read alike by four engines."""

import multiprocessing
import os
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pytest

from icub_core.errors import DataError
from icub_robots import models, urdf
from icub_robots.description import describe
from icub_robots.icub import ICub
from icub_support.cache import cached_text

FRAMES = ("r_hand_dh_frame", "r_hand_thumb_3", "r_hand_index_3", "r_hand_little_tip", "head", "chest", "r_forearm")


def random_q(description, rng):
    return rng.uniform(description.lower, description.upper)


def test_regeneration_is_identical(tmp_path, monkeypatch):
    first = describe().urdf
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    second = describe().urdf
    assert first != second
    assert first.name == second.name
    assert first.read_bytes() == second.read_bytes()


def test_options_do_not_share_a_file():
    assert len({describe(h, w).urdf for h in [("right",), ("left",)] for w in ("ikin", "urdf")}) == 4


def test_a_damaged_cache_file_is_written_again(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    path = describe().urdf
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert describe().urdf.read_bytes() == whole


def _write(folder: str, text: str) -> None:
    os.environ["XDG_CACHE_HOME"] = folder
    for _ in range(20):
        cached_text("x", text, ".txt")


def test_concurrent_writers_leave_one_whole_file(tmp_path):
    text = "line\n" * 100_000
    context = multiprocessing.get_context("fork")
    writers = [context.Process(target=_write, args=(str(tmp_path), text)) for _ in range(4)]
    for writer in writers:
        writer.start()
    seen = 0
    while any(writer.is_alive() for writer in writers):
        for path in (tmp_path / "icub-kit" / "x").glob("*.txt"):
            assert path.read_text() == text  # whatever has the final name is whole
            seen += 1
    assert all(writer.exitcode == 0 for writer in writers)
    assert [p.read_text() for p in (tmp_path / "icub-kit" / "x").iterdir()] == [text]


def test_a_failed_write_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def full_disk(source, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full_disk)
    with pytest.raises(DataError, match="No space left on device"):
        cached_text("x", "text", ".txt")
    assert list((tmp_path / "icub-kit" / "x").iterdir()) == []


def test_an_unwritable_cache_is_one_clear_line(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    with pytest.raises(DataError, match="set ICUB_CACHE"):
        describe()


def test_a_missing_mesh_is_named(tmp_path, monkeypatch):
    real = models.model_file(models.BODY_MODEL)
    folder = tmp_path / "iCub" / "robots" / models.BODY_MODEL
    folder.mkdir(parents=True)
    (folder / "model.urdf").write_bytes(real.read_bytes())
    monkeypatch.setattr(urdf, "model_file", lambda name: folder / "model.urdf")
    with pytest.raises(DataError, match=r"mesh .*\.stl .* is missing"):
        describe()


def test_every_mesh_is_absolute_and_exists():
    for mesh in ET.parse(describe(("right", "left")).urdf).getroot().iter("mesh"):
        path = Path(mesh.attrib["filename"])
        assert path.is_absolute()
        assert path.is_file()


def test_massless_leaves_are_only_the_frames_that_are_used():
    root = ET.parse(describe(("right", "left")).urdf).getroot()
    bare = {link.get("name") for link in root.findall("link") if link.find("inertial") is None}
    tips = {f"{s}_hand_{f}_tip" for s in "rl" for f in ("thumb", "index", "middle", "ring", "little")}
    assert bare == {"r_hand_dh_frame", "l_hand_dh_frame"} | tips


def test_only_forearm_and_hand_collide():
    d = describe()
    root = ET.parse(d.urdf).getroot()
    solid = {link.get("name") for link in root.findall("link") if link.find("collision") is not None}
    assert solid == {"r_forearm", "r_hand"} | {n for n in d.capsule_links if n.startswith("r_hand_")}
    for link in root.findall("link"):
        if link.find("collision/geometry/cylinder") is not None:
            assert link.get("name") in d.capsule_links


def _load_mujoco(description):
    spec = mujoco.MjSpec.from_file(str(description.urdf))
    spec.compiler.fusestatic = False
    model = spec.compile()
    data = mujoco.MjData(model)

    def pose(q, frame):
        for name, value in zip(description.joint_names, q, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = data.body(frame).xmat.reshape(3, 3), data.body(frame).xpos
        return description.T_world_root @ T

    return model, pose


@pytest.mark.parametrize("hands", [("right",), ("right", "left")])
def test_mujoco_agrees(hands):
    robot = ICub(hands)
    d = robot.description
    model, pose = _load_mujoco(d)
    rng = np.random.default_rng(0)
    for q in [d.home_q, *(random_q(d, rng) for _ in range(10))]:
        for frame in FRAMES:
            assert np.allclose(pose(q, frame), robot.forward_kinematics(q, frame), atol=1e-6), frame
    for i, name in enumerate(d.joint_names):
        assert np.allclose(model.joint(name).range, [d.lower[i], d.upper[i]], atol=1e-9), name
    assert model.nq == len(d.joint_names)


def test_welding_does_not_move_anything():
    """The welded robot at home and the free robot at home are the same robot."""
    welded, free = ICub(), ICub(weld=False)
    for frame in (*FRAMES, "l_hand_dh_frame", "l_foot"):
        expected = free.forward_kinematics(free.description.home_q, frame)
        assert np.allclose(welded.forward_kinematics(welded.description.home_q, frame), expected, atol=1e-9), frame


@pytest.mark.pybullet
def test_pybullet_agrees(icub):
    import pybullet

    d = icub.description
    client = pybullet.connect(pybullet.DIRECT)
    try:
        body = pybullet.loadURDF(
            str(d.urdf), basePosition=d.T_world_root[:3, 3].tolist(), useFixedBase=True, physicsClientId=client
        )
        joints, links = {}, {}
        for i in range(pybullet.getNumJoints(body, physicsClientId=client)):
            info = pybullet.getJointInfo(body, i, physicsClientId=client)
            joints[info[1].decode()] = i
            links[info[12].decode()] = i
        # the base frame of PyBullet is the root link's inertial frame
        rng = np.random.default_rng(1)
        for q in [d.home_q, *(random_q(d, rng) for _ in range(5))]:
            for name, value in zip(d.joint_names, q, strict=True):
                pybullet.resetJointState(body, joints[name], value, physicsClientId=client)
            torso = _bullet_pose(pybullet, client, body, links["torso_1"])
            offset = icub.forward_kinematics(q, "torso_1") @ np.linalg.inv(torso)
            for frame in FRAMES:
                T = offset @ _bullet_pose(pybullet, client, body, links[frame])
                assert np.allclose(T, icub.forward_kinematics(q, frame), atol=2e-6), frame
    finally:
        pybullet.disconnect(client)


def _bullet_pose(pybullet, client, body, link):
    state = pybullet.getLinkState(body, link, computeForwardKinematics=1, physicsClientId=client)
    T = np.eye(4)
    T[:3, :3] = np.array(pybullet.getMatrixFromQuaternion(state[5])).reshape(3, 3)
    T[:3, 3] = state[4]
    return T


def test_placo_agrees(icub):
    placo = pytest.importorskip("placo")
    d = icub.description
    wrapper = placo.RobotWrapper(str(d.urdf), placo.Flags.ignore_collisions)
    wrapper.set_T_world_fbase(d.T_world_root)
    rng = np.random.default_rng(2)
    for q in [d.home_q, *(random_q(d, rng) for _ in range(5))]:
        for name, value in zip(d.joint_names, q, strict=True):
            wrapper.set_joint(name, value)
        wrapper.update_kinematics()
        for frame in FRAMES:
            assert np.allclose(wrapper.get_T_world_frame(frame), icub.forward_kinematics(q, frame), atol=1e-6), frame
