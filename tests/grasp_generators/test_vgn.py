"""What grasps of the generator `vgn` promise on the iCub, with the weights that ship."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

from icub_core.data import PointCloud
from icub_core.errors import ConfigError, WeightsError
from icub_core.geometry import rotation_about
from icub_core.scene import Table
from icub_grasp_generators.planned_hand import planned_hand
from icub_grasp_generators.synthetic_clouds import surface
from icub_grasp_generators.vgn.generator import Vgn
from icub_grasp_generators.vgn.hand_search import around
from icub_grasp_generators.vgn.network import SHIPPED, VgnNetwork, load_network
from icub_grasp_generators.vgn.palm import at_palm
from icub_testing.tiny.robot import TinyRobot

TABLE = Table()
CAN = ("cylinder", np.array([0.033, 0.033, 0.05]))
CARTON = ("box", np.array([0.019, 0.0875, 0.0445]))
EYE = np.array([-0.185, -0.044, 1.393])
MIRROR = np.array([1.0, -1.0, 1.0])


def cloud_of(solid, yaw: float = 0.0, x: float = -0.35, y: float = 0.0) -> PointCloud:
    """The side of a solid on the table that the head sees."""
    kind, half = solid
    rng = np.random.default_rng(0)
    local, normals = surface(kind, half, rng, 8000)
    R = rotation_about("z", yaw)
    points = local @ R.T + [x, y, TABLE.top + half[2]]
    seen = ((EYE - points) * (normals @ R.T)).sum(axis=1) > 0
    points = points[seen][:3000]
    return PointCloud(points + 0.0007 * rng.normal(size=points.shape), viewpoint=EYE)


def mirrored(cloud: PointCloud) -> PointCloud:
    return PointCloud(cloud.points * MIRROR, viewpoint=cloud.viewpoint * MIRROR)


@pytest.fixture(scope="module")
def generator():
    return Vgn()


@pytest.mark.parametrize("hand", ["right", "left"])
@pytest.mark.parametrize(("solid", "yaw"), [(CAN, 0.0), (CARTON, 0.2)])
def test_grasps_are_reached_on_the_whole_way_and_clear_of_table_and_object(
    generator, icub, check_grasps, solid, yaw, hand
):
    cloud = cloud_of(solid, yaw) if hand == "right" else mirrored(cloud_of(solid, yaw))
    proposals = generator.propose(cloud, icub, TABLE, hand)
    check_grasps(proposals, cloud, TABLE, hand, touched=0.03)
    assert 0.0 < proposals.grasps[-1].score <= proposals.grasps[0].score <= 1.0
    assert all(grasp.generator == "vgn" for grasp in proposals.grasps)
    np.testing.assert_allclose(proposals.object_center, [-0.35, 0.0, TABLE.top + solid[1][2]], atol=0.02)


def test_the_left_hand_grasps_the_mirror_image(generator, icub):
    cloud = cloud_of(CAN)
    right, _ = generator.predict(cloud, TABLE, planned_hand(icub.description))
    right = np.concatenate([right, around(at_palm(right)[:, :3, 3], cloud)])
    grasps = generator.propose(mirrored(cloud), icub, TABLE, "left").grasps
    assert grasps
    for grasp in grasps:
        back = np.diag([1.0, -1.0, 1.0, 1.0]) @ grasp.T_world_hand @ np.diag([1.0, 1.0, -1.0, 1.0])
        assert np.abs(right - back).max(axis=(1, 2)).min() < 1e-6


@pytest.mark.parametrize("table_in_volume", [False, True])
@pytest.mark.parametrize("weights", sorted(path.stem for path in SHIPPED.glob("*.safetensors")))
def test_both_networks_find_poses_with_the_table_in_the_field_or_not(icub, weights, table_in_volume):
    hand = planned_hand(icub.description)
    poses, quality = Vgn(weights, threshold=0.2, table_in_volume=table_in_volume).predict(cloud_of(CAN), TABLE, hand)
    assert len(poses) == len(quality) > 0
    assert np.all(np.diff(quality) <= 0)
    assert np.all(np.linalg.norm(poses[:, :3, 3] - [-0.35, 0.0, TABLE.top + 0.05], axis=1) < 0.2)


def test_a_cloud_without_a_viewpoint_is_taken_to_be_seen_by_the_head(generator, icub):
    cloud = cloud_of(CAN)
    assert generator.propose(PointCloud(cloud.points), icub, TABLE)


def test_without_a_table_the_cube_stands_on_the_lowest_point(icub, generator):
    cloud = cloud_of(CAN)
    poses, _ = generator.predict(cloud, None, planned_hand(icub.description))
    assert np.all(np.abs(poses[:, 2, 3] - TABLE.top - 0.05) < 0.2)


def test_without_a_threshold_only_poses_that_were_scored_are_proposed(icub):
    proposals = Vgn(threshold=0.0, max_grasps=150).propose(cloud_of(CAN), icub, TABLE)
    assert proposals, proposals.reason
    assert min(grasp.score for grasp in proposals.grasps) > 0


def test_no_grasp_is_a_result_with_its_reason(icub, generator):
    strict = Vgn(threshold=0.999)
    answer = strict.propose(cloud_of(CAN), icub, TABLE)
    assert not answer
    assert "no voxel has a quality of 0.999" in answer.reason
    assert answer.object_center is not None
    camera = PointCloud(cloud_of(CAN).points, frame="camera")
    assert "expected 'world'" in generator.propose(camera, icub, TABLE).reason
    inside = PointCloud(cloud_of(CAN).points, viewpoint=np.array([-0.35, 0.0, 1.0]))
    assert "viewpoint is" in generator.propose(inside, icub, TABLE).reason


def test_weights_of_the_icub_s_hand_leave_another_hand_to_the_gripper_s(generator):
    """The tiny robot's claw is no hand of the iCub: both weights give the grasps of the gripper's network."""
    answers = [g.propose(cloud_of(CAN), TinyRobot(), TABLE) for g in (generator, Vgn("parallel_jaw"))]
    assert answers[0], answers[0].reason
    assert answers[0].grasps[0].hand == "claw"
    for one, other in zip(*(answer.grasps for answer in answers), strict=True):
        np.testing.assert_array_equal(one.T_world_hand, other.T_world_hand)


def test_the_original_weight_file_can_be_given(icub, tmp_path):
    torch.manual_seed(0)
    torch.save(VgnNetwork().state_dict(), tmp_path / "vgn_conv.pth")
    answer = Vgn(weights=str(tmp_path / "vgn_conv.pth")).propose(cloud_of(CAN), icub, TABLE)
    assert answer or answer.reason  # untrained numbers, but the whole way


def test_bad_arguments(icub, generator):
    with pytest.raises(WeightsError, match="icub_hand"):
        Vgn(weights="icub_hnd")
    for arguments in ({"threshold": 1.0}, {"threshold": -0.1}, {"max_grasps": 0}):
        with pytest.raises(ConfigError, match="vgn"):
            Vgn(**arguments)
    with pytest.raises(ConfigError, match="middle"):
        generator.propose(cloud_of(CAN), icub, TABLE, hand="middle")


@pytest.mark.parametrize("name", sorted(path.stem for path in SHIPPED.glob("*.safetensors")))
def test_the_card_says_where_the_weights_come_from_and_how_good_they_are(name):
    card = json.loads((SHIPPED / f"{name}.json").read_text())
    assert card["command"].startswith("icub train grasp_generator=vgn")
    assert {"seed", "data", "machine", "versions", "minutes", "steps", "figures"} <= card.keys()
    assert card["figures"]["trials"] >= 50
    assert 0.5 < card["figures"]["auc"] <= 1.0
    if load_network(name)[2] is not None:
        assert card["figures"]["judge_auc"] > 0.8
        assert card["figures"]["judge_held_best"] > card["figures"]["judge_held"] + 0.2


def test_the_shipped_classifier_takes_the_carton_across_no_more_than_the_hand_opens(generator, icub):
    """38 mm one way and 175 mm the other: thumb and fingers may come at an angle, not from the ends."""
    for yaw in (-0.3, 0.0, 0.3):
        proposals = generator.propose(cloud_of(CARTON, yaw), icub, TABLE)
        assert proposals, proposals.reason
        closing = proposals.grasps[0].T_world_hand[:2, 0]
        across = np.array([np.cos(yaw), np.sin(yaw)])
        assert 0.038 / abs(closing @ across) < 0.075
        assert proposals.grasps[0].score > 0.5
