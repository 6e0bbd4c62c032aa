"""The Panda's URDF of `pybullet_data`, rewritten so that every loader reads it."""

from __future__ import annotations

import hashlib
import importlib.util
import xml.etree.ElementTree as ET
from pathlib import Path

from icub_core.errors import DataError
from icub_core.files import cache_dir, write_text_atomically

PEDESTAL = 0.95
"""Height of the base above the floor, meters: that of the standard table."""

_PAD = ("0.0178 0.0144 0.0179", (0.0, 0.0072, 0.04495))
_FINGER = [("0.021 0.0238 0.0193", (0.0, 0.0144, 0.00965)), ("0.018 0.0077 0.0167", (0.0, 0.0118, 0.02765)), _PAD]
"""Size and center of the boxes that stand for a finger: its foot, its middle and its pad, meters."""
_BOXES = {
    "panda_hand": [("0.0632 0.2044 0.092", (0.0, 0.0, 0.02))],
    "panda_leftfinger": _FINGER,
    "panda_rightfinger": [(size, (x, -y, z)) for size, (x, y, z) in _FINGER],
}
_WRIST = {"radius": "0.045", "length": "0.06", "xyz": "0 0 0.077"}


def panda_urdf() -> Path:
    """Write the file into the cache folder and return its path.

    Raises:
        DataError: The package `pybullet_data` is not installed, or lacks the Panda.
    """
    found = importlib.util.find_spec("pybullet_data")
    if found is None or found.origin is None:
        raise DataError("the robot 'panda' reads the meshes of pybullet_data; install pybullet")
    folder = Path(found.origin).parent / "franka_panda"
    try:
        root = ET.parse(folder / "panda.urdf").getroot()
    except (OSError, ET.ParseError) as error:
        raise DataError(f"cannot read {folder / 'panda.urdf'}: {error}") from error
    _drop_what_only_bullet_knows(root)
    for mesh in root.iter("mesh"):
        mesh.set("filename", str(folder / mesh.attrib["filename"].removeprefix("package://")))
    for link in root.findall("link"):
        _simplify(link)
    text = ET.tostring(root, encoding="unicode")
    path = cache_dir() / f"panda-{hashlib.sha256(text.encode()).hexdigest()[:16]}.urdf"
    if not path.is_file():
        write_text_atomically(path, text)
    return path


def _drop_what_only_bullet_knows(root: ET.Element) -> None:
    """Leave out contact parameters and couplings, which the description states, and a frame that nothing needs."""
    for element in [*root.findall("link"), *root.findall("joint")]:
        if element.attrib["name"].startswith("panda_grasptarget"):
            root.remove(element)
        for tag in ("contact", "mimic", "safety_controller"):
            for old in element.findall(tag):
                element.remove(old)
        if element.attrib.get("type") == "fixed":
            for axis in element.findall("axis"):
                element.remove(axis)


def _simplify(link: ET.Element) -> None:
    """Let boxes and a cylinder collide where the hand meets things, and put the base on a pedestal."""
    name = link.attrib["name"]
    if name == "panda_link0":
        _add(link, "visual", "box", {"size": f"0.2 0.2 {PEDESTAL}"}, f"-0.04 0 {-PEDESTAL / 2}")
    if name == "panda_link8":  # a frame: no mass
        link.remove(link.find("inertial"))
    if name in _BOXES or name == "panda_link7":
        for old in link.findall("collision"):
            link.remove(old)
    for size, center in _BOXES.get(name, ()):
        _add(link, "collision", "box", {"size": size}, " ".join(map(str, center)))
    if name == "panda_link7":
        _add(link, "collision", "cylinder", {key: _WRIST[key] for key in ("radius", "length")}, _WRIST["xyz"])


def _add(link: ET.Element, use: str, shape: str, size: dict[str, str], center: str) -> None:
    element = ET.SubElement(link, use)
    ET.SubElement(element, "origin", xyz=center, rpy="0 0 0")
    ET.SubElement(ET.SubElement(element, "geometry"), shape, size)
