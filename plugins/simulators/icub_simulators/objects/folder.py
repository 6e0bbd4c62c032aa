"""The user's own meshes."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np

from icub_core.errors import ConfigError, DataError, unknown_name
from icub_core.interfaces.object_set import ObjectSet
from icub_core.scene import Material, ObjectSpec
from icub_simulators.objects.meshes import MESH_SUFFIXES, check_size, convex_pieces, read_mesh, solid_object
from icub_simulators.objects.model_files import MODEL_SUFFIXES, read_model
from icub_simulators.objects.solids import hull_volume
from icub_simulators.objects.textures import PATTERNS, print_texture, random_ink


class Folder(ObjectSet):
    """Every OBJ, STL, URDF and MJCF file of a folder and its sub-folders, one object each, named by its path.

    A mesh need not be watertight: it is decomposed into convex pieces (CoACD) once, and the pieces are kept in the
    cache under a hash of the mesh. It is drawn as it is, in a colour derived from its name.

    A URDF or MJCF file describes one rigid object; its mass counts where it states one, and the meshes beside and below
    it are its parts, not objects.

    Args:
        path: The folder.
        scale: Factor from the files' unit to metres; 0.001 for millimetres.
        density: kg/m^3 of the pieces, for files that state no mass.
        pieces: Largest number of convex pieces; 1 takes the hull.
        concavity: Allowed error of the decomposition, share of the object's size.
        friction: Sliding friction coefficient.
    """

    def __init__(
        self,
        path: Path,
        scale: float = 1.0,
        density: float = 500.0,
        pieces: int = 16,
        concavity: float = 0.05,
        friction: float = 0.5,
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
        self._friction = friction
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

    @property
    def names(self) -> tuple[str, ...]:
        """Names in alphabetical order of the files."""
        return tuple(self._files)

    def get(self, name: str) -> ObjectSpec:
        """Build one object.

        Raises:
            ConfigError: For a name that is not in the folder.
            DataError: For a mesh that cannot be used, naming the file and what is wrong.
        """
        if name not in self._files:
            raise ConfigError(unknown_name(f"object in {self._root}", name, self._files))
        path = self._files[name]
        if path.suffix.lower() in MODEL_SUFFIXES:
            model = read_model(path)
            solids, surface, mass = model.solids, model.surface, model.mass
        else:
            surface, mass = read_mesh(path), 0.0
            solids = [surface]
        vertices, faces = surface[0] * self._scale, surface[1]
        check_size(path, vertices)
        rng = np.random.default_rng(zlib.crc32(name.encode()))
        pattern = PATTERNS[int(rng.integers(len(PATTERNS)))]
        pieces = [
            piece
            for corners, triangles in solids
            for piece in convex_pieces(corners * self._scale, triangles, self._pieces, self._concavity)
        ]
        return solid_object(
            name,
            pieces,
            surface=(vertices, faces),
            mass=mass or self._density * sum(hull_volume(p) for p in pieces),
            material=Material(texture=print_texture(pattern, random_ink(rng), random_ink(rng), 0)),
            friction=(self._friction, 0.005, 0.0001),
        )
