"""Writing a body to files: URDF with its meshes, MJCF, GLB, picture and dimension table."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import shutil
from pathlib import Path

import mujoco
from numpy.typing import ArrayLike

from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory
from morphgen.files import replacing, write_bytes, write_text
from morphgen.simulation.mjcf import to_mjcf
from morphgen.urdf.writer import relocate
from morphgen.urdf.xml import Element, parse_urdf, to_text
from morphgen.views.bill import write_bill
from morphgen.views.drawing import draw_bodies
from morphgen.views.scene import body_scene, export_glb


def export_urdf(factory: BodyFactory, design: ArrayLike, path: Path, *, copy_meshes: bool = False) -> None:
    """Write the URDF of one design (d,) so that its meshes resolve from where it lies.

    Args:
        factory: makes the body.
        design: (d,).
        path: file to write; meshes that had to be made go to `baked/` beside it.
        copy_meshes: whether to copy the visual meshes to `meshes/` beside it too, so that the folder is complete;
            else relative names are rewritten and package:// is kept.

    Raises:
        MorphologyError: a mesh is missing or may not be read; names link, file and remedy.
        OSError: a file cannot be written.
    """
    scaled = factory.scaled_urdf(design)
    root = parse_urdf(scaled.text)
    folder = path.parent
    for name, content in scaled.meshes.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_bytes(folder / name, content)
    if copy_meshes:
        _copy_meshes(factory, root, folder, set(scaled.meshes))
    elif factory.folder is not None:
        relocate(root, factory.folder, folder)
    write_text(path, to_text(root))


def _copy_meshes(factory: BodyFactory, root: Element, folder: Path, baked: set[str]) -> None:
    copied: dict[Path, str] = {}
    for link in root.iter("link"):
        for mesh in link.iter("mesh"):
            name = mesh.get("filename", "")
            if name in baked:
                continue
            source = factory.meshes.path(name, f"link '{link.get('name')}' visual")
            if source not in copied:
                target = source.name
                while f"meshes/{target}" in copied.values():  # another folder had a file of this name
                    target = f"{source.parent.name}_{target}" if target == source.name else f"_{target}"
                (folder / "meshes").mkdir(parents=True, exist_ok=True)
                with replacing(folder / "meshes" / target) as temporary:
                    shutil.copyfile(source, temporary)
                copied[source] = f"meshes/{target}"
            mesh.set("filename", copied[source])


def export_mjcf(factory: BodyFactory, design: ArrayLike, path: Path, scene: mujoco.MjSpec | None = None) -> None:
    """Write the MJCF of one design (d,) with free joint, servos and sensors, in a scene (a flat floor by default)."""
    write_text(path, to_mjcf(factory.spec(design, scene)))


def export_body(factory: BodyFactory, design: ArrayLike, folder: Path) -> list[Path]:
    """Write everything about one design (d,) into a folder that can be moved.

    Returns:
        The files: robot.urdf (with meshes/), robot.xml, robot.glb, dimensions.csv, picture.png.

    Raises:
        MorphologyError: see `export_urdf`.
        OSError: a file cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise MorphologyError(f"{folder}: is a file; give a folder to write to")
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / name for name in ("robot.urdf", "robot.xml", "robot.glb", "dimensions.csv", "picture.png")]
    urdf, mjcf, glb, bill, picture = files
    export_urdf(factory, design, urdf, copy_meshes=True)
    export_mjcf(factory, design, mjcf)
    export_glb(body_scene(factory, design), glb)
    write_bill(bill, factory, design)
    with replacing(picture) as temporary:
        draw_bodies(factory, design, [factory.name]).savefig(temporary)
    return files
