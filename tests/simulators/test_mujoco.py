"""What only the MuJoCo engine promises: real faults, its solver settings, speed-minded internals."""

import dataclasses
import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from icub_core.errors import SimulationError
from icub_core.geometry import look_at, make_transform
from icub_core.interfaces.simulator import Fault
from icub_core.scene import CameraView, Scene
from icub_simulators.mujoco.builder import build_spec, compile_model
from icub_simulators.mujoco.simulator import Mujoco


@pytest.fixture
def loaded(icub, ycb):
    simulator = Mujoco()
    simulator.load(icub.description, Scene(objects=(ycb.get("004_sugar_box"),)))
    yield simulator
    simulator.close()


def test_a_velocity_that_is_no_number_resets_the_world_and_is_reported(loaded):
    loaded.data.qvel[3] = np.nan
    loaded.step(2)
    assert set(loaded.faults()) == {Fault.HIDDEN_RESET, Fault.NOT_A_NUMBER}
    assert np.all(np.isfinite(loaded.joint_positions()))
    loaded.reset()
    assert loaded.faults() == ()


def test_a_hidden_reset_is_seen_however_many_steps_follow(loaded):
    loaded.step(50)
    loaded.data.qvel[0] = np.inf
    loaded.step(200)
    assert Fault.HIDDEN_RESET in loaded.faults()
    loaded.step(5)
    assert Fault.HIDDEN_RESET in loaded.faults()  # until the next reset or restore


def test_an_exploding_velocity_is_reported(loaded):
    loaded.data.qvel[10] = 1e4
    assert loaded.faults() == (Fault.EXPLODING_VELOCITY,)


def test_dropped_contacts_are_reported(loaded, ycb, standing):
    spec = ycb.get("004_sugar_box")
    loaded.set_object_pose(spec.name, standing(spec))
    loaded.data.warning[int(mujoco.mjtWarning.mjWARN_CONTACTFULL)].number = 1
    assert loaded.faults() == (Fault.DROPPED_CONTACTS,)


def test_faults_are_forgotten_by_restore(loaded):
    state = loaded.save_state()
    loaded.data.qvel[3] = np.nan
    loaded.step(1)
    assert loaded.faults()
    loaded.restore_state(state)
    assert loaded.faults() == ()


def test_stepping_equals_the_engines_own_loop(loaded, ycb, standing):
    spec = ycb.get("004_sugar_box")
    loaded.set_object_pose(spec.name, standing(spec, yaw=0.4))
    loaded.set_targets(loaded.actuator_positions() + 0.1)
    model, plain = loaded.model, mujoco.MjData(loaded.model)
    state = loaded.save_state()[: mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION)]
    mujoco.mj_setState(model, plain, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    for _ in range(60):
        mujoco.mj_step(model, plain)
    loaded.step(25)
    loaded.step(35)
    np.testing.assert_array_equal(loaded.data.qpos, plain.qpos)
    np.testing.assert_array_equal(loaded.data.qvel, plain.qvel)


def test_masses_are_those_of_the_objects(loaded, ycb):
    body = loaded.model.body("object/004_sugar_box")
    x, y, z = (2 * h for h in ycb.get("004_sugar_box").half_extents)
    assert body.mass[0] == pytest.approx(0.514)
    inertia = 0.514 / 12 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
    np.testing.assert_allclose(np.sort(body.inertia), np.sort(inertia), rtol=1e-6)


def test_parked_objects_do_not_slow_physics_much(icub, ycb):
    """More contacts or constraints of parked objects would; count them instead of seconds."""
    simulator = Mujoco()
    simulator.load(icub.description, Scene(objects=tuple(ycb.get(n) for n in ycb.names)))
    simulator.step(10)
    assert simulator.data.ncon == 0
    simulator.close()


def test_physics_needs_no_graphics_library():
    code = (
        "import sys\n"
        "from icub_simulators.mujoco.simulator import Mujoco\n"
        "from icub_core.scene import Scene\n"
        "s = Mujoco(); s.load(None, Scene()); s.step(3)\n"
        "assert not any(m.startswith('OpenGL') for m in sys.modules), 'OpenGL was imported'\n"
    )
    environment = {**os.environ, "MUJOCO_GL": ""}
    environment.pop("MUJOCO_GL")
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_an_unknown_graphics_choice_is_one_clear_line(loaded, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "vulkan")
    with pytest.raises(SimulationError, match="egl, osmesa"):
        loaded.render("head_cam")


def test_no_graphics_library_names_the_packages(loaded, monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr("icub_support.gl._library_exists", lambda backend: False)
    with pytest.raises(SimulationError, match="apt-get install"):
        loaded.render("head_cam")


def test_a_state_of_a_world_in_another_order_is_refused(icub, ycb):
    """Both have as many numbers; the objects' places are swapped."""
    can, box = ycb.get("005_tomato_soup_can"), ycb.get("004_sugar_box")
    first, second = Mujoco(), Mujoco()
    first.load(icub.description, Scene(objects=(can, box)))
    second.load(icub.description, Scene(objects=(box, can)))
    with pytest.raises(SimulationError, match="another order"):
        second.restore_state(first.save_state())
    second.restore_state(second.save_state())


def test_commands_out_of_range_act_like_the_limit(loaded):
    start, far = loaded.save_state(), np.full(loaded.model.nu, 50.0)
    loaded.set_targets(far)
    loaded.step(40)
    asked = loaded.joint_positions()
    loaded.restore_state(start)
    loaded.set_targets(np.minimum(far, loaded.model.actuator_ctrlrange[:, 1]))
    loaded.step(40)
    np.testing.assert_array_equal(asked, loaded.joint_positions())


def test_the_solver_s_sparse_matrices_give_what_dense_ones_give(loaded, ycb, standing):
    """Where many contacts share an object; one release of the engine factorizes some sparse matrices wrongly."""
    spec, model, data = ycb.get("004_sugar_box"), loaded.model, loaded.data
    T = loaded.link_pose("r_hand_dh_frame")
    loaded.set_object_pose(spec.name, T @ make_transform(None, [0.03, 0.0, 0.06]))
    loaded.set_targets(model.actuator_ctrlrange[:, 1])
    most = 0
    for _ in range(40):
        loaded.step(2)
        warm, found = data.qacc_warmstart.copy(), []
        for kind in (mujoco.mjtJacobian.mjJAC_DENSE, mujoco.mjtJacobian.mjJAC_SPARSE):
            model.opt.jacobian = kind
            data.qacc_warmstart[:] = warm
            mujoco.mj_forward(model, data)
            found.append(data.qacc.copy())
        data.qacc_warmstart[:] = warm
        most = max(most, data.ncon)
        np.testing.assert_allclose(found[1], found[0], rtol=1e-6, atol=1e-6 * np.abs(found[0]).max())
    assert most >= 3


def test_objects_are_eliminated_last(loaded):
    """The order that keeps the fingers on one object from filling the solver's matrix; see `build_spec`."""
    robot, item = loaded._engine.index.qvel, loaded._engine.index.objects["004_sugar_box"].qvel
    assert item.stop <= robot.start


def test_warnings_are_not_written_beside_the_user(loaded, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    loaded.data.qvel[3] = np.nan
    loaded.step(2)
    assert list(tmp_path.iterdir()) == []
    assert "WARNING" not in capfd.readouterr().err


def test_links_that_cannot_move_are_no_bodies_but_have_poses(loaded, icub):
    q = icub.description.home_q + 0.05 * np.cos(np.arange(len(icub.description.home_q)))
    loaded.set_joint_positions(q)
    bodies = {loaded.model.body(i).name for i in range(loaded.model.nbody)}
    still = ["r_foot", "l_forearm", "r_hand_dh_frame", "r_hand_thumb_tip"]  # on the world, the chest and the hand
    assert not bodies & set(still)
    for link in [*still, "r_hand_index_3"]:
        np.testing.assert_allclose(loaded.link_pose(link), icub.forward_kinematics(q, link), atol=1e-6)


def test_gravity_pulls_a_robot_that_does_not_compensate_it(icub, ycb):
    """The weights of links that were merged into others count, too."""
    description = dataclasses.replace(icub.description, gravity_compensation=False)
    simulator = Mujoco()
    simulator.load(description, Scene(objects=(ycb.get("004_sugar_box"),)))
    weights = -simulator.data.xfrc_applied[:, 2] / 9.81
    spec = build_spec(description, Scene(), visual=False)
    links = compile_model(spec)
    static = sum(links.body_mass[i] for i in range(links.nbody) if links.body_weldid[i] == 0)
    assert weights.sum() == pytest.approx(links.body_mass.sum() - static)
    simulator.close()


def test_table_legs_are_left_out_only_where_the_top_hides_them(loaded):
    rng = np.random.default_rng(0)
    renderer, center = loaded._open_renderer(), np.array([-0.68, 0.0, 0.6])
    legs, left_out = renderer._legs, 0
    for k in range(60):  # from below the top, beside and above it
        eye = center + [rng.uniform(-2.0, 2.0), rng.uniform(-2.0, 2.0), rng.uniform(-0.2, 2.0)]
        view = CameraView(look_at(eye, center + rng.uniform(-0.4, 0.4, 3)), fovy=1.2)
        rendering = loaded.render(view, 160, 120).frame
        left_out += int(np.sum(renderer.model.geom_group[legs] == 5))
        renderer._legs = legs[:0]
        whole = loaded.render(view, 160, 120).frame
        renderer._legs = legs
        np.testing.assert_array_equal(rendering.rgb, whole.rgb, err_msg=f"image {k}")
        np.testing.assert_array_equal(rendering.depth, whole.depth, err_msg=f"image {k}")
    assert 20 < left_out < 200
