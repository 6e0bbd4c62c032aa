"""Contract of robots."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import ConfigError
from icub_core.geometry import FloatArray, is_rigid, rotation_log
from icub_core.interfaces.abilities import ChecksCollisions, HasGaze
from icub_core.interfaces.robot import Robot
from icub_core.robot_description import Actuator, Grip
from icub_core.scene import Table
from icub_testing.checks import Make
from icub_testing.expect import expect, expect_close, expect_raises, expect_same

STEP = 1e-6
"""Of finite differences, rad or m."""
JACOBIAN_TOLERANCE = 1e-4


def _hand(robot: Robot) -> str:
    return robot.description.hand().frame


def _reach(robot: Robot) -> NDArray[np.intp]:
    """Return which joints carry the first hand."""
    return robot.description.indices(robot.description.hand().reach)


def _reachable_poses(robot: Robot, count: int = 5) -> list[tuple[FloatArray, FloatArray]]:
    """Draw joint vectors near home within the limits, and where the hand then is."""
    d = robot.description
    rng = np.random.default_rng(0)
    joints = _reach(robot)
    found = []
    for _ in range(count):
        q = d.home_q
        q[joints] += rng.uniform(-0.2, 0.2, len(joints))
        q = np.clip(q, d.lower, d.upper)
        found.append((q, robot.forward_kinematics(q, _hand(robot))))
    return found


def check_description(make: Make) -> None:
    """The description is one object whose names, sizes and limits agree with each other."""
    robot = make()
    d = robot.description
    expect(d is robot.description, "the same description at every call", "another one")
    n = len(d.joint_names)
    expect(len(set(d.joint_names)) == n, "joint names once each", "a name twice")
    expect(d.lower.shape == d.upper.shape == (n,), f"limits of shape ({n},)", (d.lower.shape, d.upper.shape))
    expect(np.all(np.isfinite(d.lower) & np.isfinite(d.upper)), "finite limits", "infinite ones")
    expect(np.all(d.lower < d.upper), "lower < upper", d.joint_names[int(np.argmin(d.upper - d.lower))])
    names = set(d.joint_names)
    for group, members in d.groups.items():
        expect(set(members) <= names, f"known joints in group '{group}'", sorted(set(members) - names))
    for actuator in d.actuators:
        expect(
            set(actuator.coefficients) <= names, f"known joints for actuator '{actuator.name}'", actuator.coefficients
        )
        expect(actuator.range[0] < actuator.range[1], f"a range of actuator '{actuator.name}'", actuator.range)
    _expect_hands(robot)
    expect(set(d.home) <= names, "known joints in the home pose", sorted(set(d.home) - names))
    expect(d.urdf.is_file(), "a URDF file", d.urdf)


def _expect_hands(robot: Robot) -> None:
    d = robot.description
    known = {actuator.name: actuator for actuator in d.actuators}
    for name, hand in d.hands.items():
        expect(hand.name == name, f"the name '{name}' of a hand", hand.name)
        expect(hand.reach in d.groups, f"a joint group that carries the hand '{name}'", hand.reach)
        missing = [actuator for actuator in hand.actuators if actuator not in known]
        expect(not missing, f"known actuators of the hand '{name}'", missing)
        still = [actuator for actuator in hand.actuators if not known[actuator].step > 0]
        expect(not still, f"a step above 0 of every actuator of the hand '{name}'", still)
        outside = [a for a in hand.actuators if not _within(known[a])]
        expect(not outside, f"open and close of the hand '{name}' within the actuators' ranges", outside)
        if hand.grip is not None:
            _expect_grip(name, hand.grip)


def _within(actuator: Actuator) -> bool:
    low, high = actuator.range
    return low <= actuator.open <= high and low <= actuator.close <= high


def _expect_grip(name: str, grip: Grip) -> None:
    frames = (grip.T_hand_grip, *(() if grip.T_hand_jaw is None else (grip.T_hand_jaw,)))
    expect(all(is_rigid(T) for T in frames), f"rigid frames of the grip of the hand '{name}'", frames)
    expect(grip.width > 0 and grip.depth > 0, f"width and depth of the hand '{name}' above 0", (grip.width, grip.depth))
    expect(len(grip.fingers_y) > 0, f"at least one place where fingers of the hand '{name}' close", "none")
    low, high = np.asarray(grip.sweep).T
    expect(np.all(low < high), f"lowest before highest in the sweep of the hand '{name}'", grip.sweep)
    expect(grip.yaws[0] < grip.yaws[1], f"lowest before highest yaw of the hand '{name}'", grip.yaws)


def check_home(make: Make) -> None:
    """The home pose lies within the limits."""
    d = make().description
    outside = [
        name for name, q, lo, hi in zip(d.joint_names, d.home_q, d.lower, d.upper, strict=True) if not lo <= q <= hi
    ]
    expect(not outside, "every joint of home_q within its limits", outside)


def check_frames(make: Make) -> None:
    """Hand frames and fingertips have a rigid pose; an unknown frame raises ConfigError."""
    robot = make()
    d = robot.description
    for frame in (link for hand in d.hands.values() for link in (hand.frame, *hand.fingertips)):
        expect(is_rigid(robot.forward_kinematics(d.home_q, frame)), f"a rigid pose of '{frame}'", "another matrix")
    expect_raises(ConfigError, lambda: robot.forward_kinematics(d.home_q, "no_such_frame"), "for an unknown frame")


def check_forward_kinematics(make: Make) -> None:
    """Forward kinematics is a pure function of q."""
    robot = make()
    (q, T), (other, _), *_ = _reachable_poses(robot)
    before = q.copy()
    robot.forward_kinematics(other, _hand(robot))
    expect_same(T, robot.forward_kinematics(q, _hand(robot)), "the pose at one q, asked for twice")
    expect_same(q, before, "q before and after")
    expect(not np.allclose(T, robot.forward_kinematics(other, _hand(robot))), "another pose at another q", "the same")


def check_jacobian(make: Make) -> None:
    """The Jacobian agrees with finite differences: linear, then angular velocity in world axes."""
    robot = make()
    q, _ = _reachable_poses(robot)[0]
    J = robot.jacobian(q, _hand(robot))
    n = len(robot.description.joint_names)
    expect(J.shape == (6, n), f"a Jacobian of (6, {n})", J.shape)
    numeric = np.zeros((6, n))
    for i in range(n):
        step = np.zeros(n)
        step[i] = STEP
        after, before = (
            robot.forward_kinematics(q + step, _hand(robot)),
            robot.forward_kinematics(q - step, _hand(robot)),
        )
        numeric[:3, i] = (after - before)[:3, 3] / (2 * STEP)
        numeric[3:, i] = rotation_log(after[:3, :3] @ before[:3, :3].T) / (2 * STEP)
    expect_close(J, numeric, JACOBIAN_TOLERANCE, "the Jacobian and finite differences")


def check_pose_and_jacobian(make: Make) -> None:
    """Pose and Jacobian asked for together are those asked for one by one."""
    robot = make()
    q, _ = _reachable_poses(robot)[0]
    pose, J = robot.pose_and_jacobian(q, _hand(robot))
    expect_close(pose, robot.forward_kinematics(q, _hand(robot)), 1e-9, "the pose")
    expect_close(J, robot.jacobian(q, _hand(robot)), 1e-9, "the Jacobian")


def check_inverse_kinematics(make: Make) -> None:
    """Poses of joint vectors near home are reached, and truly so."""
    robot = make()
    for _, T in _reachable_poses(robot):
        solution = robot.inverse_kinematics(T, robot.description.home_q, _hand(robot))
        expect(
            solution.reached, "a pose that has a solution to be reached", f"{1e3 * solution.position_error:.1f} mm off"
        )
        there = robot.forward_kinematics(solution.q, _hand(robot))
        error = float(np.linalg.norm(there[:3, 3] - T[:3, 3]))
        angle = float(np.linalg.norm(rotation_log(there[:3, :3].T @ T[:3, :3])))
        expect(
            error <= 1e-3 + 1e-9 and angle <= 1e-2 + 1e-9,
            "1 mm and 0.01 rad at most",
            f"{error:.4f} m, {angle:.4f} rad",
        )
        expect_close(solution.position_error, error, 1e-6, "the reported position error")


def check_ik_limits(make: Make) -> None:
    """Solutions keep the joint limits, also for poses that cannot be reached."""
    robot = make()
    d = robot.description
    for offset in (0.0, 0.1, 1.0, 10.0):
        T = robot.forward_kinematics(d.home_q, _hand(robot))
        T[:3, 3] += offset
        q = robot.inverse_kinematics(T, d.home_q, _hand(robot)).q
        inside = (q >= d.lower - 1e-9) & (q <= d.upper + 1e-9)
        expect(inside.all(), "joints within their limits", [d.joint_names[i] for i in np.nonzero(~inside)[0]])


def check_ik_unreachable(make: Make) -> None:
    """A pose out of reach, or not finite, is answered with reached=False, never with an exception."""
    robot = make()
    for T in (np.full((4, 4), np.nan), np.diag([1.0, 1.0, 1.0, 1.0]) + np.eye(4, k=3) * 50.0):
        solution = robot.inverse_kinematics(T, robot.description.home_q, _hand(robot))
        expect(not solution.reached, "reached=False for a pose out of reach", "reached=True")


def check_ik_group(make: Make) -> None:
    """Joints outside the solved group keep their start, and the start is not changed."""
    robot = make()
    d = robot.description
    start = d.home_q
    _, T = _reachable_poses(robot)[1]
    q = robot.inverse_kinematics(T, start, _hand(robot)).q
    others = np.setdiff1d(np.arange(len(start)), d.indices(robot.description.hand().reach))
    expect_same(q[others], d.home_q[others], "joints outside the group")
    expect_same(start, d.home_q, "the start before and after")


def check_ik_batch(make: Make) -> None:
    """Many targets at once give as many answers; none give none."""
    robot = make()
    poses = np.stack([T for _, T in _reachable_poses(robot, 3)])
    answers = robot.inverse_kinematics_batch(poses, robot.description.home_q, _hand(robot))
    expect(len(answers) == 3, "3 answers to 3 targets", len(answers))
    none = robot.inverse_kinematics_batch(np.zeros((0, 4, 4)), robot.description.home_q, _hand(robot))
    expect(len(none) == 0, "no answers to no targets", len(none))


def check_gaze(make: Make) -> None:
    """Gaze control, where there is any, turns only some joints, within their limits, and answers out of reach too."""
    robot: Robot = make()
    d = robot.description
    if not isinstance(robot, HasGaze):
        return
    camera = d.camera().name
    for point in ([-0.4, 0.0, 1.0], [-0.3, 0.2, 1.1], [5.0, 0.0, 1.0]):
        start = d.home_q
        answer = robot.gaze(np.array(point), start)
        named = robot.gaze(np.array(point), start, camera)
        expect_same(answer.q, named.q, "the answer for the first camera, named and not named")
        inside = (answer.q >= d.lower - 1e-9) & (answer.q <= d.upper + 1e-9)
        expect(inside.all(), "joints within their limits", [d.joint_names[i] for i in np.nonzero(~inside)[0]])
        expect_same(start, d.home_q, "the start before and after")
        reach = _reach(robot)
        expect_same(answer.q[reach], d.home_q[reach], "joints that carry the hand")
        expect(np.isfinite(answer.angle) and answer.angle >= 0, "an angle of 0 or more", answer.angle)


def check_collisions(make: Make) -> None:
    """A collision check, where there is any, finds nothing at home, and the table when the hand is in it."""
    robot: Robot = make()
    d = robot.description
    if not isinstance(robot, ChecksCollisions):
        return
    touching = robot.collisions(d.home_q, Table())
    expect(touching == (), "no contacts at home", touching)
    hand = robot.forward_kinematics(d.home_q, _hand(robot))[:3, 3]
    around_the_hand = Table(center=(float(hand[0]), float(hand[1]), float(hand[2])))
    found = robot.collisions(d.home_q, around_the_hand)
    expect(any("table" in pair for pair in found), "a contact with a table around the hand", found or "none")
