"""The physics of one Bullet world: stepping, state, contacts, faults."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import ConfigError, SimulationError, unknown_name
from icub_core.geometry import FloatArray, invert, make_transform, matrix_to_quat_wxyz, quat_wxyz_to_matrix
from icub_core.interfaces.simulator import Fault
from icub_core.robot_description import RobotDescription
from icub_core.scene import Scene
from icub_simulators.limits import FASTEST_JOINT, FASTEST_OBJECT, FASTEST_SPIN
from icub_simulators.objects.mass_properties import mass_properties
from icub_simulators.pybullet.assembly import add_floor, add_object, add_table, load_robot, set_robot_contacts, xyzw
from icub_simulators.pybullet.client import connect
from icub_simulators.pybullet.servos import Servos

GRAVITY = 9.81
TOUCHING = 5e-4
"""Meters between surfaces that Bullet, which keeps a margin around convex shapes, still counts as a contact."""
SOLVER_ITERATIONS = 300
"""With 100 what a shaken hand holds creeps out of it: friction has not converged. 300 end within 5 mm of 1000."""
_OBJECT_NUMBERS = 13  # position, orientation, velocity, angular velocity


class World:
    """A Bullet server with a robot, a table and objects in it."""

    def __init__(self, robot: RobotDescription | None, scene: Scene) -> None:
        self.robot, self.scene = robot, scene
        self.client = client = connect()
        client.setPhysicsEngineParameter(
            fixedTimeStep=scene.timestep, numSubSteps=0, numSolverIterations=SOLVER_ITERATIONS,
            deterministicOverlappingPairs=1, enableConeFriction=1,
        )  # fmt: skip
        client.setGravity(0.0, 0.0, 0.0)  # a weight is put on what is not parked, nor carries itself
        self.floor = add_floor(client)
        self.table = add_table(client, scene.table) if scene.table is not None else None
        self._add_robot(robot)
        self._add_objects()
        self._empty = client.saveState()  # no contacts, nothing warm: every restored state starts from here
        self._steps = 0
        self._seen: set[Fault] = set()
        self._stale = True
        self._untouched: FloatArray | None = None
        self.reset()

    def _add_robot(self, robot: RobotDescription | None) -> None:
        client = self.client
        self.body, self.links, self._joints = -1, {}, []
        self._servos: Servos | None = None
        self._q, self._dq, self._command = np.zeros(0), np.zeros(0), np.zeros(0)
        self._fingers: dict[str, dict[int, int]] = {}
        if robot is None:
            return
        self.body = load_robot(client, robot)
        self.links = {client.getBodyInfo(self.body)[0].decode(): -1}
        joints = {}
        for i in range(client.getNumJoints(self.body)):
            info = client.getJointInfo(self.body, i)
            joints[info[1].decode()] = i
            self.links[info[12].decode()] = i
        for name in robot.joint_names:
            if name not in joints:
                raise SimulationError(
                    f"robot '{robot.name}' lists joint '{name}'; its URDF {robot.urdf} has no such joint"
                )
        self._joints = [joints[name] for name in robot.joint_names]
        set_robot_contacts(client, self.body, self.links, robot, self.floor)
        self._servos = Servos(robot, self.scene.timestep)
        self._fingers = {
            hand.name: {self.links[link]: finger for finger, link in enumerate(hand.fingertips)}
            for hand in robot.hands.values()
        }
        masses = {link: client.getDynamicsInfo(self.body, link)[0] for link in self.links.values() if link >= 0}
        self._weights = [] if robot.gravity_compensation else [(k, m) for k, m in masses.items() if m > 1e-5]

    def _add_objects(self) -> None:
        self._number = {item.name: i for i, item in enumerate(self.scene.objects)}
        self._masses = [mass_properties(item) for item in self.scene.objects]
        self._inertial = [make_transform(quat_wxyz_to_matrix(m.quat_wxyz), m.center) for m in self._masses]
        self.bodies = [
            add_object(self.client, item, mass, parking_place(i))
            for i, (item, mass) in enumerate(zip(self.scene.objects, self._masses, strict=True))
        ]
        self._object_of_body = {body: i for i, body in enumerate(self.bodies)}
        self.parked = np.ones(len(self.bodies), dtype=bool)

    @property
    def time(self) -> float:
        """Simulated seconds since reset."""
        return self._steps * self.scene.timestep

    def reset(self) -> None:
        """Time 0, home pose at rest, objects parked, faults cleared."""
        self._forget_contacts()
        self._steps = 0
        self._seen.clear()
        if self.robot is not None:
            self.set_joint_positions(self.robot.home_q)
        self._changed()

    def step(self, n: int) -> None:
        """Advance by n timesteps."""
        client = self.client
        for _ in range(n):
            self._detect()
            if self._servos is not None:
                velocities, torques = self._servos.motors(self._q, self._dq, self._command)
                client.setJointMotorControlArray(
                    self.body, self._joints, client.VELOCITY_CONTROL, targetVelocities=velocities, forces=torques
                )
                for link, mass in self._weights:
                    center = client.getLinkState(self.body, link)[0]
                    client.applyExternalForce(self.body, link, [0, 0, -GRAVITY * mass], center, client.WORLD_FRAME)
            for number in np.flatnonzero(~self.parked):
                self._pull_down(int(number))
            client.stepSimulation()
            self._steps += 1
            self._follow_coupled()
            self._read_joints()
            self._stale, self._untouched = True, None
        self._detect()

    def joint_positions(self) -> FloatArray:
        """Return q (n,), rad."""
        return self._q.copy()

    def joint_velocities(self) -> FloatArray:
        """Return dq (n,), rad/s."""
        return self._dq.copy()

    def actuator_positions(self) -> FloatArray:
        """Return the actuators' lengths (m,), rad."""
        return np.zeros(0) if self._servos is None else self._servos.A @ self._q + self._servos.b

    def set_joint_positions(self, q: FloatArray) -> None:
        """Teleport the robot, at rest, with targets that hold it."""
        q = np.asarray(q, dtype=np.float64)
        if q.shape != (len(self._joints),):
            raise SimulationError(f"joint vector has shape {q.shape}; expected ({len(self._joints)},)")
        if not np.all(np.isfinite(q)):
            self._seen.add(Fault.NOT_A_NUMBER)
            return
        if self._servos is None:
            return
        self._put_joints(q, np.zeros_like(q))
        self._command = np.clip(self._servos.A @ q + self._servos.b, self._servos.low, self._servos.high)
        self._changed()

    def set_targets(self, targets: FloatArray) -> None:
        """Command every actuator; a command that is not finite is a fault and changes nothing."""
        targets = np.asarray(targets, dtype=np.float64)
        if targets.shape != self._command.shape:
            raise SimulationError(
                f"command has shape {targets.shape}; expected {self._command.shape}, one per actuator"
            )
        if not np.all(np.isfinite(targets)):
            self._seen.add(Fault.NOT_A_NUMBER)
        elif self._servos is not None:
            self._command = np.clip(targets, self._servos.low, self._servos.high)
            self._untouched = None

    def link_pose(self, link: str) -> FloatArray:
        """Return T_world_link (4, 4)."""
        if link not in self.links:
            raise ConfigError(unknown_name("link", link, self.links))
        if self.links[link] < 0:
            assert self.robot is not None
            return self.robot.T_world_root.copy()
        state = self.client.getLinkState(self.body, self.links[link], computeForwardKinematics=1)
        return _transform(state[4], state[5])

    def number(self, name: str) -> int:
        """Return an object's place in the scene; raises ConfigError for an unknown one."""
        if name not in self._number:
            raise ConfigError(unknown_name("object in the scene", name, self._number))
        return self._number[name]

    def object_pose(self, name: str) -> FloatArray:
        """Return T_world_object (4, 4)."""
        number = self.number(name)
        T_world_inertia = _transform(*self.client.getBasePositionAndOrientation(self.bodies[number]))
        return np.asarray(T_world_inertia @ invert(self._inertial[number]))

    def set_object_pose(self, name: str, T_world_object: FloatArray) -> None:
        """Teleport an object, at rest."""
        number, T = self.number(name), np.asarray(T_world_object, dtype=np.float64)
        if not np.all(np.isfinite(T)):
            self._seen.add(Fault.NOT_A_NUMBER)
            return
        T_world_inertia = T @ self._inertial[number]
        self._put_object(number, T_world_inertia[:3, 3], xyzw(matrix_to_quat_wxyz(T_world_inertia[:3, :3])))
        self.parked[number] = False
        self._changed()

    def park_object(self, name: str) -> None:
        """Put an object far away, weightless."""
        self._park(self.number(name))
        self._changed()

    def fingertip_contacts(self, hand: str) -> NDArray[np.bool_]:
        """Return (t,) bool: which fingertips of a hand touch any object."""
        if hand not in self._fingers:
            raise ConfigError(unknown_name("hand with fingertips", hand, self._fingers))
        fingers = self._fingers[hand]
        touched = np.zeros(len(fingers), dtype=bool)
        for link, _ in self._robot_contacts():
            if link in fingers:
                touched[fingers[link]] = True
        return touched

    def touching(self, name: str) -> bool:
        """Return True if the robot touches the object anywhere."""
        number = self.number(name)
        return any(other == number for _, other in self._robot_contacts())

    def save(self) -> FloatArray:
        """Return joints, velocities, commands, objects and time as one vector, and continue from exactly that vector.

        Bullet's own memory of contacts (from which its solver starts) cannot be put into a vector. It is cleared here
        and in `restore`, so that what follows a saved state is bit for bit what follows the restored one.
        """
        if self._untouched is not None:
            return self._untouched.copy()
        rows = [np.array([self._steps], dtype=np.float64), self._q, self._dq, self._command, self.parked.astype(float)]
        for body in self.bodies:
            position, orientation = self.client.getBasePositionAndOrientation(body)
            rows += [np.array(v) for v in (position, orientation, *self.client.getBaseVelocity(body))]
        state = np.concatenate(rows)
        seen = set(self._seen)
        self.restore(state)
        self._seen = seen
        return state.copy()

    def restore(self, state: FloatArray) -> None:
        """Continue from `save`; raises SimulationError for a vector of another world."""
        state = np.array(state, dtype=np.float64)
        sizes = [
            1,
            len(self._q),
            len(self._q),
            len(self._command),
            len(self.bodies),
            _OBJECT_NUMBERS * len(self.bodies),
        ]
        if state.shape != (sum(sizes),):
            raise SimulationError(f"state has shape {state.shape}; this world's has ({sum(sizes)},)")
        steps, q, dq, command, parked, objects = np.split(state, np.cumsum(sizes)[:-1])
        self._forget_contacts()
        self._put_joints(q, dq)
        for number, row in enumerate(objects.reshape(-1, _OBJECT_NUMBERS)):
            self._put_object(number, row[:3], row[3:7].tolist(), row[7:10], row[10:])
        self._steps, self._command = int(steps[0]), command
        self.parked = parked > 0.5
        self._seen.clear()
        self._changed()
        self._untouched = state

    def faults(self) -> tuple[Fault, ...]:
        """Return what went wrong since the last reset or restore."""
        rows, limits = [self._dq], [np.full(len(self._dq), FASTEST_JOINT)]
        for number in np.flatnonzero(~self.parked):
            linear, angular = self.client.getBaseVelocity(self.bodies[number])
            rows += [np.array(linear), np.array(angular)]
            limits += [np.full(3, FASTEST_OBJECT), np.full(3, FASTEST_SPIN)]
        speed = np.abs(np.concatenate(rows))
        if not np.all(np.isfinite(speed)) or not np.all(np.isfinite(self._q)):
            self._seen.add(Fault.NOT_A_NUMBER)
        elif np.any(speed > np.concatenate(limits)):
            self._seen.add(Fault.EXPLODING_VELOCITY)
        return tuple(fault for fault in Fault if fault in self._seen)

    def close(self) -> None:
        """Stop the server."""
        if self.client is not None:
            self.client.disconnect()
            self.client = None

    def _forget_contacts(self) -> None:
        """Clear what the solver remembers: restoring alone keeps the contacts that exist now."""
        for number in range(len(self.bodies)):
            self._park(number)
        if self.robot is not None:
            home = self.robot.home_q
            self._put_joints(home, np.zeros_like(home))
        self.client.performCollisionDetection()
        self.client.restoreState(self._empty)

    def _changed(self) -> None:
        self._stale, self._untouched = True, None

    def _detect(self) -> None:
        """Find contacts at the present positions: once after every change, whether or not anybody asks for them."""
        if self._stale:
            self.client.performCollisionDetection()
            self._stale = False

    def _robot_contacts(self) -> list[tuple[int, int]]:
        """Return (link of the robot, number of the object) of every contact between them."""
        self._detect()
        if self.body < 0:
            return []
        found = []
        for contact in self.client.getContactPoints(bodyA=self.body) or ():
            number = self._object_of_body.get(contact[2])
            if number is not None and contact[8] <= TOUCHING:
                found.append((int(contact[3]), number))
        return found

    def _pull_down(self, number: int) -> None:
        body = self.bodies[number]
        position, _ = self.client.getBasePositionAndOrientation(body)
        weight = [0.0, 0.0, -GRAVITY * self.scene.objects[number].mass]
        self.client.applyExternalForce(body, -1, weight, position, self.client.WORLD_FRAME)

    def _park(self, number: int) -> None:
        self._put_object(number, parking_place(number), [0.0, 0.0, 0.0, 1.0])
        self.parked[number] = True

    def _put_object(
        self,
        number: int,
        position: FloatArray,
        orientation: list[float],
        velocity: FloatArray | None = None,
        spin: FloatArray | None = None,
    ) -> None:
        body = self.bodies[number]
        zero = [0.0, 0.0, 0.0]
        self.client.resetBasePositionAndOrientation(body, [float(v) for v in position], orientation)
        self.client.resetBaseVelocity(
            body, zero if velocity is None else velocity.tolist(), zero if spin is None else spin.tolist()
        )

    def _put_joints(self, q: FloatArray, dq: FloatArray) -> None:
        for joint, position, velocity in zip(self._joints, q, dq, strict=True):
            self.client.resetJointState(self.body, joint, float(position), float(velocity))
        self._q, self._dq = np.array(q, dtype=np.float64), np.array(dq, dtype=np.float64)

    def _read_joints(self) -> None:
        if self._joints:
            states = self.client.getJointStates(self.body, self._joints)
            self._q = np.array([state[0] for state in states])
            self._dq = np.array([state[1] for state in states])

    def _follow_coupled(self) -> None:
        """Put coupled joints where their mechanism holds them (Bullet's gear constraint is too soft for a grasp)."""
        if self._servos is None or not self._servos.coupled:
            return
        self._read_joints()
        for joint, leader, multiplier in self._servos.coupled:
            q, dq = multiplier * self._q[leader], multiplier * self._dq[leader]
            self.client.resetJointState(self.body, self._joints[joint], float(q), float(dq))


def parking_place(number: int) -> FloatArray:
    """World position (3,) of the parked object `number`."""
    return np.array([1000.0 + 2.0 * number, 0.0, 10.0])


def _transform(position: tuple[float, ...], quat_xyzw: tuple[float, ...]) -> FloatArray:
    x, y, z, w = quat_xyzw
    return make_transform(quat_wxyz_to_matrix((w, x, y, z)), position)
