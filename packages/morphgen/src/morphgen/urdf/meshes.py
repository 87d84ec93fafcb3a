"""Finding and loading the mesh files that a URDF names, and nothing outside its package."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.visual.color import ColorVisuals

from morphgen.errors import MorphologyError
from morphgen.urdf.meshfile import load_mesh

_SCHEME = re.compile(r"^([A-Za-z][A-Za-z0-9+.-]+):")
_PACKAGE = re.compile(r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")

Place = tuple[Path, tuple[Path, ...]]


class MeshFinder:
    """Resolves mesh file names as ROS tools do, and loads each file once.

    `package://name/rest` is looked for as `P/name/rest` and `P/rest` in every search path P, then below the
    folders above the URDF that are called `name` or contain a folder `name`. Other names are relative to the
    folder of the URDF, then to the search paths. Since files move, a search path may last hold the file itself.
    The file found, links followed, must lie in a search path, in the URDF's package (the nearest folder above it
    with a package.xml, else the parent of its folder), or in the folder of the `package://` package.
    """

    def __init__(self, urdf: Path | None, search: Sequence[Path] = ()) -> None:
        """Set the places to look.

        Args:
            urdf: file of the robot; None for a robot that came as text, whose meshes are in `search` alone.
            search: folders that hold meshes or packages.

        Raises:
            MorphologyError: a search path is not a folder.
        """
        self._search = tuple(Path(folder).absolute() for folder in search)
        for folder in self._search:
            if not folder.is_dir():
                raise MorphologyError(f"the mesh path '{folder}' is not a folder")
        # a URDF that is a link has its meshes beside the link or beside its target
        files = [] if urdf is None else list(dict.fromkeys([Path(urdf).absolute(), Path(urdf).resolve()]))
        self._folders = tuple(file.parent for file in files)
        self._roots = (*self._search, *(_package(folder) for folder in self._folders))
        self._loaded: dict[Path, trimesh.Trimesh] = {}

    def path(self, filename: str, where: str) -> Path:
        """The file that a URDF means.

        Args:
            filename: as written in the URDF.
            where: what names it, for messages, such as "link 'FL_thigh' visual".

        Raises:
            MorphologyError: not found, outside the allowed folders, or not a file name.
        """
        places = list(self._places(filename, where))
        outside = None
        for place, roots in places:
            resolved = place.resolve()
            if not any(resolved.is_relative_to(root.resolve()) for root in roots):
                outside = outside or resolved
            elif resolved.is_file():
                return resolved
        if outside is not None:
            raise MorphologyError(
                f"{where}: mesh '{filename}' leads to {outside}, outside the robot's package; "
                "give the folder that holds it with --mesh-path"
            )
        tried = ", ".join(dict.fromkeys(str(place) for place, _ in places)) or "nothing, for no folder has that name"
        raise MorphologyError(
            f"{where}: mesh '{filename}' not found; tried {tried}; "
            "give the folder that holds the meshes or packages with --mesh-path"
        )

    def load(self, filename: str, where: str) -> trimesh.Trimesh:
        """The mesh in metres, in its own axes, one part, coloured by vertex or face if the file has colours.

        As RViz and yourdfpy do, the up-axis of a DAE is ignored; as RViz does, its unit is not. The result is
        shared between calls: copy it before changing it.

        Raises:
            MorphologyError: as `path`; or the file is too large, of an unknown format, broken, empty, or has
                vertices that are not finite.
        """
        path = self.path(filename, where)
        if path not in self._loaded:
            try:
                self._loaded[path] = load_mesh(path)
            except MorphologyError as error:
                raise MorphologyError(f"{where}: mesh {path} {error}") from error
        return self._loaded[path]

    def _places(self, filename: str, where: str) -> Iterator[Place]:
        """Where the file could be, each with the folders that it must not leave."""
        scheme = _SCHEME.match(filename)
        if "\0" in filename:
            raise MorphologyError(f"{where}: mesh {filename!r} is not a file name")
        if scheme is None:
            for folder in (*self._folders, *self._search):
                yield folder / filename, self._roots
        elif scheme[1] == "file":
            yield Path(unquote(urlsplit(filename).path)), self._roots
        elif scheme[1] == "package":
            yield from self._in_package(filename, where)
        else:
            raise MorphologyError(
                f"{where}: mesh '{filename}': {scheme[1]}: is not read; "
                "save the file beside the robot and name it by a relative path or package://"
            )
        for folder in self._search:
            yield folder / PurePosixPath(filename).name, self._roots

    def _in_package(self, filename: str, where: str) -> Iterator[Place]:
        name, _, rest = filename.removeprefix("package://").partition("/")
        if not _PACKAGE.match(name) or not rest:
            raise MorphologyError(f"{where}: mesh '{filename}' is not of the form package://name/file")
        rest = rest.lstrip("/")
        for folder in self._search:
            yield folder / name / rest, self._roots
            yield folder / rest, self._roots
        for ancestor in dict.fromkeys(above for folder in self._folders for above in (folder, *folder.parents)):
            if ancestor.name == name:
                yield ancestor / rest, (*self._roots, ancestor)
            # a system folder such as /etc is no package
            elif ancestor != ancestor.parent and (ancestor / name).is_dir():
                yield ancestor / name / rest, (*self._roots, ancestor / name)


def _package(folder: Path) -> Path:
    """The package that a URDF's folder belongs to."""
    for above in (folder, *folder.parents):
        if (above / "package.xml").is_file():
            return above
    return folder.parent


def scaled(mesh: trimesh.Trimesh, linear: NDArray[np.float64]) -> trimesh.Trimesh:
    """A copy of a mesh with its vertices mapped by `linear` (3, 3); faces keep pointing outwards if it mirrors."""
    matrix = np.eye(4)
    matrix[:3, :3] = linear
    return mesh.copy().apply_transform(matrix)


def baked(mesh: trimesh.Trimesh, linear: NDArray[np.float64]) -> bytes:
    """The mesh mapped by `linear` (3, 3), as a binary STL; for a stretch that no <mesh scale> can express.

    Args:
        mesh: in its own axes [m].
        linear: stretch in link axes times rotation and scale of the visual, so that the result is in link axes.
    """
    data = scaled(mesh, linear).export(file_type="stl")
    assert isinstance(data, bytes)
    return data


def read_stl(data: bytes) -> trimesh.Trimesh:
    """A mesh from the bytes that `baked` gave, its faces in their order."""
    return trimesh.load_mesh(io.BytesIO(data), file_type="stl")


def has_colors(mesh: trimesh.Trimesh) -> bool:
    """Whether the mesh has colours by vertex or face."""
    return isinstance(mesh.visual, ColorVisuals) and mesh.visual.defined


def face_colors(mesh: trimesh.Trimesh) -> NDArray[np.uint8] | None:
    """(m, 4) colours of the faces; None if the mesh has no colours."""
    visual = mesh.visual
    return visual.face_colors if isinstance(visual, ColorVisuals) and visual.defined else None
