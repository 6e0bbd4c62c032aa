"""Gaze control: the neck posture nearest to its rest that puts a point near a camera's optical axis."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from icub_core.errors import ConfigError, DataError
from icub_core.geometry import FloatArray, make_transform, quat_wxyz_to_matrix
from icub_core.interfaces.robot import GazeSolution
from icub_core.robot_description import RobotCamera
from icub_robots.kinematics.model import PinocchioModel

TOLERANCE = float(np.arccos(0.99))  # rad, 8.1 degrees (thesis 12.4; the released gaze controller uses the same)


class Gaze:
    """Solves min |n - n_home|^2 over the neck's joints n, within limits, subject to cos(angle to the point) >= 0.99.

    Args:
        model: The robot.
    """

    def __init__(self, model: PinocchioModel) -> None:
        self._model = model
        d = model.description
        self._neck = d.indices("neck")
        self._rest = d.home_q[self._neck]
        self._bounds = list(zip(d.lower[self._neck], d.upper[self._neck], strict=True))

    def solve(self, point: FloatArray, q_start: FloatArray, view: RobotCamera) -> GazeSolution:
        """Turn the neck from `q_start` (n,) so that the camera `view` looks at `point` (3,), world.

        Raises:
            ConfigError: A camera that the neck does not move.
            DataError: A point that is not finite.
        """
        if np.shape(point) != (3,) or not np.isfinite(point).all():
            raise DataError(f"the point to look at is {point}; expected 3 finite coordinates, meters")
        if not set(self._model.description.groups["neck"]) & set(self._model.support(view.link)):
            raise ConfigError(f"camera '{view.name}' does not move with the neck")
        T_link_camera = make_transform(quat_wxyz_to_matrix(view.quat_wxyz), view.position)
        q = q_start.copy()

        def cosine(neck: FloatArray) -> tuple[float, FloatArray]:
            """Cosine between the optical axis z and the line u to the point, and its gradient."""
            q[self._neck] = neck
            T_link, J = self._model.pose_and_jacobian(q, view.link)
            T = T_link @ T_link_camera
            z, line = T[:3, 2], point - T[:3, 3]
            distance = float(np.linalg.norm(line))
            u = line / max(distance, 1e-9)
            linear, angular = J[:3, self._neck], J[3:, self._neck]
            arm = T[:3, 3] - T_link[:3, 3]
            camera_velocity = linear + np.cross(angular.T, arm).T
            dz = np.cross(angular.T, z).T
            du = -(camera_velocity - np.outer(u, u @ camera_velocity)) / max(distance, 1e-9)
            return float(z @ u), u @ dz + z @ du

        start = np.clip(q_start[self._neck], *np.transpose(self._bounds))
        aligned = minimize(  # first the posture that looks straightest: always exists, and starts the second
            lambda n: tuple(-v for v in cosine(n)), start, jac=True, bounds=self._bounds, method="L-BFGS-B"
        ).x
        limit = float(np.cos(TOLERANCE))
        best = aligned
        if cosine(aligned)[0] >= limit:
            relaxed = minimize(
                lambda n: (float((n - self._rest) @ (n - self._rest)), 2.0 * (n - self._rest)),
                aligned,
                jac=True,
                bounds=self._bounds,
                constraints={"type": "ineq", "fun": lambda n: cosine(n)[0] - limit, "jac": lambda n: cosine(n)[1]},
                method="SLSQP",
                options={"ftol": 1e-8},
            ).x
            relaxed = np.clip(relaxed, *np.transpose(self._bounds))
            if cosine(relaxed)[0] >= limit - 1e-6:
                best = relaxed
        angle = float(np.arccos(np.clip(cosine(best)[0], -1.0, 1.0)))
        q[self._neck] = best
        return GazeSolution(q, angle <= TOLERANCE + 1e-5, angle)
