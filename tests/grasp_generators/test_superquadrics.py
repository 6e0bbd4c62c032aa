"""What grasps of the generator `superquadrics` promise on the iCub: reachable, liftable, clear of table and object."""

from __future__ import annotations

import numpy as np
import pytest

from icub_core.data import PointCloud
from icub_core.errors import ConfigError
from icub_core.geometry import rotation_about
from icub_core.scene import Table
from icub_grasp_generators.hand_geometry import read_hand_geometry
from icub_grasp_generators.superquadrics.generator import Superquadrics
from icub_grasp_generators.synthetic_clouds import surface

TABLE = Table()
CAN = ("cylinder", np.array([0.033, 0.033, 0.05]))
CARTON = ("box", np.array([0.019, 0.0875, 0.0445]))  # a sugar box on its narrow side
BIG_BOX = ("box", np.array([0.08, 0.09, 0.07]))


def cloud_of(solid, yaw: float, x: float = -0.35, y: float = 0.0, seed: int = 0) -> PointCloud:
    """The side of a solid on the table that the head sees."""
    kind, half = solid
    rng = np.random.default_rng(seed)
    local, normals = surface(kind, half, rng, 6000)
    R = rotation_about("z", yaw)
    points = local @ R.T + [x, y, TABLE.top + half[2]]
    seen = ((np.array([-0.185, -0.044, 1.393]) - points) * (normals @ R.T)).sum(axis=1) > 0
    points = points[seen][:1500]
    return PointCloud(points + 0.0007 * rng.normal(size=points.shape))


@pytest.fixture(scope="module")
def generator():
    return Superquadrics()


@pytest.mark.parametrize("hand", ["right", "left"])
@pytest.mark.parametrize(("solid", "yaw"), [(CAN, 0.0), (CARTON, 0.2), (CARTON, -0.9)])
def test_grasps_are_reached_on_the_whole_way_and_clear_of_table_and_object(
    generator, icub, check_grasps, solid, yaw, hand
):
    cloud = cloud_of(solid, yaw if hand == "right" else -yaw)
    proposals = generator.propose(cloud, icub, TABLE, hand)
    check_grasps(proposals, cloud, TABLE, hand, touched=0.02)
    np.testing.assert_allclose(proposals.object_center, [-0.35, 0.0, TABLE.top + solid[1][2]], atol=0.004)


@pytest.mark.parametrize("hand", ["right", "left"])
def test_the_open_hand_does_not_push_a_cap_on_its_way(generator, icub, hand):
    """A bottle: the solid is its body, and the hand from above would meet the cap before it is there."""
    body = cloud_of(("box", np.array([0.029, 0.045, 0.075])), 0.8 if hand == "right" else -0.8).points
    cap, _ = surface("cylinder", np.array([0.014, 0.014, 0.02]), np.random.default_rng(0), 600)
    points = np.concatenate([body, cap + [-0.35, 0.0, TABLE.top + 0.17]])
    proposals = generator.propose(PointCloud(points), icub, TABLE, hand)
    assert proposals, proposals.reason
    occupancy = read_hand_geometry(icub, hand).occupancy
    for grasp in proposals.grasps:
        for before in (0.0, 0.01, 0.02, 0.03, 0.04, 0.05):
            assert occupancy.count(grasp.backed_off(before)[None], points)[0] < 0.01 * len(points)


def drill(yaw: float = 0.0) -> PointCloud:
    """Foot, handle and a housing above, seen by the head; a superquadric takes them for one box."""
    parts = [
        (np.array([0.05, 0.0285, 0.02]), [-0.03, 0.0, 0.02]),
        (np.array([0.0175, 0.023, 0.046]), [-0.03, 0.0, 0.086]),
        (np.array([0.092, 0.0275, 0.0275]), [0.0, 0.0, 0.1595]),
    ]
    rng, base = np.random.default_rng(0), np.array([-0.35, 0.0, TABLE.top])
    R = rotation_about("z", yaw)
    eye = (np.array([-0.185, -0.044, 1.393]) - base) @ R
    points = []
    for half, middle in parts:
        local, normals = surface("box", half, rng, int(4e5 * half.sum() ** 2))
        here = local + middle
        seen = ((eye - here) * normals).sum(axis=1) > 0
        inside = np.zeros(len(here), dtype=bool)
        along = (eye - here) / np.linalg.norm(eye - here, axis=1)[:, None]
        for step in np.arange(0.002, 0.2, 0.004):  # hidden where the ray to the eye goes through another part
            for other, center in parts:
                inside |= np.all(np.abs(here + step * along - center) < other - 1e-3, axis=1)
        points.append(here[seen & ~inside])
    cloud = np.concatenate(points)
    cloud = cloud[rng.permutation(len(cloud))[:3000]]
    return PointCloud(cloud @ R.T + base, viewpoint=eye @ R.T + base)


def share_held(cloud: PointCloud, grasp) -> float:
    """Of the points between thumb and fingers."""
    local = (cloud.points - grasp.T_world_hand[:3, 3]) @ grasp.T_world_hand[:3, :3]
    return float(np.all((local > [-0.02, -0.05, 0.0]) & (local < [0.085, 0.05, 0.075]), axis=1).mean())


def test_the_hand_closes_where_something_was_seen(generator, icub):
    """Without a viewpoint the emptiness beside a drill's handle looks like any side of a box."""
    cloud = drill(1.8)
    knowing = generator.propose(cloud, icub, TABLE).grasps[0]
    blind = generator.propose(PointCloud(cloud.points), icub, TABLE).grasps[0]
    assert share_held(cloud, knowing) > 2 * share_held(cloud, blind)


def test_the_hand_squeezes_the_narrow_side(generator, icub):
    for yaw in (0.0, 0.3, -0.3):
        grasp = generator.propose(cloud_of(CARTON, yaw), icub, TABLE).grasps[0]
        narrow = rotation_about("z", yaw)[:, 0]
        assert abs(grasp.T_world_hand[:3, 0] @ narrow) > np.cos(0.3)


def test_the_object_lies_between_thumb_and_fingers(generator, icub):
    grasp = generator.propose(cloud_of(CAN, 0.0), icub, TABLE).grasps[0]
    center = grasp.T_world_hand[:3, :3].T @ (grasp.object_center - grasp.T_world_hand[:3, 3])
    assert 0.028 < center[0] < 0.038
    assert 0.02 < center[2] < 0.07  # in front of the palm


def test_a_left_hand_grasps_the_mirror_image(generator, icub):
    right = generator.propose(cloud_of(CARTON, 0.4, y=0.05), icub, TABLE, "right").grasps[0]
    left = generator.propose(cloud_of(CARTON, -0.4, y=-0.05), icub, TABLE, "left").grasps[0]
    mirror = np.diag([1.0, -1.0, 1.0])
    # fitted to other noise and reached by another home posture, but from the same family
    fingers = mirror @ right.T_world_hand[:3, 0]
    assert abs(fingers @ left.T_world_hand[:3, 0]) > np.cos(0.4)
    frame = icub.description.hand("left").frame
    palm = -left.T_world_hand[:3, 2]  # a left palm looks along -z of its frame
    assert palm @ (left.object_center - left.T_world_hand[:3, 3]) > 0
    assert frame.startswith("l_")


def test_the_same_cloud_gives_the_same_grasps(generator, icub):
    one, two = (Superquadrics().propose(cloud_of(CAN, 0.0), icub, TABLE) for _ in range(2))
    for a, b in zip(one.grasps, two.grasps, strict=True):
        np.testing.assert_array_equal(a.T_world_hand, b.T_world_hand)


def with_nan() -> PointCloud:
    points = cloud_of(CAN, 0.0).points
    points[3] = np.nan
    return PointCloud(points)


NO_GRASP = {
    "too wide": (lambda: cloud_of(BIG_BOX, 0.3), "mm wide; the hand takes"),
    "out of reach": (lambda: cloud_of(CAN, 0.0, x=-1.1), "arm reaches none of"),
    "empty": (lambda: PointCloud(np.zeros((0, 3))), "0 points"),
    "three points": (lambda: PointCloud(np.eye(3)), "3 points"),
    "not finite": (with_nan, "not finite"),
    "collinear": (lambda: PointCloud(np.linspace([-0.4, 0, 1], [-0.3, 0, 1], 90)), "one line"),
    "tiny": (lambda: PointCloud(cloud_of(CAN, 0.0).points * 1e-3), "within"),
    "huge": (lambda: PointCloud(1e3 * cloud_of(CAN, 0.0).points), "extends over"),
    "another frame": (lambda: PointCloud(cloud_of(CAN, 0.0).points, frame="camera"), "'camera'"),
    "below the table": (lambda: PointCloud(cloud_of(CAN, 0.0).points - [0, 0, 0.3]), ""),
}


@pytest.mark.parametrize("name", NO_GRASP)
def test_no_grasp_is_an_answer_with_its_reason_in_one_line(generator, icub, name):
    make, message = NO_GRASP[name]
    proposals = generator.propose(make(), icub, TABLE)
    assert not proposals.grasps
    assert proposals.reason
    assert "\n" not in proposals.reason
    assert message in proposals.reason


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_flat_cloud_has_an_answer(generator, icub, axis):
    """One face of a carton, or a card that stands or lies: a grasp or the reason, in one line."""
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (400, 3)) * [0.02, 0.05, 0.04]
    points[:, axis] = 0.0
    answer = generator.propose(PointCloud(points + [-0.35, 0.0, TABLE.top + 0.045]), icub, TABLE)
    assert answer.grasps or (answer.reason and "\n" not in answer.reason)
    for grasp in answer.grasps:
        assert np.isfinite(grasp.T_world_hand).all()


def test_an_object_without_a_table_is_grasped_too(generator, icub):
    assert generator.propose(cloud_of(CAN, 0.0), icub, None)


def test_what_the_solid_does_not_model_is_still_in_the_way(generator, icub):
    """A post on the can, too thin to change the fit, keeps the palm off the can's top."""
    can = cloud_of(CAN, 0.0)
    rng = np.random.default_rng(0)
    post = rng.uniform([-0.355, -0.005, TABLE.top + 0.1], [-0.345, 0.005, TABLE.top + 0.2], (150, 3))
    proposals = generator.propose(PointCloud(np.concatenate([can.points, post])), icub, TABLE)
    assert proposals, proposals.reason
    occupancy = read_hand_geometry(icub, "right").occupancy
    for grasp in proposals.grasps:
        assert occupancy.count(grasp.T_world_hand[None], post)[0] <= 15


def test_a_hand_that_the_robot_lacks_is_an_error(generator, icub):
    with pytest.raises(ConfigError, match="hand"):
        generator.propose(cloud_of(CAN, 0.0), icub, TABLE, "middle")
