"""Unitree Go2: the vendor's masses, joints and limits; the collision shapes of the legs are ours."""

from __future__ import annotations

from morphgen.robots.description import (
    Ball,
    Box,
    Cylinder,
    Hinge,
    Inertial,
    QuadrupedDescription,
    Segment,
    VendorControl,
    mirrored_hips,
)

# vendor numbers are those of unitree_ros and unitree_rl_gym, which agree unless said otherwise
GO2 = QuadrupedDescription(
    name="go2",
    base="base",
    legs=("FL", "FR", "RL", "RR"),
    links=("_hip", "_thigh", "_calf", "_foot"),
    joints=("_hip_joint", "_thigh_joint", "_calf_joint", "_foot_joint"),
    # the trunk and its two head links of 1 g each, whose inertia is left out
    trunk=Inertial(
        6.921 + 0.002, (0.021112, 0.0, -0.005366), (0.02448, 1.2166e-4, 1.4849e-3, 0.098077, -3.12e-5, 0.107)
    ),
    trunk_boxes=(Box((0.3762, 0.0935, 0.114)),),
    hip_position=(0.1934, 0.0465),
    hip_offset=0.0955,
    hips=mirrored_hips(
        Inertial(0.678, (-0.0054, 0.00194, -0.000105), (4.8e-4, -3.01e-6, 1.11e-6, 8.84e-4, -1.42e-6, 5.96e-4))
    ),
    hip_cylinder=Cylinder(radius=0.046, length=0.04, outward=0.08),
    # the widths are ours: the vendor's thigh box is 0.0245 by 0.034
    thigh=Segment(
        length=0.213,
        width=0.029,
        vendor=Inertial(1.152, (-0.00374, -0.0223, -0.0327), (0.00584, 8.72e-5, -2.89e-4, 0.0058, 8.08e-4, 0.00103)),
    ),
    shank=Segment(
        length=0.213,
        width=0.024,
        vendor=Inertial(0.154, (0.00548, -0.000975, -0.115), (0.00108, 3.4e-7, 1.72e-5, 0.0011, 8.28e-6, 3.29e-5)),
    ),
    foot=Ball(mass=0.04, radius=0.022, inertia=9.6e-6),
    hinges=(
        Hinge((1, 0, 0), front=(-1.0472, 1.0472), hind=(-1.0472, 1.0472), effort=23.7, velocity=30.1),
        Hinge((0, 1, 0), front=(-1.5708, 3.4907), hind=(-0.5236, 4.5379), effort=23.7, velocity=30.1),
        # the present unitree_ros; unitree_rl_gym has 35.55 N m and 20.07 rad/s, the same power
        Hinge((0, 1, 0), front=(-2.7227, -0.83776), hind=(-2.7227, -0.83776), effort=45.43, velocity=15.70),
    ),
    # the vendor's URDF has none; these are of the size identified on the robot
    armature=0.01,
    damping=0.1,
    friction=0.1,
    # the stand example of unitree_sdk2
    control=VendorControl(legs=("FR", "FL", "RR", "RL"), stand=(0.0, 0.67, -1.3), kp=60.0, kd=5.0),
)
"""Unitree Go2, 15.019 kg."""
