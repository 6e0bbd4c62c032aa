"""How dropped objects come to rest, and what of a folder a hand can take from a table."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from icub_core.errors import DataError
from icub_core.geometry import is_rigid, make_transform, quat_wxyz_to_matrix
from icub_core.scene import Scene
from icub_simulators.mujoco.simulator import Mujoco
from icub_simulators.objects.folder import Folder
from icub_simulators.objects.resting import drop, rest_poses
from icub_simulators.objects.solids import stable_poses
from icub_simulators.pybullet.simulator import PyBullet
from icub_support.rotations import spread_rotations


@pytest.fixture(autouse=True, scope="module")
def private_cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


def corners(mesh) -> list[np.ndarray]:
    return [np.asarray(mesh.vertices, dtype=np.float64)]


BOX = trimesh.creation.box((0.04, 0.09, 0.17))
CAN = trimesh.creation.cylinder(0.033, 0.1, sections=32)
CONE = trimesh.creation.cone(0.03, 0.1)


def shares(poses) -> dict[float, float]:
    """Shares by height in millimeters."""
    found: dict[float, float] = {}
    for pose in poses:
        height = round(1e3 * pose.height)
        found[height] = found.get(height, 0.0) + pose.share
    return found


def test_a_box_comes_to_rest_on_each_of_its_sides_mostly_on_the_largest():
    poses = rest_poses(corners(BOX))
    assert sum(pose.share for pose in poses) == pytest.approx(1.0)
    assert [pose.share for pose in poses] == sorted((pose.share for pose in poses), reverse=True)
    flat, edge, end = (shares(poses)[height] for height in (20, 45, 85))
    assert flat > 0.5
    assert flat > edge > end > 0
    assert poses[0].height == pytest.approx(0.02)  # exactly: contacts are soft, the hull's facets are not


def test_the_side_of_a_can_is_one_way_to_lie():
    poses = rest_poses(corners(CAN))
    assert len(poses) == 3
    assert shares(poses)[33] > 0.5
    up = [quat_wxyz_to_matrix(pose.quat_wxyz)[2] for pose in poses]
    assert sorted(round(abs(u[2])) for u in up) == [0, 1, 1]


def test_a_cone_never_stands_on_its_tip():
    poses = rest_poses(corners(CONE))
    assert len(poses) == 2
    assert not any(quat_wxyz_to_matrix(pose.quat_wxyz)[2, 2] < -0.5 for pose in poses)


def test_a_body_that_is_heavy_at_one_end_stands_on_it():
    """A bar with a block below one end: one piece each, at one density."""
    bar = BOX.copy().apply_scale([0.3, 0.15, 1.0])
    block = trimesh.creation.box((0.08, 0.08, 0.03)).apply_translation([0, 0, -0.085])
    standing = [p for p in rest_poses(corners(bar) + corners(block)) if quat_wxyz_to_matrix(p.quat_wxyz)[2, 2] > 0.99]
    assert sum(p.share for p in standing) > 0.2
    upside_down = [
        p for p in rest_poses(corners(bar) + corners(block)) if quat_wxyz_to_matrix(p.quat_wxyz)[2, 2] < -0.9
    ]
    assert not upside_down


def test_it_is_computed_once(monkeypatch):
    first = rest_poses(corners(BOX))
    monkeypatch.setattr("icub_simulators.objects.resting.drop", lambda *a: pytest.fail("dropped again"))
    assert rest_poses(corners(BOX)) == first


def test_points_without_volume_are_an_error():
    flat = np.c_[np.random.default_rng(0).normal(size=(20, 2)), np.zeros(20)]
    with pytest.raises(DataError, match="no volume"):
        rest_poses([flat])


def test_spread_rotations_are_spread_evenly():
    rotations = spread_rotations(64)
    assert all(is_rigid(make_transform(R)) for R in rotations)
    np.testing.assert_allclose(rotations.mean(axis=0), 0, atol=0.05)
    angles = [
        np.arccos(np.clip((np.trace(a.T @ b) - 1) / 2, -1, 1)) for i, a in enumerate(rotations) for b in rotations[:i]
    ]
    assert min(angles) > 0.4


@pytest.mark.parametrize("engine", [Mujoco, pytest.param(PyBullet, marks=pytest.mark.pybullet)])
def test_an_object_of_a_folder_stays_as_it_is_put_in_either_engine(engine, tmp_path, standing):
    CONE.export(tmp_path / "cone.stl")
    BOX.export(tmp_path / "box.stl")
    specs = [Folder(tmp_path).get(name) for name in ("box", "cone")]
    simulator = engine()
    simulator.load(None, Scene(objects=tuple(specs)))
    poses = {spec.name: standing(spec, -0.4, 0.3 * i) for i, spec in enumerate(specs)}
    for name, pose in poses.items():
        simulator.set_object_pose(name, pose)
    simulator.step(200)
    for name, pose in poses.items():
        moved = simulator.object_pose(name)
        assert moved[:3, 2] @ pose[:3, 2] > np.cos(0.05)
        assert abs(moved[2, 3] - pose[2, 3]) < 2e-3
    simulator.close()
    for spec in specs:
        assert spec.rest_poses[0].quat_wxyz == spec.rest_quat_wxyz
        assert spec.rest_poses[0].height == spec.rest_height
        assert sum(pose.share for pose in spec.rest_poses) == pytest.approx(1.0)


def test_of_a_folder_only_what_fits_the_hand(tmp_path):
    for name, size in (("bar", (0.045, 0.06, 0.17)), ("sheet", (0.02, 0.09, 0.12)), ("crate", (0.12, 0.12, 0.12))):
        trimesh.creation.box(size).export(tmp_path / f"{name}.stl")
    (tmp_path / "sub").mkdir()
    assert set(Folder(tmp_path).names) == {"bar", "sheet", "crate"}
    objects = Folder(tmp_path, graspable=True)
    assert objects.names == ("bar", "sheet")
    bar = objects.get("bar")  # lies lower than the fingers need; on its narrow side it is high enough
    assert Folder(tmp_path).get("bar").rest_height == pytest.approx(0.0225, abs=1e-6)
    assert bar.rest_height == pytest.approx(0.03, abs=1e-6)
    for name in ("bar", "sheet"):
        (tmp_path / f"{name}.stl").unlink()
    with pytest.raises(DataError, match="fits the hand") as caught:
        _ = Folder(tmp_path, graspable=True).names
    assert "\n" not in str(caught.value)


def test_shares_agree_with_drops_from_other_orientations():
    """64 even orientations say the same as 300 random ones, within the noise of the latter."""
    rng = np.random.default_rng(0)
    quats = rng.normal(size=(300, 4))
    rotations = np.array([quat_wxyz_to_matrix(q / np.linalg.norm(q)) for q in quats])
    ends, settled = drop(corners(BOX), rotations)
    assert settled.all()
    flat = np.mean(np.abs(ends[:, 2, 0]) > 0.9)
    assert shares(rest_poses(corners(BOX)))[20] == pytest.approx(flat, abs=0.1)
    facets = [quat_wxyz_to_matrix(p.quat_wxyz)[2] for p, _ in stable_poses(corners(BOX)[0], np.zeros(3))]
    assert np.all(np.max(ends[:, 2] @ np.array(facets).T, axis=1) > np.cos(0.02))
