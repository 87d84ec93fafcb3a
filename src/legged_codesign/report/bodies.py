"""The chosen body beside the nominal one: dimensions, and a bill of the parts that change."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from typing import Any

import numpy as np
from locorl.interfaces import Array
from morphgen import BodyFactory
from morphgen.views.bill import bill_of_parts
from morphgen.views.dimensions import dimensions

INERTIA = ("ixx_kgm2", "iyy_kgm2", "izz_kgm2")
_SHOWN = {"m": (1000.0, "mm"), "kg": (1.0, "kg")}
_KG_CM2 = 1e4


def length_rows(factory: BodyFactory, bodies: Array) -> list[Mapping[str, Any]]:
    """Dimensions of bodies (n, d) in mm and kg; changes in percent of the first."""
    tables = [dimensions(factory, body) for body in bodies]
    rows = []
    for key, first in tables[0].items():
        name, unit = key.rsplit("_", 1)
        scale, shown = _SHOWN.get(unit, (1.0, unit))
        values = [scale * table[key] for table in tables]
        changes = [100.0 * (table[key] / first - 1.0) if first else 0.0 for table in tables]
        rows.append({"name": name.replace("_", " "), "unit": shown, "values": values, "changes": changes})
    return rows


def changed_parts(factory: BodyFactory, nominal: Array, chosen: Array) -> list[Mapping[str, Any]]:
    """The parts of which a workshop makes new ones: what they measure on both bodies.

    Parts that are alike, such as those of left and right legs, share a row. Lengths run from joint axis to joint axis,
    of a foot they are its radius; inertias are the moments about the centre of mass along the part's axes, kg cm^2.
    Parts that only sit elsewhere are not listed.
    """
    both = [bill_of_parts(factory, design) for design in (nominal, chosen)]
    rows = []
    for before, after in zip(*both, strict=True):
        old, new = _numbers(before), _numbers(after)
        if not np.allclose(old, new, rtol=1e-9, atol=1e-12):
            rows.append((str(before["part"]), old, new))
    rows.sort(key=_kind_and_size)  # stable: parts of a kind stay in the order of the bill
    return [
        {"parts": [name for name, _, _ in (first, *rest)], **_described(first[1], first[2])}
        for first, *rest in (list(group) for _, group in groupby(rows, key=_kind_and_size))
    ]


def total_mass(factory: BodyFactory, design: Array) -> float:
    """Mass of a body (d,), kg."""
    return float(factory.skeleton(np.atleast_2d(design)).total_mass[0])


def _numbers(row: Mapping[str, Any]) -> Array:
    """Length in mm, mass in kg, three moments of inertia in kg cm^2."""
    moments = [_KG_CM2 * float(row[name]) for name in INERTIA]
    return np.array([1000.0 * float(row["length_m"]), float(row["mass_kg"]), *moments])


def _kind_and_size(row: tuple[str, Array, Array]) -> tuple[Any, ...]:
    name, old, new = row
    return name.rpartition("(")[2], *np.round([*old, *new], 6)


def _described(old: Array, new: Array) -> dict[str, Any]:
    return {
        "length": (old[0], new[0]),
        "mass": (old[1], new[1]),
        "inertia": (tuple(old[2:]), tuple(new[2:])),
    }
