"""What only the Bullet engine promises."""

import numpy as np
import pytest

from icub_core.interfaces.simulator import Fault
from icub_core.scene import Geom, ObjectSpec, Scene
from icub_simulators.mujoco.simulator import Mujoco
from icub_simulators.objects.mass_properties import mass_properties
from icub_simulators.pybullet.simulator import PyBullet

pytestmark = pytest.mark.pybullet


def test_loading_prints_nothing(icub, capfd):
    simulator = PyBullet()
    simulator.load(icub.description, Scene())
    simulator.close()
    output = capfd.readouterr()
    assert output.out == ""
    assert output.err == ""


def test_speeds_beyond_anything_are_faults(ycb, standing):
    simulator = PyBullet()
    spec = ycb.get("005_tomato_soup_can")
    simulator.load(None, Scene(objects=(spec,)))
    simulator.set_object_pose(spec.name, standing(spec))
    world = simulator._world
    world.client.resetBaseVelocity(world.bodies[0], [0, 0, 1e3], [0, 0, 0])
    assert simulator.faults() == (Fault.EXPLODING_VELOCITY,)
    simulator.reset()
    assert simulator.faults() == ()
    simulator.close()


@pytest.mark.parametrize("shape", [("capsule", (0.02, 0.05)), ("ellipsoid", (0.02, 0.03, 0.05)), ("sphere", (0.03,))])
def test_masses_agree_with_the_other_engine(shape):
    """MuJoCo works out inertias by itself: an independent reference."""
    pieces = (
        Geom(*shape, position=(0.01, 0.0, 0.03), quat_wxyz=(0.9, 0.1, 0.3, 0.2)),
        Geom("cylinder", (0.03, 0.04), position=(0.0, -0.1, 0.0), quat_wxyz=(0.7, 0.7, 0.0, 0.1)),
        Geom("box", (0.02, 0.03, 0.01), position=(0.0, 0.1, 0.05), quat_wxyz=(0.8, 0.0, 0.3, 0.0)),
    )
    spec = ObjectSpec("odd", pieces, 0.4, (0.1, 0.2, 0.1), 0.1)
    ours = mass_properties(spec)
    simulator = Mujoco()
    simulator.load(None, Scene(objects=(spec,)))
    body = simulator.model.body("object/odd")
    np.testing.assert_allclose(ours.center, body.ipos, atol=1e-9)
    np.testing.assert_allclose(np.sort(ours.inertia), np.sort(body.inertia), rtol=1e-6)
    simulator.close()


def test_free_fingers_close_alike_in_both_engines(icub):
    """The same command ends at about the same lengths (where thumb and fingers meet), at a similar pace."""
    d = icub.description
    hand = d.actuator_indices(d.hand("right").actuators)
    paths = []
    for simulator in (Mujoco(), PyBullet()):
        simulator.load(d, Scene())
        targets = simulator.actuator_positions()
        for i in hand:
            targets[i] = 0.5 * sum(d.actuators[i].range)
        simulator.set_targets(targets)
        path = []
        for _ in range(6):
            simulator.step(50)
            path.append(simulator.actuator_positions()[hand])
        paths.append(np.array(path))
        simulator.close()
    np.testing.assert_allclose(paths[1][-1], paths[0][-1], atol=0.2)
    np.testing.assert_allclose(paths[1], paths[0], atol=0.35)
