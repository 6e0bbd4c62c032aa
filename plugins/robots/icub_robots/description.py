"""The iCub as data: assembles `RobotDescription` from the body's facts and the hands' table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, get_args

import numpy as np

from icub_core.errors import ConfigError, unknown_name
from icub_core.geometry import make_transform, rotation_about
from icub_core.robot_description import Actuator, ContactMaterial, Grip, HandDescription, RobotDescription
from icub_robots import body
from icub_robots.hand_meshes import hand_shapes
from icub_robots.hand_table import SIDES, Hand, Side, load_hand
from icub_robots.models import BODY_MODEL, MODELS, Model
from icub_robots.urdf import assemble, joint_limits, root_transform
from icub_support.cache import cached_text

Coupling = Literal["tendon", "equal_split"]
WORKSPACE = np.array([[-0.65, -0.45, 0.93], [0.0, 0.55, 1.60]])
"""Lowest and highest hand position, world, meters: in front of the robot, above the table."""
YAWS = (np.radians(75.0), np.radians(330.0))
"""Angles of the right hand's x axis about the vertical at which its arm reaches the table, rad."""
JAW_TILT = np.pi / 4
"""A parallel jaw's approach lies between the palm's normal and the fingers (thesis 12.3.1), rad about the hand's y."""


def _grip(side: str) -> Grip:
    """Return where a hand holds: it squeezes along x, thumb against fingers, and the palm looks along z.

    In the right hand's grip y runs from the index finger to the little one. The left hand is the mirror image, whose
    frame has the palm look along -z.
    """
    left = side == "left"
    y = -1.0 if left else 1.0
    turn = np.diag([1.0, y, y])
    return Grip(
        T_hand_grip=make_transform(turn, [0.033, -0.002, 0.001 * y]),
        width=0.075,  # of an opening of 0.09, of which placing and pose errors take their part
        fingers_y=y * np.array([-0.034, -0.006, 0.022, 0.038]),  # index, middle, ring and little finger
        depth=0.033,
        sweep=np.array([[-0.053, 0.052], [-0.052, 0.048] if left else [-0.048, 0.052], [-0.001, 0.074]]),
        half_axes=(0.03, 0.06, 0.03),  # thesis 12.3.1
        yaws=YAWS,
        mirrored=left,
        T_hand_jaw=make_transform(turn @ rotation_about("y", JAW_TILT)),
    )


def describe(
    hands: Sequence[Side] = ("right",),
    limits: body.LimitSet = "ikin",
    coupling: Coupling = "tendon",
    weld: bool = True,
    model: Model = BODY_MODEL,
) -> RobotDescription:
    """Assemble the robot.

    Args:
        hands: Hands with fingers, ``"right"``, ``"left"`` or both; the first is the one used where none is named.
        limits: ``"ikin"`` (the limits that the real robot's arm solver uses) or ``"urdf"``.
        coupling: ``"tendon"``: one actuator pulls the weighted sum of its joints, contact decides the split;
            ``"equal_split"``: those joints also stay equal.
        weld: Fix the legs, and each arm whose hand is not asked for, at the home pose; fewer joints, faster physics.
        model: ``"iCubGazeboV2_7"``: palms are boxes, finger links capsules; ``"iCubGazeboV2_5_visuomanip"``, if an
            icub-models with it is installed: hands have that model's meshes, to show and to collide.

    Raises:
        ConfigError: An unknown hand, limit set, coupling or model.
        DataError: icub-models is incomplete, or the cache folder cannot be written.
    """
    _check(hands, limits, coupling, model)
    shapes = hand_shapes() if model != BODY_MODEL else {}
    fingered = tuple(load_hand(side) for side in reversed(SIDES) if side in hands)  # the right hand comes last
    arms = [side for side in reversed(SIDES) if side in hands or not weld]
    legs = [] if weld else list(reversed(SIDES))
    movable = [*body.TORSO, *body.NECK]
    for side in arms:
        movable += body.arm(side)
        movable += next((hand.joints for hand in fingered if hand.side == side), ())
    for side in legs:
        movable += body.leg(side)
    all_body = [*body.TORSO, *body.NECK, *(j for side in SIDES for j in (*body.arm(side), *body.leg(side)))]
    welded = {joint: body.HOME.get(joint, 0.0) for joint in all_body if joint not in movable}
    text = assemble(fingered, welded, body.LIMIT_SETS[limits], shapes)
    ranges = joint_limits(text)
    home = {**body.HOME, **{joint: q for hand in fingered for joint, q in hand.home.items()}}
    return RobotDescription(
        name="icub",
        urdf=cached_text("robots", text, ".urdf"),
        T_world_root=root_transform(),
        joint_names=tuple(movable),
        lower=np.array([ranges[joint][0] for joint in movable]),
        upper=np.array([ranges[joint][1] for joint in movable]),
        groups=_groups(arms, legs, fingered),
        actuators=_actuators(arms, fingered, ranges),
        home={joint: q for joint, q in home.items() if joint in movable},
        hands={side: _hand(side, fingered) for side in dict.fromkeys([*hands, *SIDES]) if side in arms},
        cameras=body.CAMERAS,
        dynamics={
            joint: dynamics
            for source in (body.DYNAMICS, *(hand.dynamics for hand in fingered))
            for joint, dynamics in source.items()
            if joint in movable
        },
        contacts=_contacts(fingered),
        contact_excludes=tuple(
            pair for hand in fingered for pair in ((hand.palm_link, f"{hand.side[0]}_forearm"), *hand.contact_excludes)
        ),
        capsule_links=frozenset(
            name
            for hand in fingered
            for name in (f"{hand.side[0]}_forearm", *(p.name for p in hand.phalanges))
            if name not in shapes
        ),
        coupled_joints=tuple(c for hand in fingered for c in hand.equal_split) if coupling == "equal_split" else (),
        gravity_compensation=True,
    )


def _hand(side: str, fingered: Sequence[Hand]) -> HandDescription:
    hand = next((hand for hand in fingered if hand.side == side), None)
    return HandDescription(
        name=side,
        frame=f"{side[0]}_hand_dh_frame",
        reach=f"{side}_reach",
        actuators=tuple(a.name for a in hand.actuators) if hand is not None else (),
        fingertips=hand.fingertips if hand is not None else (),
        grip=_grip(side) if hand is not None else None,
        workspace=WORKSPACE,
    )


def _check(hands: Sequence[str], limits: str, coupling: str, model: str) -> None:
    for side in hands:
        if side not in SIDES:
            raise ConfigError(unknown_name("hand", side, SIDES))
    if limits not in body.LIMIT_SETS:
        raise ConfigError(unknown_name("set of joint limits", limits, body.LIMIT_SETS))
    if coupling not in get_args(Coupling):
        raise ConfigError(unknown_name("finger coupling", coupling, get_args(Coupling)))
    if model not in MODELS:
        raise ConfigError(unknown_name("model of icub-models", model, MODELS))


def _groups(arms: Sequence[str], legs: Sequence[str], hands: Sequence[Hand]) -> dict[str, tuple[str, ...]]:
    groups: dict[str, tuple[str, ...]] = {"torso": body.TORSO, "neck": body.NECK, "head": body.NECK}
    for side in arms:
        groups[f"{side}_arm"] = body.arm(side)
        groups[f"{side}_reach"] = (*body.TORSO, *body.arm(side))
    groups.update({f"{hand.side}_hand": hand.joints for hand in hands})
    groups.update({f"{side}_leg": body.leg(side) for side in legs})
    return groups


def _actuators(
    arms: Sequence[str], hands: Sequence[Hand], ranges: Mapping[str, tuple[float, float]]
) -> tuple[Actuator, ...]:
    def servo(joint: str) -> Actuator:
        q = body.HOME.get(joint, 0.0)
        return Actuator(joint, {joint: 1.0}, body.KP[joint], ranges[joint], open=q, close=q)

    actuators = [servo(joint) for joint in (*body.TORSO, *body.NECK)]
    for side in arms:
        actuators += [servo(joint) for joint in body.arm(side)]
        actuators += next((hand.actuators for hand in hands if hand.side == side), ())
    return tuple(actuators)


def _contacts(hands: Sequence[Hand]) -> dict[str, ContactMaterial]:
    contacts: dict[str, ContactMaterial] = {}
    for hand in hands:
        contacts.update(hand.materials)
    return contacts
