"""What the description promises: consistent names, home within limits, couplings and cameras as published."""

import numpy as np
import pytest

from icub_core.errors import ConfigError
from icub_core.geometry import invert, make_transform, quat_wxyz_to_matrix
from icub_robots.description import describe
from icub_robots.icub import ICub

HAND_ORDER = (
    "hand_finger",
    "thumb_oppose",
    "thumb_proximal",
    "thumb_distal",
    "index_proximal",
    "index_distal",
    "middle_proximal",
    "middle_distal",
    "pinky",
)


@pytest.mark.parametrize("hands", [("right",), ("left",), ("right", "left"), ()])
@pytest.mark.parametrize("weld", [True, False])
@pytest.mark.parametrize("limits", ["ikin", "urdf"])
def test_names_limits_and_home_fit_together(hands, weld, limits):
    d = describe(hands, limits, weld=weld)
    assert len(set(d.joint_names)) == len(d.joint_names)
    assert d.lower.shape == d.upper.shape == (len(d.joint_names),)
    assert np.all(d.lower < d.upper)
    assert np.all(d.home_q >= d.lower)
    assert np.all(d.home_q <= d.upper)
    for group in d.groups:
        assert len(d.indices(group)) == len(d.groups[group])
    A, b = d.actuator_matrix()
    lengths = A @ d.home_q + b
    for actuator, length in zip(d.actuators, lengths, strict=True):
        low, high = actuator.range
        assert low - 1e-6 <= length <= high + 1e-6
        assert low <= actuator.open <= high
        assert low <= actuator.close <= high


def test_only_what_moves_has_joints(icub, both_hands):
    assert len(icub.description.joint_names) == 3 + 3 + 7 + 19
    assert len(both_hands.description.joint_names) == 3 + 3 + 2 * (7 + 19)
    free = describe((), weld=False)
    assert {"r_knee", "l_elbow"} <= set(free.joint_names)
    assert len(free.joint_names) == 32  # as many as the body of icub-models has


def test_hand_actuators_come_last_in_the_order_of_observations(icub, both_hands):
    right = tuple(f"r_{name}" for name in HAND_ORDER)
    left = tuple(f"l_{name}" for name in HAND_ORDER)
    for robot in (icub, both_hands):
        assert tuple(a.name for a in robot.description.actuators[-9:]) == right
        assert robot.description.hand("right").actuators == right
    assert both_hands.description.hand("left").actuators == left
    assert set(right + left) <= {a.name for a in both_hands.description.actuators}


def test_spread_of_the_fingers_is_measured_from_fully_spread(icub):
    """Command 0 spreads index, ring and little finger by 20 degrees; 60 degrees brings them parallel."""
    actuator = next(a for a in icub.description.actuators if a.name == "r_hand_finger")
    spread = {"r_hand_index_0_joint": -20.0, "r_hand_ring_0_joint": 20.0, "r_hand_little_0_joint": 20.0}

    def length(scale):
        return actuator.offset + sum(
            c * np.deg2rad(scale * spread[joint]) for joint, c in actuator.coefficients.items()
        )

    assert length(1.0) == pytest.approx(0.0, abs=1e-9)
    assert np.rad2deg(length(0.0)) == pytest.approx(60.0)


def test_home_of_the_hand_is_open_with_the_thumb_opposed(icub):
    d = icub.description
    A, b = d.actuator_matrix()
    lengths = dict(zip([a.name for a in d.actuators], A @ d.home_q + b, strict=True))
    expected = {f"r_{name}": 0.01 for name in HAND_ORDER} | {"r_thumb_oppose": np.pi / 2, "r_pinky": 0.3}
    for name, value in expected.items():
        assert lengths[name] == pytest.approx(value, abs=1e-9)


def test_equal_split_couples_what_one_actuator_drives(both_hands):
    coupled = describe(("right", "left"), coupling="equal_split")
    assert both_hands.description.coupled_joints == ()
    assert len(coupled.coupled_joints) == 2 * 10
    by_actuator = {joint: a.name for a in coupled.actuators for joint in a.coefficients}
    for c in coupled.coupled_joints:
        assert by_actuator[c.joint] == by_actuator[c.leader]
    home = dict(zip(coupled.joint_names, coupled.home_q, strict=True))
    for c in coupled.coupled_joints:
        assert home[c.joint] == pytest.approx(c.multiplier * home[c.leader], abs=1e-9)


def test_limit_sets_differ_where_published(icub):
    ikin, urdf = icub.description, describe(limits="urdf")
    elbow = ikin.joint_names.index("r_elbow")
    assert (ikin.lower[elbow], urdf.lower[elbow]) == (0.09599, pytest.approx(np.deg2rad(15.0)))
    hand = ikin.indices("right_hand")
    assert np.array_equal(ikin.upper[hand], urdf.upper[hand])


def test_hand_frame_at_home_is_where_the_published_simulation_has_it(icub):
    """The published pose is after gravity sag of (-1.3, -1.1, -5.7) mm, which is taken off here."""
    T = icub.forward_kinematics(icub.description.home_q, "r_hand_dh_frame")
    published = np.array([-0.259, 0.178, 1.162]) - [-0.0013, -0.0011, -0.0057]
    assert np.linalg.norm(T[:3, 3] - published) < 1.5e-3


def test_hand_frame_on_the_hand_link_is_the_published_transform(icub):
    q = icub.description.home_q
    T = invert(icub.forward_kinematics(q, "r_hand")) @ icub.forward_kinematics(q, "r_hand_dh_frame")
    c, s = np.cos(np.deg2rad(15)), np.sin(np.deg2rad(15))
    expected = make_transform([[-c, -s, 0], [0, 0, -1], [s, -c, 0]], [-0.0576543, -0.0055568, 0.0136938])
    assert np.allclose(T, expected, atol=1e-6)


def test_head_camera_stands_upright_and_sees_the_table(icub):
    camera = icub.description.cameras[0]
    assert (camera.name, camera.width, camera.height) == ("head_cam", 640, 480)
    assert np.rad2deg(camera.fovy) == pytest.approx(42.4608673)
    T_link = icub.forward_kinematics(icub.description.home_q, camera.link)
    T = T_link @ make_transform(quat_wxyz_to_matrix(camera.quat_wxyz), camera.position)
    assert np.linalg.norm(T[:3, 3] - [-0.185, -0.044, 1.393]) < 6e-3  # published, after sag
    x, y, z = T[:3, 0], T[:3, 1], T[:3, 2]
    assert z[2] < -0.5  # looks down
    assert z[0] < -0.5  # and forward, along -x
    assert y[2] < -0.5  # the image's y points down
    assert x[1] > 0.9  # the robot's right is on the image's right
    hit = T[:3, 3] + z * (0.95 - T[2, 3]) / z[2]
    assert -1.18 < hit[0] < -0.18  # the optical axis meets the table top


def test_both_hands_mirror_each_other(both_hands):
    """The left hand's fingertips are the right's, mirrored in the robot's plane of symmetry.

    In the source table the left ring and little finger are mounted 10 degrees off the mirror image: 1 cm at the tips.
    """
    d = both_hands.description
    q = d.home_q
    position = {name: i for i, name in enumerate(d.joint_names)}
    for name, i in position.items():
        if name.startswith("l_"):
            q[i] = q[position["r_" + name[2:]]]
    for right, left in zip(d.hand("right").fingertips, d.hand("left").fingertips, strict=True):
        p = both_hands.forward_kinematics(q, right)[:3, 3]
        mirrored = both_hands.forward_kinematics(q, left)[:3, 3] * [1, -1, 1]
        assert np.linalg.norm(p - mirrored) < (12e-3 if "ring" in right or "little" in right else 1e-3), right


def test_contacts_and_excludes_name_existing_links(both_hands):
    d = both_hands.description
    text = d.urdf.read_text()
    links = {*d.contacts, *d.capsule_links, *(name for pair in d.contact_excludes for name in pair)}
    links |= {link for hand in d.hands.values() for link in (hand.frame, *hand.fingertips)}
    for name in links:
        assert f'<link name="{name}"' in text, name
    for tip in d.hand("right").fingertips + d.hand("left").fingertips:
        assert d.contacts[tip].priority == 1
        assert d.contacts[tip].friction[0] == 3.5
    assert set(d.dynamics) <= set(d.joint_names)


@pytest.mark.parametrize("hands", [("right",), ("left",), ("right", "left"), ("left", "right")])
@pytest.mark.parametrize("weld", [True, False])
def test_the_first_hand_is_the_one_that_is_named_first(hands, weld):
    d = describe(hands, weld=weld)
    assert d.hand().name == hands[0]
    assert d.hand().frame == f"{hands[0][0]}_hand_dh_frame"
    assert tuple(d.hands)[: len(hands)] == hands
    assert d.hand().actuators == tuple(f"{hands[0][0]}_{name}" for name in HAND_ORDER)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"hands": ("rigth",)}, "Did you mean 'right'"),
        ({"limits": "ikim"}, "Did you mean 'ikin'"),
        ({"coupling": "tendons"}, "Did you mean 'tendon'"),
        ({"kinematics": "pinochio"}, "Did you mean 'pinocchio'"),
        ({"torso_pitch_max": -1.0}, "torso_pitch_max is -1.0"),
        ({"model": "iCubGazeboV2_5_visuomanp"}, "Did you mean 'iCubGazeboV2_5_visuomanip'"),
    ],
)
def test_a_wrong_choice_is_named_with_the_nearest_right_one(arguments, message):
    with pytest.raises(ConfigError, match=message):
        ICub(**arguments)
