"""What a workshop needs to know: the parts of one body beside the nominal ones."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from morphgen.factory import BodyFactory
from morphgen.files import write_text
from morphgen.skeleton import Array, Skeleton

COLUMNS: tuple[str, ...] = (
    "part",
    "length_m",
    "nominal_length_m",
    "mass_kg",
    "nominal_mass_kg",
    "com_x_m",
    "com_y_m",
    "com_z_m",
    "ixx_kgm2",
    "iyy_kgm2",
    "izz_kgm2",
    "ixy_kgm2",
    "ixz_kgm2",
    "iyz_kgm2",
    "changed",
)
_PARTS = ("hip", "thigh", "shank", "foot")


def bill_of_parts(factory: BodyFactory, design: ArrayLike) -> list[dict[str, str | float | bool]]:
    """One row per rigid part of one design (d,): trunk, then hip, thigh, shank and foot of each leg.

    Lengths run from joint axis to joint axis, of the trunk from front to hind hips, of the foot they are its radius.
    Centres of mass and inertias are in the part's frame, see `Skeleton`. Nominal is the robot as it is, under the
    factory's rule.
    """
    design = np.asarray(design, dtype=np.float64)
    body, nominal = (factory.skeleton(np.atleast_2d(x)) for x in (design, factory.space.nominal))
    rows = [_row("trunk", *(_trunk(x) for x in (body, nominal)))]
    for leg in range(4):
        for part, name in enumerate(_PARTS):
            numbers = (_part(x, leg, part) for x in (body, nominal))
            rows.append(_row(f"{factory.layout.body(leg, part)} ({name})", *numbers))
    return rows


def write_bill(path: Path, factory: BodyFactory, design: ArrayLike) -> None:
    """Write `bill_of_parts` as CSV, units in the column names, with a line for the whole robot at the end."""
    rows = bill_of_parts(factory, design)
    mass, nominal = (sum(float(row[key]) for row in rows) for key in ("mass_kg", "nominal_mass_kg"))
    rows.append(
        {"part": "robot", "mass_kg": mass, "nominal_mass_kg": nominal, "changed": any(r["changed"] for r in rows)}
    )
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, restval="")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


Numbers = tuple[float, float, Array, Array]
"""Length, mass, centre of mass, inertia."""


def _trunk(body: Skeleton) -> Numbers:
    hips = body.joint_origin[0, :, 0, 0]
    length = float(hips[:2].mean() - hips[2:].mean())
    return length, float(body.base_mass[0]), body.base_com[0], body.base_inertia[0]


def _part(body: Skeleton, leg: int, part: int) -> Numbers:
    length = (
        float(body.foot_radius[0, leg]) if part == 3 else float(np.linalg.norm(body.joint_origin[0, leg, part + 1]))
    )
    return length, float(body.link_mass[0, leg, part]), body.link_com[0, leg, part], body.link_inertia[0, leg, part]


def _row(name: str, numbers: Numbers, nominal: Numbers) -> dict[str, str | float | bool]:
    length, mass, com, inertia = numbers
    changed = any(not np.array_equal(a, b) for a, b in zip(numbers, nominal, strict=True))
    tensor = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    values = (name, length, nominal[0], mass, nominal[1], *map(float, com), *map(float, tensor), changed)
    return dict(zip(COLUMNS, values, strict=True))
