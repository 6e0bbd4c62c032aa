"""The iCub, object sets and engines that the tests of this folder share."""

import importlib

import numpy as np
import pytest

from icub_core.geometry import make_transform, quat_wxyz_to_matrix, rotation_about
from icub_core.scene import Scene
from icub_robots.icub import ICub
from icub_simulators.objects.ycb_primitives import YcbPrimitives

ENGINES = {
    "mujoco": "icub_simulators.mujoco.simulator:Mujoco",
    "pybullet": "icub_simulators.pybullet.simulator:PyBullet",
}

EACH_ENGINE = ["mujoco", pytest.param("pybullet", marks=pytest.mark.pybullet)]


def make_engine(name):
    module, _, attribute = ENGINES[name].partition(":")
    return getattr(importlib.import_module(module), attribute)()


@pytest.fixture(params=EACH_ENGINE)
def engine(request):
    simulator = make_engine(request.param)
    yield simulator
    simulator.close()


@pytest.fixture(scope="session")
def icub():
    return ICub()


@pytest.fixture(scope="session")
def ycb():
    return YcbPrimitives()


@pytest.fixture(scope="module", params=EACH_ENGINE)
def world(request, icub, ycb):
    """One loaded world a module, with two objects; tests reset it first."""
    simulator = make_engine(request.param)
    simulator.load(icub.description, Scene(objects=(ycb.get("004_sugar_box"), ycb.get("005_tomato_soup_can"))))
    yield simulator
    simulator.close()


@pytest.fixture(scope="session")
def standing():
    """Where an object stands on the table: T_world_object as a function of the object, x, y and yaw."""
    return _standing


def _standing(spec, x=-0.35, y=0.0, yaw=0.0, top=0.95):
    R = rotation_about("z", yaw) @ quat_wxyz_to_matrix(spec.rest_quat_wxyz)
    return make_transform(R, np.array([x, y, top + spec.rest_height]))
