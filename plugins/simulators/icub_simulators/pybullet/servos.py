"""Position servos on joints and tendons, by Bullet's velocity motors.

MuJoCo's servo pulls with f = kp (command - length) on the weighted sum of its joints, each joint's damping opposes: a
first-order system with the time constant damping / kp. Explicit torques of that size are unstable in Bullet at a
5 ms step, so each joint gets a motor that is implicit: its target is the velocity at which torque and damping balance,
one implicit Euler step ahead, and its strength is the torque. Free joints move, and blocked joints push, as in MuJoCo;
under-actuated tendons divide their stroke by what the joints meet.
"""

from __future__ import annotations

import numpy as np

from icub_core.geometry import FloatArray
from icub_core.robot_description import JointDynamics, RobotDescription


class Servos:
    """The robot's actuators and passive joint behavior."""

    def __init__(self, robot: RobotDescription, timestep: float) -> None:
        self.A, self.b = robot.actuator_matrix()
        self.low = np.array([a.range[0] for a in robot.actuators])
        self.high = np.array([a.range[1] for a in robot.actuators])
        self._kp = np.array([a.kp for a in robot.actuators])
        dynamics = [robot.dynamics.get(name, JointDynamics()) for name in robot.joint_names]
        self._damping = np.array([d.damping for d in dynamics])
        self._stiffness = np.array([d.stiffness for d in dynamics])
        self._friction = np.array([d.frictionloss for d in dynamics])
        # what one radian a second, kept up for a step, takes off each joint's torque; all joints of a tendon share it
        per_actuator = self._kp * np.square(self.A).sum(axis=1)
        stiff = np.where(self.A != 0, per_actuator[:, None], 0.0).sum(axis=0) + self._stiffness
        self._resistance = self._damping + timestep * stiff
        # joints that follow another by a mechanism: q = multiplier * q of the leader
        names = list(robot.joint_names)
        self.coupled = [(names.index(c.joint), names.index(c.leader), c.multiplier) for c in robot.coupled_joints]

    def motors(self, q: FloatArray, dq: FloatArray, command: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return target velocities (n,) rad/s and greatest torques (n,) Nm of the motors for the next step."""
        force = self._kp * (command - self.A @ q - self.b)
        torque = self.A.T @ force - self._stiffness * q
        driving = np.sign(torque) * np.maximum(np.abs(torque) - self._friction, 0.0)
        strength = np.abs(torque) + self._damping * np.abs(dq) + self._friction
        return driving / self._resistance, strength
