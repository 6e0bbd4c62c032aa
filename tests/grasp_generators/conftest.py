"""The robot, and what is promised of every generator's grasps."""

from __future__ import annotations

import pytest

from icub_core.geometry import is_rigid


@pytest.fixture(scope="session")
def icub():
    from icub_robots.icub import ICub

    return ICub(hands=("right", "left"))


@pytest.fixture(scope="session")
def check_grasps(icub):
    """A check that grasps are for one hand, best first, reached before, at and above, and clear of table and cloud."""
    from icub_grasp_generators.hand_geometry import read_hand_geometry

    def check(proposals, cloud, table, hand: str, touched: float) -> None:
        """`touched` is the share of the cloud's points that may lie in the open hand."""
        assert proposals, proposals.reason
        scores = [grasp.score for grasp in proposals.grasps]
        assert scores == sorted(scores, reverse=True)
        geometry = read_hand_geometry(icub, hand)
        for grasp in proposals.grasps:
            assert grasp.hand == hand
            lifted = grasp.T_world_hand.copy()
            lifted[2, 3] += 0.1
            for T in (grasp.T_world_hand, grasp.backed_off(0.05), grasp.backed_off(0.10), lifted):
                assert is_rigid(T)
                solution = icub.inverse_kinematics(T, icub.description.home_q, geometry.frame, group=f"{hand}_reach")
                assert solution.reached
                assert (geometry.hand.at(T)[:, 2] - geometry.hand.radii).min() > table.top
            assert geometry.occupancy.count(grasp.T_world_hand[None], cloud.points)[0] < touched * len(cloud)

    return check
