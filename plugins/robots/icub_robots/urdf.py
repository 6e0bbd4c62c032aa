"""One URDF for all loaders: the body of icub-models with the articulated hands attached."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import DataError
from icub_core.geometry import (
    make_transform,
    matrix_to_rpy,
    quat_wxyz_to_matrix,
    rotation_exp,
    rpy_to_matrix,
)
from icub_robots import body
from icub_robots.hand_table import Hand
from icub_robots.models import BODY_MODEL, model_file, resolve_mesh

_HAND_RGBA = "0.82 0.82 0.84 1"
_KEPT_FRAMES = {"r_hand_dh_frame", "l_hand_dh_frame"}  # besides the fingertips, which come with the hands


def body_root() -> ET.Element:
    """Parse the body, with absolute mesh paths and without what only its own simulator reads.

    Raises:
        DataError: The model or one of its meshes is missing.
    """
    file = model_file(BODY_MODEL)
    root = ET.parse(file).getroot()
    for tag in ("gazebo", "sensor"):
        for element in root.findall(tag):
            root.remove(element)
    for mesh in root.iter("mesh"):
        mesh.set("filename", str(resolve_mesh(mesh.attrib["filename"], file)))
    return root


def assemble(
    hands: Iterable[Hand],
    welded: Mapping[str, float],
    limits: Mapping[str, tuple[float, float]],
    shapes: Mapping[str, tuple[ET.Element, ...]],
) -> str:
    """Write the robot.

    Args:
        hands: Hands that get fingers and collision geometry; the other hand stays the body's one visual mesh.
        welded: Joints of the body to fix, with the angle (rad) they are fixed at.
        limits: Joints of the body whose limits (rad) are replaced.
        shapes: By hand link, ``<visual>`` and ``<collision>`` elements in the place of palm boxes and finger capsules.

    Returns:
        The URDF as text; the same arguments give the same text.
    """
    root = body_root()
    root.set("name", "icub")
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            link.remove(collision)
    for joint in root.findall("joint"):
        name = joint.attrib["name"]
        if name in welded:
            _weld(joint, welded[name])
        elif name in limits:
            limit = _child(joint, "limit")
            limit.set("lower", repr(limits[name][0]))
            limit.set("upper", repr(limits[name][1]))
    _prune_frames(root)
    for hand in hands:
        _attach_hand(root, hand, shapes)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _child(element: ET.Element, tag: str) -> ET.Element:
    child = element.find(tag)
    if child is None:
        raise DataError(f"<{element.tag} name='{element.get('name')}'> of {BODY_MODEL} has no <{tag}>")
    return child


def _numbers(element: ET.Element, key: str) -> NDArray[np.float64]:
    return np.array([float(x) for x in element.get(key, "0 0 0").split()])


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(float(v)) for v in values)


def _weld(joint: ET.Element, angle: float) -> None:
    """Turn a revolute joint into a fixed one that stands at `angle`."""
    origin = _child(joint, "origin")
    axis = _numbers(_child(joint, "axis"), "xyz")
    R = rpy_to_matrix(_numbers(origin, "rpy")) @ rotation_exp(angle * axis / np.linalg.norm(axis))
    origin.set("rpy", _text(matrix_to_rpy(R)))
    joint.set("type", "fixed")
    for tag in ("axis", "limit", "dynamics", "safety_controller", "calibration", "mimic"):
        for element in joint.findall(tag):
            joint.remove(element)


def _prune_frames(root: ET.Element) -> None:
    """Drop massless leaf links with their joints (sensor and skin frames, about 150), again until none is left."""
    while True:
        parents = {_child(j, "parent").get("link") for j in root.findall("joint")}
        bare = {
            link.get("name")
            for link in root.findall("link")
            if link.find("inertial") is None and link.get("name") not in parents | _KEPT_FRAMES
        }
        if not bare:
            return
        for element in root.findall("link"):
            if element.get("name") in bare:
                root.remove(element)
        for element in root.findall("joint"):
            if _child(element, "child").get("link") in bare:
                root.remove(element)


def _attach_hand(root: ET.Element, hand: Hand, shapes: Mapping[str, tuple[ET.Element, ...]]) -> None:
    links = {link.get("name"): link for link in root.findall("link")}
    palm = links[hand.palm_link]
    for visual in palm.findall("visual"):  # the single mesh shows fingers that do not move
        palm.remove(visual)
    palm.extend(shapes.get(hand.palm_link, ()))
    for box in () if hand.palm_link in shapes else hand.palm:
        size = _text(2.0 * h for h in box.half_size)
        rpy = matrix_to_rpy(quat_wxyz_to_matrix(box.quat_wxyz))
        _add_shape(palm, "box", {"size": size}, np.array(box.position), rpy, visible=True)
    for phalanx in hand.phalanges:
        link = ET.SubElement(root, "link", name=phalanx.name)
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "origin", xyz="0 0 0", rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=repr(hand.mass))
        i = repr(hand.inertia)
        ET.SubElement(inertial, "inertia", ixx=i, ixy="0", ixz="0", iyy=i, iyz="0", izz=i)
        if phalanx.name in shapes:
            link.extend(shapes[phalanx.name])
        else:
            start, end = np.array(phalanx.capsule_from), np.array(phalanx.capsule_to)
            _add_capsule(link, start, end, phalanx.capsule_radius, visible=True)
        joint = _add_joint(root, phalanx.joint, phalanx.parent, phalanx.name, phalanx.xyz, phalanx.rpy)
        if not phalanx.fixed:
            joint.set("type", "revolute")
            ET.SubElement(joint, "axis", xyz=_text(phalanx.axis))
            lower, upper = phalanx.limits
            ET.SubElement(joint, "limit", lower=repr(lower), upper=repr(upper), effort="50000", velocity="50000")
    for tip in hand.tips:
        ET.SubElement(root, "link", name=tip.name)
        _add_joint(root, f"{tip.name}_joint", tip.parent, tip.name, tip.xyz, tip.rpy)
    side = hand.side[0]
    axis = _pronation_axis(root, side)
    start, end = (distance * axis for distance in body.FOREARM_SEGMENT)
    _add_capsule(links[f"{side}_forearm"], start, end, body.FOREARM_RADIUS, visible=False)


def _pronation_axis(root: ET.Element, side: str) -> NDArray[np.float64]:
    """Return the unit axis of the forearm, in its frame, from elbow to wrist."""
    joint = next(j for j in root.findall("joint") if j.get("name") == f"{side}_wrist_pitch")
    wrist = _numbers(_child(joint, "origin"), "xyz")
    return wrist / np.linalg.norm(wrist)


def _add_joint(
    root: ET.Element, name: str, parent: str, child: str, xyz: Iterable[float], rpy: Iterable[float]
) -> ET.Element:
    joint = ET.SubElement(root, "joint", name=name, type="fixed")
    ET.SubElement(joint, "origin", xyz=_text(xyz), rpy=_text(rpy))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    return joint


def _add_capsule(
    link: ET.Element, start: NDArray[np.float64], end: NDArray[np.float64], radius: float, visible: bool
) -> None:
    """Add a capsule between two sphere centers, written as the cylinder between them."""
    along = end - start
    length = float(np.linalg.norm(along))
    rpy = np.array([0.0, np.arctan2(np.hypot(along[0], along[1]), along[2]), np.arctan2(along[1], along[0])])
    size = {"radius": repr(radius), "length": repr(length)}
    _add_shape(link, "cylinder", size, 0.5 * (start + end), rpy, visible)


def _add_shape(
    link: ET.Element, shape: str, size: dict[str, str], xyz: Iterable[float], rpy: Iterable[float], visible: bool
) -> None:
    for tag in ("visual", "collision") if visible else ("collision",):
        element = ET.SubElement(link, tag)
        ET.SubElement(element, "origin", xyz=_text(xyz), rpy=_text(rpy))
        ET.SubElement(ET.SubElement(element, "geometry"), shape, size)
        if tag == "visual":
            material = ET.SubElement(element, "material", name="hand_color")
            ET.SubElement(material, "color", rgba=_HAND_RGBA)


def joint_limits(urdf_text: str) -> dict[str, tuple[float, float]]:
    """Return the limits (rad) of the movable joints of a URDF, in the order of the file."""
    root = ET.fromstring(urdf_text)
    return {
        joint.attrib["name"]: (float(limit.attrib["lower"]), float(limit.attrib["upper"]))
        for joint in root.findall("joint")
        if (limit := joint.find("limit")) is not None and joint.get("type") != "fixed"
    }


def root_transform() -> NDArray[np.float64]:
    """Return T_world_root (4, 4)."""
    return make_transform(translation=body.ROOT_POSITION)
