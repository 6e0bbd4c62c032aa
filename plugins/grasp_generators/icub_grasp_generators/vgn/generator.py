"""The grasp generator `vgn`: signed distance field, network, selection, adaptation to the hand, reachability."""

from __future__ import annotations

import numpy as np
import torch

from icub_core.data import Grasp, GraspProposals, PointCloud
from icub_core.errors import ConfigError, DataError
from icub_core.geometry import FloatArray
from icub_core.interfaces.grasp_generator import GraspGenerator
from icub_core.interfaces.robot import Robot
from icub_core.scene import Table
from icub_grasp_generators.clouds import CLOUD_POINTS, MAX_TOUCHED, center_of, check_cloud, thin
from icub_grasp_generators.planned_hand import PlannedHand
from icub_grasp_generators.reach import HandGeometries, Reach, clears_table
from icub_grasp_generators.vgn.adaptation import hand_poses
from icub_grasp_generators.vgn.classifier import GraspClassifier
from icub_grasp_generators.vgn.hand_search import MAX_SCORED, around
from icub_grasp_generators.vgn.network import GRIPPER, Meaning, VgnNetwork, load_network
from icub_grasp_generators.vgn.palm import at_palm, is_learned
from icub_grasp_generators.vgn.passage import passes
from icub_grasp_generators.vgn.selection import WIDTHS, select
from icub_grasp_generators.vgn.volume import Volume

NAME = "vgn"
_GRIPPER_WEIGHTS = "parallel_jaw"
_SPARE = 3  # times as many poses are tested for reach as are returned: the way to some may be blocked
_FIELD = 0.5  # meters between the object and a camera that had to be assumed


class Vgn(GraspGenerator):
    """Grasps that a volumetric network finds in the signed distance field of the cloud.

    Every voxel has a quality, a rotation and a width. The best voxels near the surface become hand poses; those that
    keep the open hand out of table and cloud and that the arm reaches on the whole way are returned, most confident
    first. Weights that were learned with the hand have a second network, the grasp-quality classifier: around the best
    voxels many hand poses are drawn, and their confidence is its probability that each holds.

    Args:
        weights: ``"icub_hand"`` (shipped; learned from trials with the iCub's hand), ``"parallel_jaw"`` (shipped;
            learned from trials with a gripper, adapted to the hand), the path of a file that
            ``icub train grasp_generator=vgn`` wrote, or the path of the original's weight file (``.pth``). For a hand
            that is not like the iCub's, ``"parallel_jaw"`` takes the place of weights of the iCub's hand.
        threshold: Least quality of a voxel, and least confidence of a scored hand pose, 0..1.
        table_in_volume: Whether the field contains the table.
        max_grasps: At most this many are returned.

    Raises:
        WeightsError: Missing, truncated or foreign weights.

    Source: Breyer et al. 2020; thesis 12.3.1 for the adaptation.
    """

    def __init__(
        self, weights: str = "icub_hand", threshold: float = 0.3, table_in_volume: bool = False, max_grasps: int = 5
    ) -> None:
        if not 0.0 <= threshold < 1.0 or max_grasps < 1:
            raise ConfigError(f"vgn: threshold {threshold}, max_grasps {max_grasps}; expected 0 to 1 and at least 1")
        self._own = load_network(weights)
        self._gripper = self._own if self._own[1].pose == GRIPPER else None
        self._threshold, self._table_in_volume, self._max_grasps = threshold, table_in_volume, max_grasps
        self._hands = HandGeometries()

    def propose(self, cloud: PointCloud, robot: Robot, table: Table | None, hand: str | None = None) -> GraspProposals:
        """Predict, select, adapt, test; see the interface. Raises ConfigError when the robot has no such hand.

        A cloud without a viewpoint is taken to be seen from where the robot's first camera is at home.
        """
        geometry = self._hands.get(robot, hand)
        planned, name = geometry.planned, geometry.name
        _, _, classifier = self._networks(planned)
        if cloud.frame != "world":
            return GraspProposals((), reason=f"the cloud is given in the frame '{cloud.frame}'; expected 'world'")
        try:
            check_cloud(cloud.points)
            seen = PointCloud(cloud.points, viewpoint=_viewpoint(cloud, robot))
            center = center_of(cloud.points, None if table is None else table.top)
            seen = planned.cloud(seen)
            T, quality = self.predict(seen, table, planned)
        except DataError as error:
            return GraspProposals((), reason=str(error))
        if len(quality) == 0:
            return GraspProposals((), center, f"no voxel has a quality of {self._threshold} or more")
        if classifier is not None:
            T = np.concatenate([T, around(at_palm(T)[:, :3, 3], seen)])
        T_world_hand = planned.to_hand(T)
        free = geometry.occupancy.count(T_world_hand, thin(cloud.points, CLOUD_POINTS)) <= MAX_TOUCHED
        if not free.any():
            return GraspProposals((), center, f"at all {len(free)} poses found the open hand meets points of the cloud")
        if classifier is not None:
            free &= clears_table(geometry.hand.at(T_world_hand), geometry.hand.radii, table)
            chosen = np.flatnonzero(free)[:MAX_SCORED]
            if not len(chosen):
                return GraspProposals((), center, f"at all {len(free)} poses found the open hand meets cloud or table")
            quality = np.full(len(free), -np.inf)
            quality[chosen] = _scored(classifier, T[chosen], seen, table)
            free = quality >= self._threshold
            if not free.any():
                best = float(quality.max())
                return GraspProposals((), center, f"no hand pose is scored {self._threshold} or more; best {best:.2g}")
        order = np.flatnonzero(free)
        order = order[np.argsort(-quality[order], kind="stable")]
        tries = [Grasp(T_world_hand[i], center, float(quality[i]), NAME, name) for i in order]
        reached = Reach(robot, geometry, table, posture_weight=0.0).choose(tries, _SPARE * self._max_grasps)
        if not reached:
            return GraspProposals((), center, f"the {name} arm reaches none of {len(tries)} poses found")
        grasps = tuple(grasp for grasp in reached if passes(grasp, cloud.points, robot, geometry))[: self._max_grasps]
        if not grasps:
            return GraspProposals((), center, f"on the way to all {len(reached)} poses the hand meets the cloud")
        return GraspProposals(grasps, center)

    def _networks(self, hand: PlannedHand) -> tuple[VgnNetwork, Meaning, GraspClassifier | None]:
        """Return what predicts for a hand: weights of the iCub's hand know no other; the gripper's are for all."""
        if is_learned(hand) and self._own is not self._gripper:
            return self._own
        if self._gripper is None:
            self._gripper = load_network(_GRIPPER_WEIGHTS)
        return self._gripper

    def predict(self, cloud: PointCloud, table: Table | None, hand: PlannedHand) -> tuple[FloatArray, FloatArray]:
        """Return poses (C, 4, 4) of the planning frame, world, and qualities (C,), best first, before any test.

        Args:
            cloud: With its viewpoint, world frame; of the planning world.
            table: The cube stands on it; without one, on the lowest point.
            hand: What grasps.
        """
        network, meaning, _ = self._networks(hand)
        volume, _, _ = _volume(cloud, table)
        tsdf = volume.tsdf((cloud,), table.top if self._table_in_volume and table is not None else None)
        with torch.inference_mode():
            quality, rotation, width = network(torch.from_numpy(tsdf)[None, None])
        found = select(
            tsdf,
            quality[0, 0].numpy(),
            rotation[0].numpy(),
            width[0, 0].numpy(),
            threshold=self._threshold,
            widths=WIDTHS if meaning.pose == GRIPPER else None,
        )
        return hand_poses(found, volume, meaning.pose, hand)


def _scored(classifier: GraspClassifier, T: FloatArray, cloud: PointCloud, table: Table | None) -> FloatArray:
    volume, center, bottom = _volume(cloud, table)
    return classifier.score(volume.range_view(cloud), T, center, bottom)


def _volume(cloud: PointCloud, table: Table | None) -> tuple[Volume, FloatArray, float]:
    """Return the cube around a cloud, the estimated middle (3,) of the object, and the height that it stands on."""
    top = None if table is None else table.top
    center = center_of(cloud.points, top)
    bottom = float(cloud.points[:, 2].min()) if top is None else top
    return Volume.around(center, bottom), center, bottom


def _viewpoint(cloud: PointCloud, robot: Robot) -> FloatArray:
    """Return where the cloud was seen from; without a viewpoint, on the line to the robot's first camera at home."""
    if cloud.viewpoint is not None:
        return cloud.viewpoint
    middle = cloud.points.mean(axis=0)
    away = np.array([0.0, 0.0, 1.0])
    cameras = robot.description.cameras
    if cameras:
        away = robot.forward_kinematics(robot.description.home_q, cameras[0].link)[:3, 3] - middle
        away[2] = max(float(away[2]), 0.1)
    return np.asarray(middle + _FIELD * away / np.linalg.norm(away))
