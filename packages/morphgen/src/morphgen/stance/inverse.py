"""Inverse kinematics of legs in their sagittal planes: a triangle of thigh, shank and the line hip to foot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morphgen.errors import MorphologyError
from morphgen.skeleton import Array, Skeleton

AXIS_TOLERANCE = 2e-3
"""How far an axis may lie off x or y [rad]: files write right angles as 1.57."""
LEGS = ("FL", "FR", "RL", "RR")
JOINTS = ("hip", "thigh", "knee")


@dataclass(frozen=True)
class SagittalLegs:
    """Thighs and shanks seen from the side, with the hip joints at 0; leading dimensions (...) broadcast.

    Segment angles are measured from straight down, positive about +y: a positive thigh angle puts the knee behind
    the thigh joint.

    Attributes:
        length: (..., 4, 2) of thigh and shank in the plane [m].
        rest: (..., 4, 2) angles of thigh and shank at zero joint angles [rad].
        sign: (4, 2) 1 where thigh and knee joint turn about +y, -1 where about -y.
        lower: (4, 2) limits of thigh and knee [rad].
        upper: (4, 2) limits of thigh and knee [rad].
        bend: (..., 4) side of the line from thigh joint to foot on which the knee should lie: 1 behind, -1 in front.
        fixed: (4,) whether `bend` also holds where only the other side keeps the limits.
    """

    length: Array
    rest: Array
    sign: Array
    lower: Array
    upper: Array
    bend: Array
    fixed: NDArray[np.bool_]


@dataclass(frozen=True)
class LegAngles:
    """Solutions of the inverse kinematics.

    Attributes:
        joint: (..., 4, 2) thigh and knee angles [rad], outside of the limits where there is no better solution.
        thigh: (..., 4) angle of the thigh from straight down, positive backwards [rad].
        reachable: (..., 4) whether the foot gets to the point; if not, the leg points to it or is folded.
        within: (..., 4) whether both joints keep their limits.
    """

    joint: Array
    thigh: Array
    reachable: NDArray[np.bool_]
    within: NDArray[np.bool_]


def sagittal_legs(body: Skeleton, knees: Sequence[int | None] | None = None) -> SagittalLegs:
    """The legs of n bodies from the side.

    A knee bends to the side on which the middle of its limits lies from the straight leg; backwards if the limits
    do not tell: none, a whole turn or more, or a middle at the straight leg.

    Args:
        body: n bodies.
        knees: for each leg 1 for a knee that bends backwards, -1 for one that bends forwards, or None.

    Raises:
        MorphologyError: a hip joint not about x, a thigh or knee joint not about y, a segment without length in
            the sagittal plane, or bad `knees`; names the leg.
    """
    _check_axes(body)
    segment = body.joint_origin[:, :, 2:]
    length = np.hypot(segment[..., 0], segment[..., 2])
    if not np.all(length > 0):
        row, leg, part = np.argwhere(~(length > 0))[0]
        raise MorphologyError(
            f"body {row}, leg {LEGS[leg]}: the {('thigh', 'shank')[part]} has no length in the plane of x and z; "
            "its far joint or foot must lie off its joint axis"
        )
    rest = np.arctan2(-segment[..., 0], -segment[..., 2])
    sign = np.sign(body.axis[:, 1:, 1])
    lower, upper = body.lower[:, 1:], body.upper[:, 1:]

    # the knee angle of a straight leg, and the way from there to the middle of the limits
    straight = sign[:, 1] * (rest[..., 0] - rest[..., 1])
    with np.errstate(invalid="ignore"):  # inf - inf where there are no limits
        middle, span = (lower[:, 1] + upper[:, 1]) / 2, upper[:, 1] - lower[:, 1]
    told = np.isfinite(span) & (span < 2 * np.pi)
    way = sign[:, 1] * np.where(told, _wrapped(np.where(told, middle, 0) - straight), 0)
    bend = np.where(way > AXIS_TOLERANCE, -1.0, 1.0)

    given = np.array([np.nan if side is None else side for side in knees or [None] * 4], dtype=np.float64)
    if given.shape != (4,) or not np.all(np.isnan(given) | (np.abs(given) == 1)):
        raise MorphologyError(f"knees: needs 1 (backwards), -1 (forwards) or None for each of 4 legs, got {knees}")
    fixed = ~np.isnan(given)
    return SagittalLegs(length, rest, sign, lower, upper, np.where(fixed, given, bend), fixed)


def leg_angles(legs: SagittalLegs, reach: Array, offset: Array) -> LegAngles:
    """Angles that put each foot centre `reach` (..., 4) below and `offset` (..., 4) in front of its thigh joint [m].

    Of the two solutions it is the one with the knee on the side `legs.bend`, unless only the other one keeps the
    limits.
    """
    one, other = (_solve(legs, bend, reach, offset) for bend in (legs.bend, -legs.bend))
    swap = ~one.within & other.within & ~legs.fixed
    return LegAngles(
        joint=np.where(swap[..., None], other.joint, one.joint),
        thigh=np.where(swap, other.thigh, one.thigh),
        reachable=one.reachable,
        within=one.within | swap,
    )


def _solve(legs: SagittalLegs, bend: Array, reach: Array, offset: Array) -> LegAngles:
    thigh, shank = legs.length[..., 0], legs.length[..., 1]
    distance = np.hypot(offset, reach)
    with np.errstate(divide="ignore", invalid="ignore"):  # a foot at the thigh joint is not reachable
        cos_hip = (thigh**2 + distance**2 - shank**2) / (2 * thigh * distance)
    cos_knee = (distance**2 - thigh**2 - shank**2) / (2 * thigh * shank)
    reachable = (np.abs(cos_hip) <= 1) & (np.abs(cos_knee) <= 1) & (reach > 0)
    # positive rotation about +y swings the knee backwards, negative folds the shank forwards again
    thigh_angle = bend * np.arccos(np.clip(np.nan_to_num(cos_hip), -1, 1)) - np.arctan2(offset, reach)
    knee_angle = -bend * np.arccos(np.clip(cos_knee, -1, 1))
    joint = legs.sign * np.stack(
        [thigh_angle - legs.rest[..., 0], knee_angle - (legs.rest[..., 1] - legs.rest[..., 0])], axis=-1
    )
    joint = _turned_into(joint, legs.lower, legs.upper)
    within = np.all((joint >= legs.lower) & (joint <= legs.upper), axis=-1)
    return LegAngles(joint, thigh_angle, reachable, within)


def _turned_into(angle: Array, lower: Array, upper: Array) -> Array:
    """The angle, or the one that is whole turns away and keeps the limits if only that one does."""
    with np.errstate(invalid="ignore"):
        turned = np.where(angle < lower, angle + 2 * np.pi * np.ceil((lower - angle) / (2 * np.pi)), angle)
        turned = np.where(angle > upper, angle - 2 * np.pi * np.ceil((angle - upper) / (2 * np.pi)), turned)
    return np.where((turned >= lower) & (turned <= upper), turned, angle)


def _wrapped(angle: Array) -> Array:
    """The same angle in [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _check_axes(body: Skeleton) -> None:
    for leg in range(4):
        for k, (joint, wanted) in enumerate(zip(JOINTS, "xyy", strict=True)):
            axis = body.axis[leg, k]
            off = np.delete(axis, "xyz".index(wanted))
            if not np.linalg.norm(off) <= AXIS_TOLERANCE:
                raise MorphologyError(
                    f"leg {LEGS[leg]}: its {joint} joint turns about {np.round(axis, 4)} of the base at zero angles; "
                    f"a level stance needs hip joints about x (forward) and thigh and knee joints about y"
                )
