"""MJCF export at full precision."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from xml.etree.ElementTree import Element

import mujoco
import numpy as np

from morphgen.urdf.xml import format_vector, parse_xml, to_text

_ROUNDING = 1e-5
"""MuJoCo writes six significant digits."""


def to_mjcf(spec: mujoco.MjSpec) -> str:
    """The MJCF of a spec whose bodies, inertias, geoms, joints and servos read back to the compiled float64 values.

    `MjSpec.to_xml()` rounds to six digits, which would make an exported robot a slightly different one. Only
    attributes of named elements that agree with the compiled model up to that rounding are replaced.
    """
    model = spec.compile()
    root = parse_xml(spec.to_xml(), "MJCF")
    for element in root.iter():
        name = element.get("name")
        if name is None:
            continue
        if element.tag == "body":
            body = model.body(name)
            _refine(element, {"pos": body.pos, "quat": body.quat})
            inertial = element.find("inertial")
            if inertial is not None:
                values = {
                    "pos": body.ipos,
                    "quat": body.iquat,
                    "mass": body.mass,
                    "diaginertia": body.inertia,
                }
                _refine(inertial, values)
        elif element.tag == "geom":
            geom = model.geom(name)
            _refine(element, {"size": geom.size, "pos": geom.pos, "quat": geom.quat})
        elif element.tag == "joint":
            joint = model.joint(name)
            values = {
                key: getattr(joint, key) for key in ("axis", "range", "pos", "armature", "damping", "frictionloss")
            }
            _refine(element, values | {"actuatorfrcrange": model.jnt_actfrcrange[joint.id]})
        elif element.tag == "general":
            servo = model.actuator(name)
            _refine(element, {key: getattr(servo, key) for key in ("gainprm", "biasprm", "forcerange")})
    return to_text(root)


def _refine(element: Element, exact: dict[str, np.ndarray]) -> None:
    for attribute, values in exact.items():
        written = element.get(attribute)
        if written is None:
            continue
        rounded = np.array([float(part) for part in written.split()])
        full = values[: rounded.size]
        if rounded.shape == full.shape and np.allclose(rounded, full, rtol=_ROUNDING, atol=1e-12):
            element.set(attribute, format_vector(full))
