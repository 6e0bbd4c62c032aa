"""What every engine promises of a world with the iCub in it."""

from dataclasses import replace

import numpy as np
import pytest

from icub_core.errors import ConfigError, SimulationError
from icub_core.geometry import make_transform
from icub_core.interfaces.simulator import Fault
from icub_core.scene import Scene
from icub_robots.icub import ICub
from icub_testing.checks import checks


@pytest.mark.parametrize("name", list(checks("simulator")))
def test_contract(name, engine):
    checks("simulator")[name](type(engine))


def closing(description, world, steps=40):
    """Close the hand a little and return where everything got to."""
    targets = world.actuator_positions()
    hand = description.actuator_indices(description.hand("right").actuators)
    for k in range(steps):
        targets[hand] = [description.actuators[i].range[1] * k / steps for i in hand]
        world.set_targets(targets)
        world.step(5)
    return np.concatenate([world.joint_positions(), world.object_pose("004_sugar_box").ravel()])


def test_reset_forgets_everything(world, icub, ycb, standing):
    world.reset()
    fresh = world.save_state()
    world.set_object_pose("004_sugar_box", standing(ycb.get("004_sugar_box")))
    first = closing(icub.description, world)
    world.reset()
    np.testing.assert_array_equal(world.save_state(), fresh)
    world.set_object_pose("004_sugar_box", standing(ycb.get("004_sugar_box")))
    np.testing.assert_array_equal(closing(icub.description, world), first)


def test_steps_in_one_call_or_many_are_the_same(world, icub, ycb, standing):
    ends = []
    for pieces in ([30], [1] * 30, [7, 1, 22]):
        world.reset()
        world.set_object_pose("004_sugar_box", standing(ycb.get("004_sugar_box"), yaw=0.3))
        world.set_targets(world.actuator_positions() + 0.1)
        for n in pieces:
            world.step(n)
        assert world.time == pytest.approx(30 * world.scene.timestep, abs=1e-12)
        ends.append(world.save_state())
    np.testing.assert_array_equal(ends[0], ends[1])
    np.testing.assert_array_equal(ends[0], ends[2])


def test_step_of_nothing_changes_nothing(world):
    world.reset()
    before = world.save_state()
    world.step(0)
    np.testing.assert_array_equal(world.save_state(), before)


def test_forward_kinematics_agree_with_the_robots(world, icub):
    d = icub.description
    rng = np.random.default_rng(0)
    for _ in range(10):
        q = rng.uniform(d.lower, d.upper)
        world.set_joint_positions(q)
        np.testing.assert_allclose(world.joint_positions(), q, atol=1e-12)
        for link in ("head", "r_hand_dh_frame", *d.hand("right").fingertips):
            np.testing.assert_allclose(world.link_pose(link), icub.forward_kinematics(q, link), atol=1e-6)


def test_poses_and_joints_belong_to_the_same_moment(world, icub):
    world.reset()
    world.set_targets(world.actuator_positions() + 0.2)
    world.step(20)
    q = world.joint_positions()
    expected = icub.forward_kinematics(q, "r_hand_dh_frame")
    np.testing.assert_allclose(world.link_pose("r_hand_dh_frame"), expected, atol=1e-6)


def test_actuator_positions_are_the_weighted_sums(world, icub):
    world.reset()
    world.set_targets(world.actuator_positions() + 0.2)
    world.step(30)
    A, b = icub.description.actuator_matrix()
    np.testing.assert_allclose(world.actuator_positions(), A @ world.joint_positions() + b, atol=1e-9)
    state = world.robot_state()
    np.testing.assert_array_equal(state.q, world.joint_positions())
    np.testing.assert_array_equal(state.actuator_positions, world.actuator_positions())
    assert state.dq.shape == state.q.shape


def test_servos_arrive_and_commands_are_clipped(world, icub):
    d = icub.description
    world.reset()
    targets = world.actuator_positions()
    elbow = int(d.actuator_indices(("r_elbow",))[0])
    targets[elbow] = 1e3
    world.set_targets(targets)
    world.step(400)
    assert world.actuator_positions()[elbow] == pytest.approx(d.actuators[elbow].range[1], abs=0.02)
    assert world.faults() == ()


def test_the_arm_does_not_sag(world, icub):
    world.reset()
    world.set_joint_positions(icub.description.home_q)
    before = world.link_pose("r_hand_dh_frame")
    world.step(300)
    assert np.linalg.norm(world.link_pose("r_hand_dh_frame")[:3, 3] - before[:3, 3]) < 1e-3


def test_an_arm_that_does_not_carry_itself_sags(engine, icub):
    engine.load(replace(icub.description, gravity_compensation=False), Scene())
    before = engine.link_pose("r_hand_dh_frame")
    engine.step(300)
    sag = before[2, 3] - engine.link_pose("r_hand_dh_frame")[2, 3]
    assert 0.003 < sag < 0.02  # the thesis's model sags by 6 mm here


def test_nothing_is_touched_at_home(world, ycb, standing):
    world.reset()
    world.set_object_pose("005_tomato_soup_can", standing(ycb.get("005_tomato_soup_can")))
    world.step(100)
    assert not world.fingertip_contacts().any()
    assert not world.touching("005_tomato_soup_can")


def test_a_fingertip_feels_the_object_that_is_pressed_on_it(world, icub, ycb):
    for finger, link in enumerate(icub.description.hand("right").fingertips):
        world.reset()
        tip = world.link_pose(link)
        # its narrow end (z) lies across the end of the finger (x), 4 mm deep
        box = ycb.get("004_sugar_box")
        along = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
        place = make_transform(tip[:3, :3] @ along, tip[:3, 3] + tip[:3, 0] * (0.024 + 0.0875 - 0.004))
        world.set_object_pose(box.name, place)
        felt = world.fingertip_contacts()
        assert felt[finger], f"{link} feels nothing"
        assert world.touching(box.name)
        assert not world.touching("005_tomato_soup_can")


def test_a_saved_state_has_the_same_future(world, icub, ycb, standing):
    world.reset()
    world.set_object_pose("004_sugar_box", standing(ycb.get("004_sugar_box"), yaw=0.2))
    closing(icub.description, world, 10)
    state = world.save_state()
    first = closing(icub.description, world, 15)
    end = world.save_state()
    world.reset()
    closing(icub.description, world, 3)
    world.restore_state(state)
    np.testing.assert_array_equal(world.save_state(), state)
    np.testing.assert_array_equal(closing(icub.description, world, 15), first)
    np.testing.assert_array_equal(world.save_state(), end)


def test_a_saved_state_goes_to_another_world_of_the_same_kind(world, icub, ycb, standing):
    world.reset()
    world.set_object_pose("005_tomato_soup_can", standing(ycb.get("005_tomato_soup_can")))
    world.step(20)
    state = world.save_state()
    other = type(world)()
    other.load(icub.description, world.scene)
    other.restore_state(state)
    world.step(50)
    other.step(50)
    np.testing.assert_array_equal(other.save_state(), world.save_state())
    other.close()


def test_a_state_of_another_world_is_refused(world):
    world.reset()
    with pytest.raises(SimulationError, match="state"):
        world.restore_state(np.zeros(3))


def test_parked_objects_neither_fall_nor_come_back(world, ycb, standing):
    world.reset()
    world.step(200)
    parked = world.object_pose("004_sugar_box")
    assert np.linalg.norm(parked[:3, 3]) > 20
    world.set_object_pose("004_sugar_box", standing(ycb.get("004_sugar_box")))
    world.step(100)
    np.testing.assert_allclose(world.object_pose("004_sugar_box"), standing(ycb.get("004_sugar_box")), atol=2e-3)
    world.park_object("004_sugar_box")
    world.step(10)
    np.testing.assert_allclose(world.object_pose("004_sugar_box"), parked, atol=1e-6)


def test_a_dropped_object_falls_as_it_should(world):
    world.reset()
    world.set_object_pose("005_tomato_soup_can", make_transform(None, [-0.5, 0.3, 1.9]))
    world.step(40)
    fallen = 1.9 - world.object_pose("005_tomato_soup_can")[2, 3]
    assert fallen == pytest.approx(0.5 * 9.81 * 0.2**2, rel=0.05)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_command_that_is_no_number_is_a_fault_and_changes_nothing(world, bad):
    world.reset()
    world.step(5)
    targets = world.actuator_positions()
    world.set_targets(targets)
    targets[4] = bad
    world.set_targets(targets)
    assert world.faults() == (Fault.NOT_A_NUMBER,)
    world.step(5)
    assert np.all(np.isfinite(world.joint_positions()))
    world.reset()
    assert world.faults() == ()


def test_wrong_shapes_and_names_are_one_clear_line(world):
    with pytest.raises(SimulationError, match="shape"):
        world.set_targets(np.zeros(3))
    with pytest.raises(SimulationError, match="shape"):
        world.set_joint_positions(np.zeros(3))
    with pytest.raises(ConfigError, match="004_sugar_box"):
        world.object_pose("004_suger_box")
    with pytest.raises(ConfigError, match="r_hand"):
        world.link_pose("r_hnd")
    with pytest.raises(ConfigError, match="head_cam"):
        world.render("hed_cam")
    with pytest.raises(ConfigError, match="right"):
        world.fingertip_contacts("rigth")


def test_a_world_that_is_not_loaded_says_so(engine):
    with pytest.raises(SimulationError, match="load"):
        engine.step()
    engine.close()
    engine.close()


def test_an_urdf_that_does_not_exist_is_one_line(engine, icub, tmp_path):
    with pytest.raises(SimulationError, match="missing.urdf"):
        engine.load(replace(icub.description, urdf=tmp_path / "missing.urdf"), Scene())


def test_a_world_without_robot(engine, ycb, standing):
    spec = ycb.get("021_bleach_cleanser")
    engine.load(None, Scene(objects=(spec,), timestep=0.002))
    engine.set_object_pose(spec.name, standing(spec))
    engine.step(100)
    assert engine.time == pytest.approx(0.2)
    np.testing.assert_allclose(engine.object_pose(spec.name), standing(spec), atol=2e-3)
    assert engine.robot_state().q.shape == (0,)


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_all_ycb_objects_rest_where_they_were_put(engine, ycb, yaw, standing):
    specs = [ycb.get(name) for name in ycb.names]
    engine.load(None, Scene(objects=tuple(specs)))
    poses = {s.name: standing(s, -0.35 - 0.25 * (i % 2), -0.6 + 0.17 * i, yaw) for i, s in enumerate(specs)}
    for name, pose in poses.items():
        engine.set_object_pose(name, pose)
    engine.step(400)
    for name, pose in poses.items():
        now = engine.object_pose(name)
        assert np.linalg.norm(now[:3, 3] - pose[:3, 3]) < 3e-3, name
        assert np.trace(now[:3, :3].T @ pose[:3, :3]) > 1 + 2 * np.cos(0.02), name
    assert engine.faults() == ()


@pytest.mark.parametrize(
    "options",
    [{"hands": ("right", "left")}, {"hands": ("left",)}, {"coupling": "equal_split"}, {"weld": False}],
)
def test_every_variant_of_the_robot_closes_its_hands(engine, options):
    robot = ICub(**options)
    d = robot.description
    engine.load(d, Scene())
    targets = engine.actuator_positions()
    for hand in d.hands.values():
        fingers = d.actuator_indices(hand.actuators)
        targets[fingers] = [0.3 * sum(d.actuators[i].range) for i in fingers]
    engine.set_targets(targets)
    engine.step(300)
    assert engine.faults() == ()
    np.testing.assert_allclose(engine.actuator_positions(), targets, atol=0.15)
    q = engine.joint_positions()
    for hand in d.hands.values():
        np.testing.assert_allclose(engine.link_pose(hand.frame), robot.forward_kinematics(q, hand.frame), atol=1e-6)
    position = {name: q[i] for i, name in enumerate(d.joint_names)}
    for coupled in d.coupled_joints:
        assert position[coupled.joint] == pytest.approx(coupled.multiplier * position[coupled.leader], abs=0.03)


def test_what_a_grasping_task_reads_is_what_the_single_calls_say(world, ycb, standing):
    world.reset()
    spec = ycb.get("004_sugar_box")
    world.set_object_pose(spec.name, standing(spec, yaw=0.3))
    for _ in range(2):
        world.step(5)
        T, lengths, touch, position = world.hand_and_object("r_hand_dh_frame", "right", spec.name)
        np.testing.assert_allclose(T, world.link_pose("r_hand_dh_frame"), atol=1e-12)
        np.testing.assert_array_equal(lengths, world.actuator_positions())
        np.testing.assert_array_equal(touch, world.fingertip_contacts("right"))
        np.testing.assert_array_equal(position, world.object_pose(spec.name)[:3, 3])
    for frame, hand, name in [
        ("r_hnd", "right", spec.name),
        ("r_hand", "rihgt", spec.name),
        ("r_hand", "right", "box"),
    ]:
        with pytest.raises(ConfigError):
            world.hand_and_object(frame, hand, name)
