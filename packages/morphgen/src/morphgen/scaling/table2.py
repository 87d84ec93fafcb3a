"""Scaling thighs and shanks as uniform boxes: Table II of the paper, on arrays and on URDF text.

Both paths share the arithmetic of `scale_skeleton`. Length, mass and inertia of thigh and shank follow their
scale; the section, the foot, the hip and every limit stay.
"""

from __future__ import annotations

from dataclasses import replace
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import ArrayLike, NDArray

from morphgen.errors import MorphologyError
from morphgen.stance.skeleton import Array, Skeleton, read_skeleton
from morphgen.urdf.legs import find_legs
from morphgen.urdf.xml import format_vector, named, parse_urdf, to_text

SCALE_OF_SEGMENT = np.array([[0, 1], [0, 1], [2, 3], [2, 3]])
"""Index of the scale of (leg, thigh or shank): front thigh, front shank, hind thigh, hind shank."""


def box_inertia(mass: ArrayLike, length: ArrayLike, width: ArrayLike) -> Array:
    """Principal inertia (..., 3) of a uniform box of square section about its centre [kg m^2] (Table II)."""
    mass, length, width = (np.asarray(v, dtype=np.float64) for v in (mass, length, width))
    ixx = mass / 12 * (width**2 + length**2)
    return np.stack([ixx, ixx, mass * width**2 / 6], axis=-1)


def scale_skeleton(nominal: Skeleton, scales: NDArray[np.float64]) -> Skeleton:
    """Scale one body (n = 1) into n bodies by Table II.

    Args:
        nominal: the unscaled body; the length L_l of Table II is that of its collision boxes.
        scales: (n, 4) scales of front thigh, front shank, hind thigh and hind shank, all positive.
    """
    if scales.ndim != 2 or scales.shape[1] != 4 or not np.all(np.isfinite(scales) & (scales > 0)):
        raise MorphologyError(f"leg scales must be positive numbers of shape (n, 4), got {scales!r}")
    n = len(scales)
    xi = scales[:, SCALE_OF_SEGMENT]

    def repeated(values: Array) -> Array:
        return np.repeat(values, n, axis=0)

    mass, com = repeated(nominal.link_mass), repeated(nominal.link_com)
    origin, box = repeated(nominal.joint_origin), repeated(nominal.segment_box)
    mass[:, :, 1:3] *= xi
    box[..., 2] *= xi
    com[:, :, 1:3] = 0.0
    com[:, :, 1:3, 2] = -box[..., 2] / 2
    origin[:, :, 2:4, 2] *= xi
    return replace(
        nominal,
        joint_origin=origin,
        link_mass=mass,
        link_com=com,
        segment_box=box,
        segment_inertia=box_inertia(mass[:, :, 1:3], box[..., 2], box[..., 0]),
    )


def scale_urdf(text: str, scales: ArrayLike, source: str = "URDF") -> str:
    """Scale the legs of a URDF by Table II; everything else in the file stays as it is.

    Args:
        text: a URDF whose thighs and shanks have one box each as collision.
        scales: (4,) scales of front thigh, front shank, hind thigh and hind shank.
        source: name of the file, for messages.

    Returns:
        The scaled URDF; its numbers read back to the same float64.

    Raises:
        MorphologyError: not such a URDF, or bad scales.
    """
    root = parse_urdf(text, source)
    try:
        leg_map = find_legs(root)
        nominal = read_skeleton(root, leg_map)
    except MorphologyError as error:
        raise MorphologyError(f"{source}: {error}") from error
    scaled = scale_skeleton(nominal, np.atleast_2d(np.asarray(scales, dtype=np.float64)))
    links, joints = named(root, "link"), named(root, "joint")
    for i, leg in enumerate(leg_map.legs):
        for part in (0, 1):
            _write_segment(links[leg.links[part + 1]], scaled, i, part)
        for k, name in ((2, leg.joints[2]), (3, leg.ankle)):
            _child(joints[name], "origin").set("xyz", format_vector(scaled.joint_origin[0, i, k]))
    return to_text(root)


def _write_segment(link: Element, body: Skeleton, leg: int, part: int) -> None:
    centre = format_vector(body.link_com[0, leg, part + 1])
    inertial = _child(link, "inertial")
    _child(inertial, "origin").set("xyz", centre)
    _child(inertial, "mass").set("value", format_vector([body.link_mass[0, leg, part + 1]]))
    ixx, iyy, izz = body.segment_inertia[0, leg, part]
    values = {"ixx": ixx, "ixy": 0.0, "ixz": 0.0, "iyy": iyy, "iyz": 0.0, "izz": izz}
    for key, value in values.items():
        _child(inertial, "inertia").set(key, format_vector([value]))
    size = format_vector(body.segment_box[0, leg, part])
    for tag in ("visual", "collision"):
        for surplus in link.findall(tag)[1:]:
            link.remove(surplus)
        shape = _child(link, tag)
        origin = _child(shape, "origin")
        origin.set("xyz", centre)
        origin.attrib.pop("rpy", None)
        geometry = _child(shape, "geometry")
        for old in list(geometry):
            geometry.remove(old)
        _child(geometry, "box").set("size", size)


def _child(parent: Element, tag: str) -> Element:
    found = parent.find(tag)
    if found is None:
        # lxml's factory, because its trees take no elements of the standard library
        found = parent.makeelement(tag, {})
        parent.append(found)
    return found
