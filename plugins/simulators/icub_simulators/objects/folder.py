"""The user's own meshes."""

from __future__ import annotations

import logging
import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from icub_core.errors import ConfigError, DataError, unknown_name
from icub_core.geometry import FloatArray, quat_wxyz_to_matrix
from icub_core.interfaces.object_set import ObjectSet
from icub_core.scene import Material, ObjectSpec, RestPose
from icub_simulators.objects.meshes import (
    MESH_SUFFIXES,
    IntArray,
    check_size,
    convex_pieces,
    read_mesh,
    solid_object,
    without_specks,
)
from icub_simulators.objects.model_files import MODEL_SUFFIXES, read_model
from icub_simulators.objects.resting import rest_poses
from icub_simulators.objects.solids import hull_volume, narrowest_width
from icub_simulators.objects.textures import PATTERNS, print_texture, random_ink

logger = logging.getLogger(__name__)

LOWEST, WIDEST = 0.05, 0.07
"""Meters: lower objects leave no room for the fingers above the table, wider ones none between thumb and fingers."""


@dataclass(frozen=True, eq=False)
class _Body:
    """Convex pieces, the surface to draw, in meters, and the stated mass, kg; 0 where the file states none."""

    pieces: list[FloatArray]
    surface: tuple[FloatArray, IntArray]
    mass: float


class Folder(ObjectSet):
    """Every OBJ, STL, URDF and MJCF file of a folder and its sub-folders, one object each, named by its path.

    A mesh need not be watertight: it is decomposed into convex pieces (CoACD) once, and the pieces are kept in the
    cache under a hash of the mesh. It is drawn as it is, in a color derived from its name.

    A URDF or MJCF file describes one rigid object; its mass counts where it states one, and the meshes beside and below
    it are its parts, not objects.

    An object stands as it came to rest most often when it was dropped in every orientation, which is tried once and
    kept; `rest_poses` of its spec lists them all.

    Args:
        path: The folder.
        scale: Factor from the files' unit to meters; 0.001 for millimeters.
        density: kg/m^3 of the pieces, for files that state no mass.
        pieces: Largest number of convex pieces; 1 takes the hull.
        concavity: Allowed error of the decomposition, share of the object's size.
        friction: Sliding friction coefficient.
        graspable: Leave out what the iCub's hand cannot take from a table. An object stays when it comes to rest at
            least 50 mm high and, at its narrowest, at most 70 mm wide; it then stands in the most frequent such pose.
    """

    def __init__(
        self,
        path: Path,
        scale: float = 1.0,
        density: float = 500.0,
        pieces: int = 16,
        concavity: float = 0.05,
        friction: float = 0.5,
        graspable: bool = False,
    ) -> None:
        self._root = Path(path).expanduser()
        if not self._root.is_dir():
            raise DataError(
                f"object folder {self._root} does not exist; expected a folder with OBJ, STL, URDF or MJCF files"
            )
        for what, value in (("scale", scale), ("density", density), ("pieces", pieces), ("concavity", concavity)):
            if not value > 0:
                raise ConfigError(f"folder {what} is {value}; expected a number above 0")
        self._scale, self._density, self._pieces, self._concavity = scale, density, pieces, concavity
        self._friction, self._graspable = friction, graspable
        everything = sorted(p for p in self._root.rglob("*") if p.is_file())
        files = [p for p in everything if p.suffix.lower() in MODEL_SUFFIXES]
        described = {p.parent for p in files}
        files += [  # meshes below a model file are its parts
            p for p in everything if p.suffix.lower() in MESH_SUFFIXES and not described & set(p.parents)
        ]
        self._files: dict[str, Path] = {}
        for file in files:
            name = file.relative_to(self._root).with_suffix("").as_posix().replace("/", "_")
            if name in self._files:
                raise DataError(f"{self._files[name]} and {file} would both be object '{name}'; rename one of them")
            self._files[name] = file
        self._files = dict(sorted(self._files.items()))
        if not self._files:
            raise DataError(
                f"object folder {self._root} has no mesh; expected files ending in "
                f"{', '.join((*MESH_SUFFIXES, *MODEL_SUFFIXES))}"
            )

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names in alphabetical order of the files; with `graspable` the first use looks at all of them."""
        if not self._graspable:
            return tuple(self._files)
        logger.info("looking for graspable ones among the %d objects of %s", len(self._files), self._root)
        names = tuple(name for name in self._files if self._rests(self._read(name).pieces))
        if not names:
            raise DataError(
                f"no object of folder {self._root} fits the hand; expected one that stands {1e3 * LOWEST:.0f} mm high "
                f"or more and is there {1e3 * WIDEST:.0f} mm wide or less"
            )
        return names

    def get(self, name: str) -> ObjectSpec:
        """Build one object.

        Raises:
            ConfigError: For a name that is not in the folder.
            DataError: For a mesh that cannot be used, naming the file and what is wrong.
        """
        if name not in self.names:
            raise ConfigError(unknown_name(f"object in {self._root}", name, self.names))
        body = self._read(name)
        rng = np.random.default_rng(zlib.crc32(name.encode()))
        pattern = PATTERNS[int(rng.integers(len(PATTERNS)))]
        return solid_object(
            name,
            body.pieces,
            surface=body.surface,
            mass=body.mass or self._density * sum(hull_volume(p) for p in body.pieces),
            material=Material(texture=print_texture(pattern, random_ink(rng), random_ink(rng), 0)),
            friction=(self._friction, 0.005, 0.0001),
            rest_poses=self._rests(body.pieces),
        )

    def _read(self, name: str) -> _Body:
        path = self._files[name]
        if path.suffix.lower() in MODEL_SUFFIXES:
            model = read_model(path)
            solids, surface, mass = model.solids, model.surface, model.mass
        else:
            surface, mass = read_mesh(path), 0.0
            solids = [surface]
        vertices, faces = surface[0] * self._scale, surface[1]
        check_size(path, vertices)
        pieces = [
            piece
            for corners, triangles in solids
            for piece in convex_pieces(corners * self._scale, triangles, self._pieces, self._concavity)
        ]
        return _Body(without_specks(pieces), (vertices, faces), mass)

    def _rests(self, pieces: list[FloatArray]) -> tuple[RestPose, ...]:
        """Return how an object comes to rest, or only those poses in which a hand can take it."""
        poses = rest_poses(pieces)
        return tuple(p for p in poses if _fits(pieces, p)) if self._graspable else poses


def _fits(pieces: list[FloatArray], pose: RestPose) -> bool:
    standing = np.concatenate(pieces) @ quat_wxyz_to_matrix(pose.quat_wxyz).T
    return float(np.ptp(standing[:, 2])) >= LOWEST and narrowest_width(standing[:, :2]) <= WIDEST
