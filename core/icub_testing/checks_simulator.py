"""Contract of simulators, in a small world: the tiny robot, a table, two boxes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from icub_core.errors import ConfigError, IcubError
from icub_core.geometry import FloatArray, look_at, make_transform
from icub_core.interfaces.abilities import ChangesAppearance
from icub_core.interfaces.simulator import Fault, Simulator
from icub_core.scene import CameraView, Material, Scene
from icub_testing.checks import Make
from icub_testing.expect import expect, expect_close, expect_raises, expect_same
from icub_testing.tiny.robot import CAMERA, HAND_FRAME, TinyRobot
from icub_testing.tiny.things import TinyObjects

SETTLED = 0.01
"""Meters that a resting object may creep in half a second."""
RENDERING_ERROR = 0.01
"""Meters by which rendered points may miss the surface, one pixel's footprint at 1 m included."""
PIXEL_ERROR = 0.3
"""Pixels; half a pixel is what a wrong convention costs."""
TRACKING_ERROR = 0.05
"""rad or m between a servo and its target after two seconds without load."""


@contextmanager
def _world(make: Make, robot: bool = True) -> Iterator[Simulator]:
    simulator: Simulator = make()
    try:
        simulator.load(TinyRobot().description if robot else None, _scene())
        simulator.reset()
        yield simulator
    finally:
        simulator.close()


def _scene() -> Scene:
    objects = TinyObjects()
    return Scene(objects=(objects.get("red"), objects.get("blue")))


def _place(name: str, x: float, y: float) -> FloatArray:
    """Where an object stands on the table: (4, 4)."""
    scene = _scene()
    assert scene.table is not None
    return make_transform(None, [x, y, scene.table.top + TinyObjects().get(name).rest_height])


def _from_above(x: float, y: float) -> CameraView:
    """A camera one meter above the table."""
    table = _scene().table
    assert table is not None
    return CameraView(look_at([x, y, table.top + 1.0], [x, y, table.top], up=(1.0, 0.0, 0.0)), fovy=0.7)


def _seen(simulator: Simulator, view: CameraView) -> set[int]:
    segmentation = simulator.render(view, 80, 60, segmentation=True).segmentation
    assert segmentation is not None
    return set(np.unique(segmentation).tolist())


def _a_run(simulator: Simulator) -> FloatArray:
    """Place an object, move, and return everything that is measured."""
    simulator.reset()
    simulator.set_object_pose("red", _place("red", -0.35, 0.05))
    targets = simulator.robot_state().actuator_positions + 0.05
    simulator.set_targets(targets)
    simulator.step(60)
    state = simulator.robot_state()
    return np.concatenate([state.q, state.dq, simulator.object_pose("red").reshape(-1), [simulator.time]])


def check_before_load(make: Make) -> None:
    """Nothing works before a world is loaded, and the error says so."""
    simulator = make()
    expect_raises(IcubError, simulator.reset, "for reset before load")
    expect_raises(IcubError, simulator.step, "for step before load")
    expect_raises(IcubError, lambda: simulator.render(_from_above(0.0, 0.0)), "for render before load")
    simulator.close()


def check_reset(make: Make) -> None:
    """After reset the time is 0, the robot rests at home, and no object is in sight."""
    with _world(make) as simulator:
        _a_run(simulator)
        simulator.reset()
        state = simulator.robot_state()
        expect(simulator.time == 0.0, "time 0", simulator.time)
        expect_close(state.q, TinyRobot().description.home_q, 1e-9, "q and the home pose")
        expect_close(state.dq, np.zeros_like(state.dq), 1e-9, "dq and zero")
        expect(_seen(simulator, _from_above(-0.35, 0.05)) == {-1}, "no object on the table", "one")
        simulator.step(20)
        expect_close(simulator.robot_state().q, TinyRobot().description.home_q, TRACKING_ERROR, "q and home, held")


def check_time(make: Make) -> None:
    """step(n) advances the time by exactly n timesteps."""
    with _world(make) as simulator:
        simulator.step()
        simulator.step(7)
        expect_close(simulator.time, 8 * simulator.scene.timestep, 1e-9, "the time after 8 steps")


def check_tick(make: Make) -> None:
    """tick(seconds) advances the time by the nearest whole number of timesteps, at least one."""
    with _world(make) as simulator:
        timestep = simulator.scene.timestep
        for seconds, steps in ((10 * timestep, 10), (10.4 * timestep, 10), (0.1 * timestep, 1)):
            before = simulator.time
            simulator.tick(seconds)
            expect_close(simulator.time - before, steps * timestep, 1e-9, f"the time that tick({seconds:g}) takes")


def check_image(make: Make) -> None:
    """image(camera) is what that camera of the robot renders; an unknown camera raises ConfigError."""
    with _world(make) as simulator:
        simulator.set_object_pose("red", _place("red", -0.35, 0.0))
        image, rendered = simulator.image(CAMERA, 80, 60), simulator.render(CAMERA, 80, 60).frame
        expect_same(image.rgb, rendered.rgb, "the image and the rendering of one camera")
        expect_same(image.depth, rendered.depth, "the depth of both")
        expect_same(image.T_world_camera, rendered.T_world_camera, "the pose of both")
        expect_raises(ConfigError, lambda: simulator.image("no_such_camera"), "for an image of an unknown camera")


def check_hand_and_object(make: Make) -> None:
    """hand_and_object gives what its parts give, also after the world has moved."""
    hand = TinyRobot().description.hand()
    with _world(make) as simulator:
        simulator.set_object_pose("red", _place("red", -0.35, 0.0))
        for _ in range(2):
            simulator.set_targets(simulator.actuator_positions() + 0.05)
            simulator.step(10)
            pose, lengths, contacts, position = simulator.hand_and_object(hand.frame, hand.name, "red")
            expect_close(pose, simulator.link_pose(hand.frame), 1e-9, "the pose of the hand")
            expect_same(lengths, simulator.actuator_positions(), "actuator lengths")
            expect_same(contacts, simulator.fingertip_contacts(hand.name), "fingertip contacts")
            expect_same(position, simulator.object_pose("red")[:3, 3], "the position of the object")


def check_repeatable(make: Make) -> None:
    """The same calls give exactly the same, in one world and in two."""
    with _world(make) as simulator:
        first, again = _a_run(simulator), _a_run(simulator)
    with _world(make) as simulator:
        other = _a_run(simulator)
    expect_same(first, again, "the same run twice in one world")
    expect_same(first, other, "the same run in two worlds")


def check_joint_order(make: Make) -> None:
    """Joints are ordered as the description's, and teleporting puts them where they were told."""
    d = TinyRobot().description
    q = d.lower + (d.upper - d.lower) * np.linspace(0.3, 0.5, len(d.joint_names))
    with _world(make) as simulator:
        simulator.set_joint_positions(q)
        state = simulator.robot_state()
        A, b = d.actuator_matrix()
        expect_close(state.q, q, 1e-9, "q and what it was set to")
        expect_close(state.dq, np.zeros_like(q), 1e-9, "dq and zero")
        expect_close(state.actuator_positions, A @ q + b, 1e-6, "actuator lengths and A q + b")
        simulator.step(20)
        held = simulator.robot_state().actuator_positions
        expect_close(held, A @ q + b, TRACKING_ERROR, "actuator lengths a moment after teleporting")


def check_kinematics(make: Make) -> None:
    """Link poses agree with the robot's forward kinematics."""
    robot = TinyRobot()
    d = robot.description
    q = d.lower + (d.upper - d.lower) * np.linspace(0.3, 0.6, len(d.joint_names))
    with _world(make) as simulator:
        simulator.set_joint_positions(q)
        for link in (HAND_FRAME, *d.hand().fingertips):
            expect_close(simulator.link_pose(link), robot.forward_kinematics(q, link), 1e-6, f"the pose of '{link}'")


def check_shortcuts(make: Make) -> None:
    """Joint and actuator positions asked for alone are those of the robot's state."""
    with _world(make) as simulator:
        simulator.set_targets(simulator.actuator_positions() + 0.05)
        simulator.step(10)
        state = simulator.robot_state()
        expect_close(simulator.joint_positions(), state.q, 1e-12, "joint positions and those of the state")
        expect_close(simulator.actuator_positions(), state.actuator_positions, 1e-12, "lengths and those of the state")


def check_appearance(make: Make) -> None:
    """Looks, where they can be changed, change images and nothing else."""
    view = _from_above(-0.35, 0.0)
    with _world(make) as simulator:
        before, state = simulator.render(view, 40, 30).frame, simulator.save_state()
        if not isinstance(simulator, ChangesAppearance):
            return
        simulator.set_appearance(table=Material(rgba=(0.1, 0.9, 0.1, 1.0)))
        after = simulator.render(view, 40, 30).frame
        expect(not np.array_equal(before.rgb, after.rgb), "another image of a green table", "the same")
        expect_same(before.depth, after.depth, "depth before and after")
        expect_same(state, simulator.save_state(), "the state before and after")


def check_targets(make: Make) -> None:
    """Actuators go to their targets, in the order of the description, and not beyond their ranges."""
    d = TinyRobot().description
    with _world(make) as simulator:
        start = simulator.robot_state().actuator_positions
        ranges = np.array([a.range for a in d.actuators])
        targets = np.clip(start + np.linspace(0.02, 0.2, len(start)), ranges[:, 0], ranges[:, 1])
        simulator.set_targets(targets)
        simulator.step(400)
        expect_close(simulator.robot_state().actuator_positions, targets, TRACKING_ERROR, "lengths and targets")
        simulator.set_targets(np.full(len(start), -100.0))
        simulator.step(300)  # on the way there, one joint's swing carries another a little beyond its limit
        lowest = (simulator.robot_state().actuator_positions - ranges[:, 0]).min()
        expect(lowest > -TRACKING_ERROR, "targets clipped to the ranges", f"{lowest:.3f} below a range")


def check_object_poses(make: Make) -> None:
    """Objects are where they were put, stay there at rest, and vanish when parked."""
    with _world(make) as simulator:
        places = {"red": _place("red", -0.35, 0.1), "blue": _place("blue", -0.4, -0.1)}
        for name, T in places.items():
            simulator.set_object_pose(name, T)
        for name, T in places.items():
            expect_close(simulator.object_pose(name), T, 1e-9, f"the pose of '{name}' and what it was set to")
        simulator.step(100)
        for name, T in places.items():
            expect_close(simulator.object_pose(name)[:3, 3], T[:3, 3], SETTLED, f"the place of '{name}', resting")
        view = _from_above(-0.375, 0.0)
        expect(_seen(simulator, view) >= {0, 1}, "both objects in sight", _seen(simulator, view))
        simulator.park_object("red")
        expect(_seen(simulator, view) == {-1, 1}, "the second object alone in sight", _seen(simulator, view))


def check_unknown_names(make: Make) -> None:
    """Unknown objects, links and cameras raise ConfigError with the known ones."""
    with _world(make) as simulator:
        pose = make_transform()
        calls = {
            "object_pose": lambda: simulator.object_pose("rde"),
            "set_object_pose": lambda: simulator.set_object_pose("rde", pose),
            "park_object": lambda: simulator.park_object("rde"),
            "touching": lambda: simulator.touching("rde"),
            "link_pose": lambda: simulator.link_pose("no_such_link"),
            "render": lambda: simulator.render("no_such_camera"),
        }
        for name, call in calls.items():
            expect_raises(ConfigError, call, f"for an unknown name given to {name}")


def check_save_and_restore(make: Make) -> None:
    """From a restored state the same future follows."""
    with _world(make) as simulator:
        _a_run(simulator)
        saved = simulator.save_state()
        expect(saved.ndim == 1 and np.all(np.isfinite(saved)), "a finite vector", saved.shape)
        kept = saved.copy()

        def future() -> FloatArray:
            simulator.step(40)
            state = simulator.robot_state()
            return np.concatenate([state.q, state.dq, simulator.object_pose("red").reshape(-1), [simulator.time]])

        first = future()
        simulator.set_joint_positions(TinyRobot().description.home_q)
        simulator.park_object("red")
        simulator.restore_state(saved)
        expect_same(first, future(), "the future of one state")
        expect_same(saved, kept, "the saved vector before and after")


def check_rendering(make: Make) -> None:
    """Images have the size asked for, and depth in meters that agrees with the scene."""
    view = _from_above(-0.35, 0.0)
    with _world(make) as simulator:
        simulator.set_object_pose("red", _place("red", -0.35, 0.0))
        rendering = simulator.render(view, 100, 80, segmentation=True)
        frame = rendering.frame
        assert rendering.segmentation is not None
        expect(frame.rgb.shape == (80, 100, 3), "an image of (80, 100, 3)", frame.rgb.shape)
        expect(rendering.segmentation.shape == (80, 100), "a segmentation of (80, 100)", rendering.segmentation.shape)
        expect_close(frame.T_world_camera, view.T_world_camera, 1e-9, "the pose of the camera")
        spec = simulator.scene.objects[0]
        on_object, on_table = rendering.segmentation == 0, rendering.segmentation == -1
        expect(on_object.sum() > 20, "more than 20 pixels of the object", int(on_object.sum()))
        local = frame.to_cloud(on_object).points - simulator.object_pose("red")[:3, 3]
        beyond = float((np.abs(local) - np.asarray(spec.half_extents)).max())
        expect(
            beyond < RENDERING_ERROR, "depth that puts the object's pixels on the object", f"{100 * beyond:.1f} cm off"
        )
        top = simulator.scene.table.top if simulator.scene.table is not None else 0.0
        heights = frame.to_cloud(on_table).points[:, 2]
        expect_close(np.median(heights), top, RENDERING_ERROR, "the height of the table's pixels")


def check_pixels(make: Make) -> None:
    """Whole numbers are pixel centers: what lies on the camera's axis is seen at half (size - 1)."""
    with _world(make) as simulator:
        simulator.set_object_pose("red", _place("red", -0.35, 0.0))
        for width, height in ((100, 80), (101, 81)):
            rendering = simulator.render(_from_above(-0.35, 0.0), width, height, segmentation=True)
            assert rendering.segmentation is not None
            rows, columns = np.nonzero(rendering.segmentation == 0)
            middle = np.array([columns.mean(), rows.mean()])
            expect_close(
                middle, [(width - 1) / 2, (height - 1) / 2], PIXEL_ERROR, "the middle of an object on the axis"
            )
            K = rendering.frame.intrinsics
            expect_close(K[:2, 2], middle, PIXEL_ERROR, "the principal point in the intrinsics")
            expect_close(K[0, 0], 0.5 * height / np.tan(0.5 * 0.7), 0.5, "the focal length for a field of view of 0.7")


def check_background(make: Make) -> None:
    """Depth is 0 where nothing is hit."""
    with _world(make) as simulator:
        up = CameraView(look_at([0.0, 0.0, 3.0], [0.0, 0.0, 4.0], up=(1.0, 0.0, 0.0)))
        depth = simulator.render(up, 40, 30).frame.depth
        expect(not depth.any(), "depth 0 in the sky", f"up to {depth.max():.1f} m")


def check_segmentation(make: Make) -> None:
    """Segmentation numbers objects in the order of the scene, and is left out unless asked for."""
    with _world(make) as simulator:
        simulator.set_object_pose("blue", _place("blue", -0.35, 0.0))
        view = _from_above(-0.35, 0.0)
        expect(_seen(simulator, view) == {-1, 1}, "pixels of object 1 and of nothing", _seen(simulator, view))
        expect(simulator.render(view, 80, 60).segmentation is None, "no segmentation unless asked for", "one")


def check_cameras(make: Make) -> None:
    """A robot's camera stands where its description says, and can be turned to a point."""
    robot = TinyRobot()
    camera = robot.description.cameras[0]
    with _world(make) as simulator:
        T = simulator.render(CAMERA, 80, 60).frame.T_world_camera
        base = robot.forward_kinematics(robot.description.home_q, camera.link)
        expect_close(T[:3, 3], (base @ make_transform(None, camera.position))[:3, 3], 1e-6, "the place of the camera")
        point = np.array([-0.35, 0.2, 0.95])
        turned = simulator.render(CAMERA, 80, 60, look_at=point).frame.T_world_camera
        expect_close(turned[:3, 3], T[:3, 3], 1e-6, "the place of the turned camera")
        to_point = point - turned[:3, 3]
        expect_close(turned[:3, 2], to_point / np.linalg.norm(to_point), 1e-6, "the axis of the turned camera")


def check_contacts(make: Make) -> None:
    """Nothing is touched in the air; a fingertip inside an object touches it."""
    robot = TinyRobot()
    with _world(make) as simulator:
        simulator.set_object_pose("red", _place("red", -0.35, 0.3))
        simulator.step(5)
        expect(not simulator.touching("red"), "no contact far away", "one")
        expect(
            not simulator.fingertip_contacts().any(), "no fingertip contact in the air", simulator.fingertip_contacts()
        )
        tips = robot.description.hand().fingertips
        tip = tips[-1]
        simulator.set_object_pose("red", make_transform(None, simulator.link_pose(tip)[:3, 3]))
        simulator.step(1)
        contacts = simulator.fingertip_contacts()
        fits = contacts.shape == (len(tips),) and contacts.dtype == np.bool_
        expect(fits, f"{len(tips)} bool", (contacts.shape, contacts.dtype))
        expect(simulator.touching("red") and contacts[-1], f"a contact of '{tip}'", contacts.tolist())
        named = simulator.fingertip_contacts(robot.description.hand().name)
        expect_same(named, contacts, "contacts of the first hand, named and not named")
        expect_same(simulator.robot_state().fingertip_contacts, contacts, "contacts in the robot's state")


def check_faults(make: Make) -> None:
    """A command that is not finite is reported as a fault, not raised, and cleared by reset."""
    with _world(make) as simulator:
        expect(simulator.faults() == (), "no faults after reset", simulator.faults())
        targets = simulator.robot_state().actuator_positions
        targets[0] = np.nan
        simulator.set_targets(targets)
        simulator.step(5)
        expect(Fault.NOT_A_NUMBER in simulator.faults(), "the fault NOT_A_NUMBER", simulator.faults() or "none")
        simulator.reset()
        expect(simulator.faults() == (), "no faults after reset", simulator.faults())
        saved = simulator.save_state()
        simulator.set_targets(targets)
        simulator.step(1)
        simulator.restore_state(saved)
        expect(simulator.faults() == (), "no faults after restore_state", simulator.faults())


def check_load_again(make: Make) -> None:
    """Loading again replaces the world; a world without a robot works too."""
    with _world(make) as simulator:
        simulator.load(None, Scene(objects=(TinyObjects().get("green"),)))
        simulator.reset()
        expect([o.name for o in simulator.scene.objects] == ["green"], "the new scene", simulator.scene.objects)
        simulator.set_object_pose("green", make_transform(None, [-0.35, 0.0, 1.1]))
        simulator.step(2)
        expect_raises(ConfigError, lambda: simulator.object_pose("red"), "for an object of the world before")


def check_close(make: Make) -> None:
    """Closing twice, or before load, does no harm."""
    with _world(make) as simulator:
        simulator.close()
        simulator.close()
    make().close()
