"""Forward and inverse kinematics: round trips, limits, honest answers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from icub_core.errors import ConfigError, DataError
from icub_core.geometry import make_transform, rotation_exp, rotation_log
from icub_robots.icub import ICub
from icub_robots.kinematics.batch import rotation_vectors

FRAME = "r_hand_dh_frame"
ROBOT = ICub()
D = ROBOT.description
REACH = D.indices("right_reach")

shares = st.lists(st.floats(0.0, 1.0), min_size=10, max_size=10).map(np.array)
seeds = st.integers(0, 2**32 - 1)


def posture(share: np.ndarray) -> np.ndarray:
    """Home, with torso and right arm at a share of their ranges (torso_pitch only up to its limit in IK)."""
    q = D.home_q
    upper = D.upper.copy()
    upper[D.joint_names.index("torso_pitch")] = 0.5
    q[REACH] = D.lower[REACH] + share * (upper - D.lower)[REACH]
    return q


def errors(robot, q, target, frame=FRAME):
    T = robot.forward_kinematics(q, frame)
    return np.linalg.norm(T[:3, 3] - target[:3, 3]), np.linalg.norm(rotation_log(target[:3, :3] @ T[:3, :3].T))


def assert_honest(solution, target, frame=FRAME, robot=ROBOT):
    """The solution's claims are true of its q, and q is within the limits."""
    d = robot.description
    position, orientation = errors(robot, solution.q, target, frame)
    assert solution.position_error == pytest.approx(position, abs=1e-7)
    assert solution.orientation_error == pytest.approx(orientation, abs=1e-6)
    assert solution.reached == (solution.position_error <= 1e-3 and solution.orientation_error <= 1e-2)
    assert np.all(solution.q >= d.lower)
    assert np.all(solution.q <= d.upper)
    assert solution.q[d.joint_names.index("torso_pitch")] <= 0.5
    for name in solution.limits_hit:
        i = d.joint_names.index(name)
        limits = [d.lower[i], d.upper[i], 0.5 if name == "torso_pitch" else d.upper[i]]
        assert min(abs(solution.q[i] - limit) for limit in limits) < 1e-6


@settings(max_examples=60, deadline=None)
@given(seeds)
def test_a_reachable_pose_is_reached(seed):
    """Targets are poses of random postures, drawn in the inner 90 % of the ranges."""
    target = ROBOT.forward_kinematics(posture(np.random.default_rng(seed).uniform(0.05, 0.95, 10)), FRAME)
    solution = ROBOT.inverse_kinematics(target, D.home_q, FRAME)
    assert_honest(solution, target)
    assert solution.reached


@settings(max_examples=60, deadline=None)
@given(shares, shares)
def test_answers_are_honest_and_within_limits_from_anywhere(start, goal):
    """Starts and goals include corners of the joint ranges and singular postures."""
    target = ROBOT.forward_kinematics(posture(goal), FRAME)
    assert_honest(ROBOT.inverse_kinematics(target, posture(start), FRAME), target)


@settings(max_examples=30, deadline=None)
@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3), st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_any_pose_gets_a_typed_answer(position, rotation):
    target = make_transform(rotation_exp(rotation), position)
    assert_honest(ROBOT.inverse_kinematics(target, D.home_q, FRAME), target)
    assert_honest(ROBOT.inverse_kinematics_batch([target], D.home_q, FRAME)[0], target)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_pose_that_is_not_finite_is_unreachable(value):
    target = np.eye(4)
    target[0, 3] = value
    good = ROBOT.forward_kinematics(D.home_q, FRAME)
    for solution in (
        ROBOT.inverse_kinematics(target, D.home_q, FRAME),
        ROBOT.inverse_kinematics_batch([good, target], D.home_q, FRAME)[1],
    ):
        assert not solution.reached
        assert np.array_equal(solution.q, D.home_q)
    assert ROBOT.inverse_kinematics_batch([good, target], D.home_q, FRAME)[0].reached


def test_a_pose_out_of_reach_is_not_reached_but_approached():
    target = ROBOT.forward_kinematics(D.home_q, FRAME)
    before = target[:3, 3].copy()
    target[:3, 3] += [-2.0, 0.0, 0.0]
    solution = ROBOT.inverse_kinematics(target, D.home_q, FRAME)
    assert not solution.reached
    assert 0.5 < solution.position_error < 2.0
    assert ROBOT.forward_kinematics(solution.q, FRAME)[0, 3] < before[0]


def test_the_start_is_kept_when_it_is_the_answer():
    solution = ROBOT.inverse_kinematics(ROBOT.forward_kinematics(D.home_q, FRAME), D.home_q, FRAME)
    assert solution.reached
    assert np.array_equal(solution.q, D.home_q)


def test_only_the_group_moves():
    start = posture(np.full(10, 0.5))
    target = ROBOT.forward_kinematics(start, FRAME)
    target[:3, 3] += [0.0, 0.0, 0.03]
    solution = ROBOT.inverse_kinematics(target, start, FRAME, group="right_arm")
    assert solution.reached
    moved = {name for name, a, b in zip(D.joint_names, start, solution.q, strict=True) if a != b}
    assert moved
    assert moved <= set(D.groups["right_arm"])
    batch = ROBOT.inverse_kinematics_batch([target], start, FRAME, group="right_arm")[0]
    assert np.allclose(batch.q, solution.q, atol=1e-6)


def test_tracking_follows_a_moving_target():
    """2 mm and 0.01 rad a step with two iterations: the error stays below a tenth of a step."""
    q, target = D.home_q, ROBOT.forward_kinematics(D.home_q, FRAME)
    turn = rotation_exp([-0.004, 0.006, -0.005])
    for _ in range(40):
        target = target.copy()
        target[:3, 3] += [-0.0012, 0.001, 0.0012]
        target[:3, :3] = turn @ target[:3, :3]
        solution = ROBOT.inverse_kinematics(target, q, FRAME, max_iterations=2)
        assert_honest(solution, target)
        assert solution.position_error < 2e-4
        assert np.abs(solution.q - q).max() < 0.1  # no jumps to another posture
        q = solution.q


def test_restarts_help():
    rng = np.random.default_rng(0)
    targets = [ROBOT.forward_kinematics(posture(rng.uniform(0.0, 1.0, 10)), FRAME) for _ in range(150)]
    reached = np.mean([ROBOT.inverse_kinematics(T, D.home_q, FRAME).reached for T in targets])
    alone = np.mean([s.reached for s in ROBOT.inverse_kinematics_batch(targets, D.home_q, FRAME)])
    assert alone > 0.9
    assert reached > 0.98
    assert reached > alone


def test_batch_equals_one_by_one():
    rng = np.random.default_rng(4)
    targets = np.array([ROBOT.forward_kinematics(posture(rng.uniform(0.3, 0.7, 10)), FRAME) for _ in range(60)])
    targets[::7, 0, 3] -= 2.0  # some out of reach
    batch = ROBOT.inverse_kinematics_batch(targets, D.home_q, FRAME)
    assert len(batch) == 60
    for target, solution in zip(targets, batch, strict=True):
        assert_honest(solution, target)
        single = ROBOT.inverse_kinematics(target, D.home_q, FRAME)
        assert single.reached or not solution.reached  # a batch has no restarts
        if solution.reached:
            assert np.allclose(single.q, solution.q, atol=1e-4)
    assert np.mean([s.reached for s in batch]) > 0.8
    assert ROBOT.inverse_kinematics_batch([], D.home_q, FRAME) == []


def test_the_left_hand_reaches_what_the_right_does(both_hands):
    d = both_hands.description
    start = d.home_q
    start[d.indices("left_arm")] = start[d.indices("right_arm")]
    for side in ("right", "left"):
        frame = d.hand(side).frame
        target = both_hands.forward_kinematics(start, frame)
        target[:3, 3] += [-0.04, 0.0, 0.02]
        solution = both_hands.inverse_kinematics(target, start, frame, group=f"{side}_reach")
        assert solution.reached
        assert_honest(solution, target, frame, both_hands)


@settings(max_examples=20, deadline=None)
@given(shares)
def test_jacobian_is_the_derivative_of_forward_kinematics(share):
    q, step = posture(share), 1e-6
    for frame in (FRAME, "r_hand_index_3"):
        T, J = ROBOT.pose_and_jacobian(q, frame)
        assert np.allclose(J, ROBOT.jacobian(q, frame), atol=1e-12)
        assert np.allclose(T, ROBOT.forward_kinematics(q, frame), atol=1e-12)
        for i in range(len(q)):
            nudge = np.zeros(len(q))
            nudge[i] = step
            ahead, behind = (ROBOT.forward_kinematics(q + s * nudge, frame) for s in (1, -1))
            linear = (ahead[:3, 3] - behind[:3, 3]) / (2 * step)
            angular = rotation_log(ahead[:3, :3] @ behind[:3, :3].T) / (2 * step)
            assert np.allclose(J[:, i], np.concatenate([linear, angular]), atol=1e-6)


def test_forward_kinematics_is_pure():
    q = D.home_q
    first = ROBOT.forward_kinematics(q, FRAME)
    ROBOT.forward_kinematics(posture(np.zeros(10)), "head")
    ROBOT.inverse_kinematics(first, posture(np.ones(10)), FRAME)
    assert np.array_equal(first, ROBOT.forward_kinematics(q, FRAME))
    assert np.array_equal(q, D.home_q)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3), st.sampled_from([0.0, 1e-9, 1e-3, 1.0, 3.0, np.pi]))
def test_rotation_vectors_invert_the_exponential(axis, angle):
    norm = np.linalg.norm(axis)
    vector = np.array(axis) * (angle / norm if norm > 1e-3 else 0.0)
    R = rotation_exp(vector)
    recovered = rotation_vectors(np.stack([R, np.eye(3)]))
    assert np.allclose(rotation_exp(recovered[0]), R, atol=1e-6)
    assert np.linalg.norm(recovered[0]) == pytest.approx(np.linalg.norm(vector), abs=1e-6)
    assert np.array_equal(recovered[1], np.zeros(3))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ROBOT.forward_kinematics(D.home_q, "r_hand_dh_frm"), "Did you mean 'r_hand_dh_frame'"),
        (lambda: ROBOT.jacobian(D.home_q, "haed"), "Did you mean 'head'"),
        (lambda: ROBOT.inverse_kinematics(np.eye(4), D.home_q, "r_hnd", group="right_arm"), "Did you mean 'r_hand'"),
        (lambda: ROBOT.inverse_kinematics(np.eye(4), D.home_q, "r_hand"), "'r_hand' is no hand's frame"),
        (lambda: ROBOT.inverse_kinematics(np.eye(4), D.home_q, FRAME, group="right_reech"), "'right_reach'"),
        (lambda: ROBOT.inverse_kinematics(np.eye(4), D.home_q, FRAME, group="left_reach"), "no joint group"),
        (lambda: ROBOT.inverse_kinematics(np.eye(4), D.home_q, "head", group="right_arm"), "neck_yaw"),
        (lambda: ROBOT.forward_kinematics(np.zeros(3), FRAME), "expected \\(32,\\)"),
    ],
)
def test_what_does_not_exist_is_named_with_a_suggestion(call, message):
    with pytest.raises(ConfigError, match=message):
        call()


def test_a_broken_start_is_refused():
    with pytest.raises(DataError, match="q_start"):
        ROBOT.inverse_kinematics(np.eye(4), np.full(32, np.nan), FRAME)
    with pytest.raises(DataError, match="q_start"):
        ROBOT.inverse_kinematics_batch([np.eye(4)], np.zeros(10), FRAME)


def test_without_a_group_the_joints_that_carry_the_hand_move(both_hands):
    start = both_hands.description.home_q
    for side in ("right", "left"):
        frame = f"{side[0]}_hand_dh_frame"
        target = both_hands.forward_kinematics(start, frame)
        target[:3, 3] += [-0.02, 0.0, 0.02]
        named = both_hands.inverse_kinematics(target, start, frame, group=f"{side}_reach")
        assert named.reached
        assert np.array_equal(both_hands.inverse_kinematics(target, start, frame).q, named.q)
