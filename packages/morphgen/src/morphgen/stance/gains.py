"""Rules that adapt the PD gains of each joint to the body.

The paper multiplies the PD gains of joint j by a correction eta_j "via a polynomial from [26]" (Section IV-A2). The
coefficients are not public, and the code that its authors released has constant gains, so the rules here are ours,
each with its physics. A rule gives one eta per joint that multiplies both kp and kd.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Literal, get_args

import numpy as np

from morphgen.errors import MorphologyError
from morphgen.skeleton import Array, Skeleton
from morphgen.stance.inverse import JOINTS, LEGS
from morphgen.stance.kinematics import LegPoses, forward_kinematics
from morphgen.stance.stance import Stance

GainKind = Literal["none", "mass", "stance", "inertia", "polynomial"]


@dataclass(frozen=True)
class GainRule:
    """How the factor eta of the PD gains follows the body; m, L and I are those of the body, m0, L0, I0 nominal.

    none: eta = 1, the constant gains of the paper authors' released code (kp 40, kd 0.7).

    mass: eta = m / m0. The joint deflection under the body's own weight stays if the legs keep their length.

    stance: eta = (m / m0) (L / L0), L the mean length of the legs, thigh + shank. A joint carries a torque of the
    order m g L, so its deflection under the body's own weight stays. For segments of uniform density m and L are
    linear in their scales, and eta is a polynomial in them. It stands in for that of [26] and is our choice.

    inertia: eta = I / I0 for each joint, I the inertia about its axis of the part of the leg that it moves, with
    the other joints held in the stance. kp and kd follow I alike, so the free leg keeps its bandwidth sqrt(kp / I)
    and its damping ratio kd / (2 sqrt(kp I)). Armature is left out, so with rotors this holds as far as the leg
    outweighs them.

    polynomial: eta = sum of c_k times the monomials of total degree 0, 1 and 2 in x = xi - xi0, the design less
    the nominal one, in the order 1, x_1 ... x_d, x_1 x_1, x_1 x_2 ... x_1 x_d, x_2 x_2 ... x_d x_d: for
    M = (d + 1)(d + 2) / 2 of them (15 for four scales). `coefficients` has M numbers for all joints alike, or 3 M
    for hip, thigh and knee one after the other, or 12 M for the joints in the order of the layout.

    Attributes:
        kind: name of the rule.
        coefficients: of `polynomial` [-].
    """

    kind: GainKind = "none"
    coefficients: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Check what does not need a design space."""
        if self.kind not in get_args(GainKind):
            raise MorphologyError(f"unknown gain rule '{self.kind}'; known: {', '.join(get_args(GainKind))}")
        if (self.kind == "polynomial") != bool(self.coefficients):
            raise MorphologyError(f"gain rule '{self.kind}': 'polynomial' needs coefficients, and no other rule does")
        if not np.all(np.isfinite(self.coefficients)):
            raise MorphologyError(f"gain rule: coefficients must be finite, got {self.coefficients}")


def gain_factors(
    rule: GainRule,
    bodies: Skeleton,
    stance: Stance,
    nominal: Skeleton,
    nominal_stance: Stance,
    designs: Array,
    nominal_design: Array,
) -> Array:
    """Factors eta (n, 4, 3) of kp and kd at hip, thigh and knee of each leg.

    Args:
        rule: the rule.
        bodies: n bodies.
        stance: their stances.
        nominal: the nominal body (n = 1).
        nominal_stance: its stance.
        designs: (n, d) designs of the bodies.
        nominal_design: (d,) design of the nominal body.

    Raises:
        MorphologyError: a number of coefficients that does not fit d, or a factor that is not positive and
            finite; names the row of the design.
    """
    eta = np.ones((bodies.n, 4, 3))
    match rule.kind:
        case "none":
            pass
        case "mass":
            eta *= _column(bodies.total_mass / nominal.total_mass)
        case "stance":
            eta *= _column(bodies.total_mass / nominal.total_mass * (_leg_length(bodies) / _leg_length(nominal)))
        case "inertia":
            eta *= swung_inertia(bodies, forward_kinematics(bodies, stance.joints))
            eta /= swung_inertia(nominal, forward_kinematics(nominal, nominal_stance.joints))
        case "polynomial":
            eta *= _polynomial(np.asarray(rule.coefficients), designs - nominal_design)
    bad = ~(np.isfinite(eta) & (eta > 0))
    if bad.any():
        row, leg, joint = np.argwhere(bad)[0]
        raise MorphologyError(
            f"design {row} {np.asarray(designs)[row]}: gain rule '{rule.kind}' gives the factor "
            f"{eta[row, leg, joint]:g} for the {JOINTS[joint]} joint of leg {LEGS[leg]}; "
            "it must be positive: change the coefficients or narrow the design space"
        )
    return eta


def swung_inertia(body: Skeleton, poses: LegPoses) -> Array:
    """Inertia (n, 4, 3) [kg m^2] about each joint's axis of the links beyond it, the joints beyond it held."""
    orientation = poses.rotation[:, :, [0, 1, 2, 2]]
    inertia = orientation @ body.link_inertia @ np.swapaxes(orientation, -1, -2)
    total = np.zeros((body.n, 4, 3))
    for k in range(3):
        axis = poses.axis[:, :, k]
        for link in range(k, 4):
            turning = np.einsum("nli,nlij,nlj->nl", axis, inertia[:, :, link], axis)
            arm = np.cross(axis, poses.com[:, :, link] - poses.joint[:, :, k])
            total[:, :, k] += turning + body.link_mass[:, :, link] * (arm**2).sum(axis=-1)
    return total


def _polynomial(coefficients: Array, x: Array) -> Array:
    """Values (n, 4, 3), or of a shape that broadcasts to it, of the polynomials at x (n, d)."""
    n, d = x.shape
    powers = [np.ones(n), *x.T, *(x[:, i] * x[:, j] for i, j in combinations_with_replacement(range(d), 2))]
    monomials = np.stack(powers, axis=-1)
    terms = monomials.shape[1]
    shapes = {terms: (1, 1), 3 * terms: (1, 3), 12 * terms: (4, 3)}
    shape = shapes.get(len(coefficients))
    if shape is None:
        raise MorphologyError(
            f"gain rule 'polynomial': {d} design parameters need {terms} coefficients for all joints, {3 * terms} "
            f"for hip, thigh and knee, or {12 * terms} for the 12 joints; got {len(coefficients)}"
        )
    return np.einsum("lkt,nt->nlk", coefficients.reshape(*shape, terms), monomials)


def _leg_length(body: Skeleton) -> Array:
    return body.segment_length.sum(axis=-1).mean(axis=1)


def _column(values: Array) -> Array:
    return values[:, None, None]
