"""Reading DAE, STL, OBJ, GLB and PLY files as one triangle mesh."""

from __future__ import annotations

import io
import re
import zipfile
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import trimesh
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue]
from trimesh.exchange.load import mesh_loaders
from trimesh.resolvers import FilePathResolver
from trimesh.visual.color import ColorVisuals
from trimesh.visual.texture import TextureVisuals

from morphgen.errors import MorphologyError

FORMATS = (".dae", ".stl", ".obj", ".glb", ".ply")
MAX_BYTES = 200 * 2**20
_NO_COLORS = ((102, 102, 102, 255), (100, 100, 100, 255))


def load_mesh(path: Path) -> trimesh.Trimesh:
    """The mesh in metres, in its own axes, one part, coloured by vertex or face if the file has colours.

    As RViz and yourdfpy do, the up-axis of a DAE is ignored; as RViz does, its unit is not. Textures are read from
    the folder of the file alone.

    Raises:
        MorphologyError: the file is too large, of an unknown format, broken, empty, or has vertices that are not
            finite; the message goes on from the name of the file.
    """
    kind = path.suffix.lower().removeprefix(".")
    if f".{kind}" not in FORMATS:
        raise MorphologyError(f"has a format that is not read; convert it to one of {', '.join(FORMATS)}")
    if path.stat().st_size > MAX_BYTES:
        raise MorphologyError(f"is larger than {MAX_BYTES >> 20} MiB; simplify it")
    data = path.read_bytes()
    if kind != "dae":
        return _read(data, kind, path)
    root = _checked_dae(data)
    try:
        return _read(data, kind, path)
    except MorphologyError:
        # a broken material costs pycollada the whole mesh
        return _read(_without_materials(root), kind, path)


def _read(data: bytes, kind: str, path: Path) -> trimesh.Trimesh:
    try:
        contents = mesh_loaders[kind](file_obj=io.BytesIO(data), file_type=kind, resolver=FilePathResolver(str(path)))
        # checked here, since trimesh drops vertices that are not finite
        broken = any(
            not np.isfinite(part["vertices"]).all() for part in contents.get("geometry", {"": contents}).values()
        )
        scene = trimesh.load_scene(contents)
        mesh = trimesh.util.concatenate([_plain(part) for part in scene.dump() if isinstance(part, trimesh.Trimesh)])
    except Exception as error:  # the readers of five formats raise what they like
        raise MorphologyError(f"cannot be read: {str(error) or type(error).__name__}; export it again") from error
    if broken:
        raise MorphologyError("has vertices that are not finite; export it again")
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise MorphologyError("has no triangles; export it again")
    unit = re.match(r"([\d.eE+-]+) \* meters", str(mesh.metadata.get("units", "")))
    if kind == "dae" and unit:
        mesh.apply_scale(float(unit[1]))
    return mesh


def _plain(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with its material or texture as a colour of each vertex, so that parts can be joined."""
    if isinstance(mesh.visual, TextureVisuals):
        material = mesh.visual.material
        colors = material.to_color(mesh.visual.uv)
        if colors is None:
            colors = material.main_color
        mesh.visual = ColorVisuals(mesh)
        # trimesh gives a default grey to an OBJ whose materials are missing
        if not any(np.all(colors == grey) for grey in _NO_COLORS):
            mesh.visual.vertex_colors = np.broadcast_to(colors, (len(mesh.vertices), 4))
    return mesh


def _checked_dae(data: bytes) -> Element:
    """Parse COLLADA and refuse what its reader would expand or hide: entities, archives and NaN."""
    if zipfile.is_zipfile(io.BytesIO(data)):
        raise MorphologyError("is an archive; unpack it")
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=True)
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        raise MorphologyError(f"is not well-formed XML: {error}; export it again") from error
    if root.getroottree().docinfo.doctype:
        raise MorphologyError("has a DOCTYPE, which a mesh does not need; remove it")
    # the reader takes NaN for 0
    if any("nan" in (numbers.text or "").lower() for numbers in root.iter("{*}float_array")):
        raise MorphologyError("has numbers that are not finite; export it again")
    return root


def _without_materials(root: Element) -> bytes:
    for tag in ("bind_material", "library_materials", "library_effects", "library_images"):
        for element in list(root.iter(f"{{*}}{tag}")):
            element.getparent().remove(element)  # pyright: ignore[reportAttributeAccessIssue]
    return etree.tostring(root)
