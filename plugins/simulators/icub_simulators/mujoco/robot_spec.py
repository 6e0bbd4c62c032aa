"""From a robot description to a MuJoCo specification."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco

from icub_core.errors import SimulationError
from icub_core.geometry import matrix_to_quat_wxyz
from icub_core.robot_description import Actuator, ContactMaterial, JointDynamics, RobotDescription
from icub_simulators.mujoco.collision import ROBOT, ROBOT_MEETS
from icub_simulators.visual_meshes import decimated

HIDDEN_GROUP = 3
"""Geom group of collision shapes of links that have something better to show."""

NEGLIGIBLE_FRICTION = 0.02
"""Nm of dry joint friction that is left out: every joint with any is one more constraint, together a quarter of the
time of a step, while the servos' torques are a hundred times larger and the joints' damping does the rest."""

_SHAPE = "/shape/"
"""Between link and number in the name of a shape; which body it ends up in is the compiler's affair."""

COUPLING_SOLREF, COUPLING_SOLIMP = (0.01, 1.0), (0.99, 0.999, 0.001, 0.5, 2.0)
"""Of joints that follow another: as stiff as a 5 ms step resolves; the engine's defaults give way by two degrees."""


def robot_spec(robot: RobotDescription, visual: bool) -> mujoco.MjSpec:
    """Build the robot, fixed at its root, with actuators, couplings and contact parameters.

    Args:
        robot: What to build.
        visual: Whether to load what is only drawn; physics needs none of it.

    Raises:
        SimulationError: When the URDF or one of its meshes cannot be used.
    """
    try:
        spec = mujoco.MjSpec.from_string(_prepared_urdf(robot.urdf, visual))
    except (ValueError, ET.ParseError, OSError) as error:
        raise SimulationError(
            f"cannot read the URDF of robot '{robot.name}', {robot.urdf}: {_first_line(error)}"
        ) from error
    _place_root(spec, robot)
    _set_joints(spec, robot)
    _set_geoms(spec, robot)
    for first, second in robot.contact_excludes:
        spec.add_exclude(bodyname1=first, bodyname2=second)
    for actuator in robot.actuators:
        _add_actuator(spec, actuator)
    for coupled in robot.coupled_joints:
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            solref=COUPLING_SOLREF,
            solimp=COUPLING_SOLIMP,
            name1=coupled.joint,
            name2=coupled.leader,
            data=[0.0, coupled.multiplier] + [0.0] * (mujoco.mjNEQDATA - 2),  # a polynomial: offset, slope, ...
        )
    return spec


def _prepared_urdf(path: Path, visual: bool) -> str:
    """Return the URDF's text with MuJoCo's options (by default it drops frames and visuals) and light meshes."""
    root = ET.parse(path).getroot()
    for link in root.findall("link"):
        for element in link.findall("visual"):
            if not visual:
                link.remove(element)
                continue
            for mesh in element.iter("mesh"):
                file = Path(mesh.attrib["filename"].removeprefix("file://"))
                mesh.set("filename", str(decimated(file)))
    for old in root.findall("mujoco"):
        root.remove(old)
    options = {"fusestatic": "false", "discardvisual": "false", "strippath": "false"}
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", options)
    return ET.tostring(root, encoding="unicode")


def _place_root(spec: mujoco.MjSpec, robot: RobotDescription) -> None:
    root = spec.worldbody.first_body()
    root.pos = robot.T_world_root[:3, 3]
    root.quat = matrix_to_quat_wxyz(robot.T_world_root[:3, :3])


def _set_joints(spec: mujoco.MjSpec, robot: RobotDescription) -> None:
    default = JointDynamics()
    for name, low, high in zip(robot.joint_names, robot.lower, robot.upper, strict=True):
        joint = spec.joint(name)
        if joint is None:
            raise SimulationError(
                f"robot '{robot.name}' lists joint '{name}', which its URDF {robot.urdf} does not have"
            )
        dynamics = robot.dynamics.get(name, default)
        joint.damping = [dynamics.damping, 0.0, 0.0]
        joint.stiffness = [dynamics.stiffness, 0.0, 0.0]
        joint.frictionloss = dynamics.frictionloss if dynamics.frictionloss > NEGLIGIBLE_FRICTION else 0.0
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.range = [low, high]


def _set_geoms(spec: mujoco.MjSpec, robot: RobotDescription) -> None:
    default = ContactMaterial()
    for body in spec.bodies[1:]:
        material = robot.contacts.get(body.name, default)
        geoms = list(body.geoms)
        shown = any(geom.contype == 0 for geom in geoms)
        for number, geom in enumerate(geoms):
            geom.name = f"{body.name}{_SHAPE}{number}"
            if body.name in robot.capsule_links and geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER:
                geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
            if geom.contype == 0:  # visual
                continue
            geom.group = HIDDEN_GROUP if shown else 0
            geom.contype, geom.conaffinity = ROBOT, ROBOT_MEETS
            geom.friction = material.friction
            geom.condim = material.condim
            geom.priority = material.priority
            if material.solref is not None:
                geom.solref = material.solref
            if material.solimp is not None:
                geom.solimp = [*material.solimp, 0.5, 2.0]  # the last two are the engine's defaults


def _add_actuator(spec: mujoco.MjSpec, actuator: Actuator) -> None:
    """Add a position servo: force = kp (command - length), length = sum(coefficient q) + offset."""
    added = spec.add_actuator(name=actuator.name)
    scale = 1.0
    if len(actuator.coefficients) == 1:
        (joint, scale), *_ = actuator.coefficients.items()
        added.trntype, added.target = mujoco.mjtTrn.mjTRN_JOINT, joint
    else:
        tendon = spec.add_tendon(name=f"{actuator.name}_tendon")
        for joint, coefficient in actuator.coefficients.items():
            tendon.wrap_joint(joint, coefficient)
        added.trntype, added.target = mujoco.mjtTrn.mjTRN_TENDON, tendon.name
    added.gear[0] = scale
    added.gaintype, added.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    added.gainprm[0] = actuator.kp
    added.biasprm[:3] = [-actuator.kp * actuator.offset, -actuator.kp, 0.0]
    added.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
    added.ctrlrange = actuator.range


def link_of_geom(name: str) -> str:
    """Return the link that a shape of the robot belongs to; empty for the name of anything else."""
    link, mark, _ = name.rpartition(_SHAPE)
    return link if mark else ""


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
