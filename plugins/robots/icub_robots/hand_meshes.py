"""The meshes of the articulated hands, from an icub-models installation that has them, in a format all engines read."""

from __future__ import annotations

import logging
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path

import numpy as np

from icub_core.errors import DataError
from icub_robots.models import HAND_MODEL, model_file, resolve_mesh
from icub_support.cache import cached_file, content_key

logger = logging.getLogger(__name__)

_KEPT = ("origin", "geometry", "material")


def hand_shapes() -> Mapping[str, tuple[ET.Element, ...]]:
    """Return, by link of both hands, the ``<visual>`` and ``<collision>`` elements of HAND_MODEL.

    Its Collada meshes are converted to STL, once, in the cache folder: MuJoCo does not read Collada.

    Raises:
        DataError: The model is not installed, or a mesh is missing or unreadable.
    """
    return _read(model_file(HAND_MODEL))


@cache
def _read(model: Path) -> dict[str, tuple[ET.Element, ...]]:
    shapes = {}
    for link in ET.parse(model).getroot().findall("link"):
        name = link.get("name", "")
        if name.startswith(("r_hand", "l_hand")):
            shapes[name] = tuple(
                _shape(element, model) for tag in ("visual", "collision") for element in link.findall(tag)
            )
    return {name: elements for name, elements in shapes.items() if elements}


def _shape(element: ET.Element, model: Path) -> ET.Element:
    copy = ET.Element(element.tag)
    copy.extend(child for child in element if child.tag in _KEPT)
    for mesh in copy.iter("mesh"):
        path = resolve_mesh(mesh.attrib["filename"], model)
        name = f"{path.stem}-{content_key(path.read_bytes())}.stl"
        converted = cached_file("robots", name, partial(_to_stl, path))
        mesh.set("filename", str(converted))
    return copy


def _to_stl(path: Path) -> bytes:
    """Read a mesh of any common format and return it as binary STL, in the file's own unit."""
    import coal

    logger.info("converting %s, once", path.name)
    try:
        mesh = coal.MeshLoader().load(str(path), np.ones(3))
    except Exception as error:
        raise DataError(f"mesh {path} cannot be read: {str(error).splitlines()[0]}") from error
    vertices = np.asarray(mesh.vertices())
    faces = np.array([[mesh.tri_indices(i)[k] for k in range(3)] for i in range(mesh.num_tris)])
    corners = vertices[faces].astype("<f4")
    record = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["corners"] = corners
    record["normal"] = _normals(corners)
    return bytes(80) + np.uint32(len(faces)).astype("<u4").tobytes() + record.tobytes()


def _normals(corners: np.ndarray) -> np.ndarray:
    """Return unit normals (n, 3) of triangles (n, 3, 3); zero for a degenerate one."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0, length, 1.0)
