"""What a bundle says of robot and interface, as a JSON file.

The keys are the fields of `distill.spec.BundleSpec`; `joints` and `observation` are lists of tables, `camera` is a
table or null. Each of `urdf`, `robot_xml` and `scene_xml` is the text itself, or the path of a file, absolute or
relative to the JSON file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import MISSING, asdict, fields
from pathlib import Path
from typing import Any

from distill.errors import BundleError
from distill.spec import BundleSpec, CameraSpec, JointSpec, ObservationTerm

_TEXTS = ("urdf", "robot_xml", "scene_xml")


def write_spec(spec: BundleSpec, path: Path) -> None:
    """Write a specification, texts included.

    Raises:
        BundleError: its `training` holds something that JSON cannot.
    """
    try:
        text = json.dumps(asdict(spec), indent=1, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise BundleError(f"bundle '{spec.name}': cannot be written as JSON: {error}") from error
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text + "\n", encoding="utf-8")


def read_spec(path: Path) -> BundleSpec:
    """Read a specification.

    Raises:
        BundleError: names the file, and the element that is missing, unknown or wrong.
    """
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BundleError(f"{path}: not readable as JSON: {error}") from error
    table = dict(_checked(BundleSpec, table, str(path)))
    for name in _TEXTS:
        table[name] = _text(table[name], path.parent, f"{path}: {name}")
    for name, kind in (("joints", JointSpec), ("observation", ObservationTerm)):
        if not isinstance(table[name], list):
            raise BundleError(f"{path}: '{name}' must be a list of tables")
        places = enumerate(table[name])
        table[name] = tuple(kind(**_tuples(_checked(kind, each, f"{path}: {name}[{i}]"))) for i, each in places)
    if table.get("camera") is not None:
        table["camera"] = CameraSpec(**_tuples(_checked(CameraSpec, table["camera"], f"{path}: camera")))
    try:
        return BundleSpec(**_tuples(table))
    except TypeError as error:
        raise BundleError(f"{path}: an element has the wrong type: {error}") from error


def _checked(kind: type, table: object, where: str) -> Mapping[str, Any]:
    """The table of a dataclass `kind`, with all keys that it must have and no others."""
    if not isinstance(table, dict):
        raise BundleError(f"{where}: must be a table, is {type(table).__name__}")
    known = {field.name: field for field in fields(kind)}
    needed = [name for name, f in known.items() if f.default is MISSING and f.default_factory is MISSING]
    if missing := [name for name in needed if name not in table]:
        raise BundleError(f"{where}: lacks {', '.join(missing)}")
    if unknown := sorted(set(table) - set(known)):
        raise BundleError(f"{where}: has {', '.join(unknown)}, which means nothing; it may hold {', '.join(known)}")
    return table


def _tuples(table: Mapping[str, Any]) -> dict[str, Any]:
    """Lists as tuples, as the dataclasses have them."""
    return {name: tuple(value) if isinstance(value, list) else value for name, value in table.items()}


def _text(value: object, folder: Path, where: str) -> str:
    if not isinstance(value, str):
        raise BundleError(f"{where} must be a text or the path of a file")
    if "<" in value or not value.strip():
        return value
    try:
        return (folder / value).read_text(encoding="utf-8")
    except OSError as error:
        raise BundleError(f"{where}: {error}") from error
