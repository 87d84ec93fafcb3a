"""DeepRobotics Jueying Lite3: the vendor's masses, joints and limits; the collision shapes of the legs are ours."""

from __future__ import annotations

import math

from morphgen.robots.description import (
    Ball,
    Box,
    Cylinder,
    Hinge,
    Inertial,
    QuadrupedDescription,
    Segment,
    VendorControl,
)

_HIP_MASS = 0.55
_LEFT = (3.949e-4, 0.0, 0.0, 4.028e-4, 0.0, 4.472e-4)
_RIGHT = (4.472e-4, 0.0, 0.0, 4.028e-4, 0.0, 3.949e-4)
_FOOT_MASS, _FOOT_RADIUS = 0.02, 0.022

# vendor numbers are those of deep_robotics_model of December 2025, which gives no inertia products
LITE3 = QuadrupedDescription(
    name="lite3",
    base="TORSO",
    legs=("FL", "FR", "HL", "HR"),
    links=("_HIP", "_THIGH", "_SHANK", "_FOOT"),
    joints=("_HipX", "_HipY", "_Knee", "_Ankle"),
    trunk=Inertial(5.6056, (0.0, 0.0, 0.0), (0.02456, 0.0, 0.0, 0.05518, 0.0, 0.07016)),
    trunk_boxes=(Box((0.5, 0.1, 0.12), (0.0, 0.0, 0.01)), Box((0.25, 0.2, 0.12), (0.0, 0.0, 0.01))),
    hip_position=(0.1745, 0.062),
    hip_offset=0.09735,
    # no mirror images in the vendor's file either
    hips=(
        Inertial(_HIP_MASS, (-0.00601, -0.0066532, 0.00034295), _LEFT),
        Inertial(_HIP_MASS, (-0.010579, 0.011358, 0.00048546), _RIGHT),
        Inertial(_HIP_MASS, (0.010905, -0.012636, 0.001051), _LEFT),
        Inertial(_HIP_MASS, (0.010354, 0.011423, 0.00049498), _RIGHT),
    ),
    hip_cylinder=Cylinder(radius=0.04, length=0.15, outward=0.05),
    # the widths are those of the paper's boxes
    thigh=Segment(
        length=0.20,
        width=0.02,
        vendor=Inertial(0.86, (-0.0039245, -0.014632, -0.025146), (0.005736, 0.0, 0.0, 0.00496, 0.0, 0.001436)),
    ),
    # the vendor's y of the centre of mass, 1.5 um, is taken as 0
    shank=Segment(
        length=0.21012,
        width=0.02,
        vendor=Inertial(0.153, (0.0064794, 0.0, -0.12157), (8.9039e-4, 0.0, 0.0, 9.0672e-4, 0.0, 3.1266e-5)),
    ),
    # the vendor's foot has no inertia; this is a solid ball's
    foot=Ball(_FOOT_MASS, _FOOT_RADIUS, inertia=0.4 * _FOOT_MASS * _FOOT_RADIUS**2),
    hinges=(
        Hinge((-1, 0, 0), front=(-0.523, 0.523), hind=(-0.523, 0.523), effort=24.0, velocity=26.2),
        Hinge((0, -1, 0), front=(-2.67, 0.314), hind=(-2.67, 0.314), effort=24.0, velocity=26.2),
        Hinge((0, -1, 0), front=(0.524, 2.792), hind=(0.524, 2.792), effort=36.0, velocity=17.3),
    ),
    # the vendor's files have 0; these are ours, as on Go2, whose motors are about as strong
    armature=0.01,
    damping=0.1,
    friction=0.1,
    # the stand of the vendor's motion SDK: 0, -42 and 78 degrees
    control=VendorControl(
        legs=("FL", "FR", "HL", "HR"), stand=(0.0, math.radians(-42.0), math.radians(78.0)), kp=80.0, kd=0.7
    ),
)
"""DeepRobotics Jueying Lite3, 11.9376 kg."""
