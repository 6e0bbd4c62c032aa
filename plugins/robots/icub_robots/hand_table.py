"""The table of the articulated hands (`data/icub_hand.yaml`) as typed records with full names."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Literal, get_args

import yaml

from icub_core.robot_description import Actuator, ContactMaterial, CoupledJoint, JointDynamics
from icub_core.scene import QuatWxyz, Vec3

Side = Literal["right", "left"]
SIDES: tuple[Side, ...] = get_args(Side)
STEP, STEPS = 0.2, {"pinky": 0.4}
"""What an action of 1 moves an actuator by, rad; twice as much for the tendon of two fingers (released code)."""
FINGERS = ("thumb", "index", "middle", "ring", "little")


@dataclass(frozen=True)
class PalmBox:
    """A slab of the palm in the hand link's frame, meters."""

    position: Vec3
    quat_wxyz: QuatWxyz
    half_size: Vec3


@dataclass(frozen=True)
class Phalanx:
    """A finger link, the joint `<name>_joint` before it, and its capsule in the link's frame (meters, radians)."""

    name: str
    parent: str
    xyz: Vec3
    rpy: Vec3
    axis: Vec3
    limits: tuple[float, float]
    fixed: bool
    capsule_from: Vec3
    capsule_to: Vec3
    capsule_radius: float

    @property
    def joint(self) -> str:
        """Name of the joint that moves this link."""
        return f"{self.name}_joint"


@dataclass(frozen=True)
class Tip:
    """A massless frame at the end of a finger."""

    name: str
    parent: str
    xyz: Vec3
    rpy: Vec3


@dataclass(frozen=True)
class Hand:
    """One hand: what is attached to the link ``r_hand`` or ``l_hand`` of the body, by the identity.

    Attributes:
        home: Joint positions at rest, rad.
        dynamics: By joint.
        materials: By link: palm, finger links, fingertips.
    """

    side: str
    palm_link: str
    palm: tuple[PalmBox, ...]
    phalanges: tuple[Phalanx, ...]
    tips: tuple[Tip, ...]
    mass: float
    inertia: float
    actuators: tuple[Actuator, ...]
    equal_split: tuple[CoupledJoint, ...]
    home: dict[str, float]
    dynamics: dict[str, JointDynamics]
    materials: dict[str, ContactMaterial]

    @property
    def joints(self) -> tuple[str, ...]:
        """Movable joints, thumb to little finger, from the palm outwards."""
        return tuple(p.joint for p in self.phalanges if not p.fixed)

    @property
    def fingertips(self) -> tuple[str, ...]:
        """Links that carry the tactile sensors: thumb, index, middle, ring, little."""
        return tuple(f"{self.palm_link}_{finger}_3" for finger in FINGERS)

    @property
    def contact_excludes(self) -> tuple[tuple[str, str], ...]:
        """Pairs that overlap by construction: palm with the first two links of a finger, link 0 with link 2."""
        pairs: list[tuple[str, str]] = []
        for finger in FINGERS:
            link = f"{self.palm_link}_{finger}"
            pairs += [(self.palm_link, f"{link}_0"), (self.palm_link, f"{link}_1"), (f"{link}_0", f"{link}_2")]
        return tuple(pairs)


@cache
def load_hand(side: str) -> Hand:
    """Read one hand, ``"right"`` or ``"left"``, from the packaged table."""
    table = _read_table()
    palm_link = f"{side[0]}_hand"
    rows = table[side]
    actuators = tuple(_actuator(row, side, palm_link) for row in table["actuators"])
    phalanges = tuple(_phalanx(row, palm_link, table["fixed_joints"]) for row in rows["links"])
    home = {}
    for row, actuator in zip(table["actuators"], actuators, strict=True):
        for joint, coefficient in actuator.coefficients.items():  # every joint takes an equal share of the length
            home[joint] = (row["home"] - actuator.offset) / (coefficient * len(actuator.coefficients))
    return Hand(
        side=side,
        palm_link=palm_link,
        palm=tuple(PalmBox(*map(tuple, (b["position"], b["quat_wxyz"], b["half_size"]))) for b in rows["palm_boxes"]),
        phalanges=phalanges,
        tips=tuple(Tip(t["name"], t["parent"], tuple(t["xyz"]), tuple(t["rpy"])) for t in rows["tips"]),
        mass=table["finger_link"]["mass"],
        inertia=table["finger_link"]["inertia"],
        actuators=actuators,
        equal_split=tuple(
            CoupledJoint(f"{palm_link}_{joint}_joint", f"{palm_link}_{group['leader']}_joint", multiplier)
            for group in table["equal_split"]
            for joint, multiplier in group["followers"].items()
        ),
        home=home,
        dynamics=_dynamics(table["dynamics"], side, palm_link),
        materials=_materials(table["materials"], palm_link, phalanges),
    )


@cache
def _read_table() -> dict[str, Any]:
    text = resources.files("icub_robots").joinpath("data/icub_hand.yaml").read_text(encoding="utf-8")
    return yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))


def _actuator(row: dict[str, Any], side: str, palm_link: str) -> Actuator:
    return Actuator(
        name=f"{side[0]}_{row['name']}",
        coefficients={f"{palm_link}_{joint}_joint": c for joint, c in row["coefficients"].items()},
        kp=row["kp"][side],
        range=tuple(row["range"]),
        offset=row["offset"],
        open=row["open"],
        close=row["close"],
        step=STEPS.get(row["name"], STEP),
    )


def _phalanx(row: dict[str, Any], palm_link: str, fixed: list[str]) -> Phalanx:
    capsule = row["capsule"]
    return Phalanx(
        name=row["name"],
        parent=row["parent"],
        xyz=tuple(row["xyz"]),
        rpy=tuple(row["rpy"]),
        axis=tuple(row["axis"]),
        limits=tuple(row["limits"]),
        fixed=row["name"].removeprefix(f"{palm_link}_") in fixed,
        capsule_from=tuple(capsule["from"]),
        capsule_to=tuple(capsule["to"]),
        capsule_radius=capsule["radius"],
    )


def _dynamics(rows: dict[str, Any], side: str, palm_link: str) -> dict[str, JointDynamics]:
    default = JointDynamics()
    friction = {joint: rows["frictionloss"][side].get(joint, default.frictionloss) for joint in rows["stiffness"]}
    return {
        f"{palm_link}_{joint}_joint": JointDynamics(default.damping, stiffness, friction[joint])
        for joint, stiffness in rows["stiffness"].items()
    }


def _materials(rows: dict[str, Any], palm_link: str, phalanges: tuple[Phalanx, ...]) -> dict[str, ContactMaterial]:
    def material(row: dict[str, Any]) -> ContactMaterial:
        fields: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in row.items()}
        return ContactMaterial(**fields)

    named = {name: material(row) for name, row in rows.items()}
    materials = {p.name: named["fingertip" if p.name.endswith("_3") else "finger"] for p in phalanges}
    return {palm_link: named["palm"], **materials}
