"""Files of a body for the browser to save."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

from numpy.typing import ArrayLike

from morphgen.errors import MorphologyError
from morphgen.export import export_urdf
from morphgen.factory import BodyFactory
from morphgen.simulation.mjcf import to_mjcf


def urdf_file(factory: BodyFactory, design: ArrayLike) -> tuple[str, bytes]:
    """File name and content: the URDF of one design (d,), or a zip of it and its meshes if it has any.

    Where a mesh is missing here, the URDF goes alone and names its meshes as the robot's file does.
    """
    name = f"{factory.name}.urdf"
    with TemporaryDirectory() as folder:
        try:
            export_urdf(factory, design, Path(folder) / name, copy_meshes=True)
        except MorphologyError:
            return name, factory.urdf(design).encode()
        files = sorted(path for path in Path(folder).rglob("*") if path.is_file())
        if len(files) == 1:
            return name, files[0].read_bytes()
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in files:
                archive.write(path, path.relative_to(folder))
    return f"{factory.name}.zip", packed.getvalue()


def mjcf_file(factory: BodyFactory, design: ArrayLike) -> tuple[str, bytes]:
    """File name and content: the MJCF of one design (d,) on a flat floor."""
    return f"{factory.name}.xml", to_mjcf(factory.spec(design)).encode()
