"""Gain rules against MuJoCo's mass matrix, hand-worked ratios and polynomials evaluated by numpy."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from morphgen.errors import MorphologyError
from morphgen.stance.gains import GainRule, gain_factors, swung_inertia
from morphgen.stance.kinematics import forward_kinematics
from morphgen.stance.stance import solve_stance
from numpy.testing import assert_allclose
from random_skeletons import posed, random_skeleton, straight_skeleton

NOMINAL = np.ones(4)


def factors(rule, bodies, nominal, designs=None, nominal_design=NOMINAL):
    designs = np.ones((bodies.n, 4)) if designs is None else np.asarray(designs)
    return gain_factors(rule, bodies, solve_stance(bodies), nominal, solve_stance(nominal), designs, nominal_design)


def grown(body, length, density=1.0):
    """Geometrically similar bodies: mass goes with the cube of the length, inertia with its fifth power."""
    return replace(
        body,
        joint_origin=body.joint_origin * length,
        link_com=body.link_com * length,
        base_com=body.base_com * length,
        foot_radius=body.foot_radius * length,
        link_mass=body.link_mass * density * length**3,
        base_mass=body.base_mass * density * length**3,
        link_inertia=body.link_inertia * density * length**5,
        base_inertia=body.base_inertia * density * length**5,
    )


def test_swung_inertia_is_the_diagonal_of_mujocos_mass_matrix():
    rng = np.random.default_rng(0)
    body = random_skeleton(rng, 5)
    angles = rng.uniform(-2, 2, (5, 4, 3))
    inertia = swung_inertia(body, forward_kinematics(body, angles))
    for row in range(5):
        model, data = posed(body, angles[row], row=row)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        assert_allclose(inertia[row].ravel(), np.diag(full)[6:], rtol=1e-10)


def test_similar_bodies_have_the_factors_of_their_size():
    """Twice the length at half the density: 4 times the mass, and inertia 16 times."""
    nominal = random_skeleton(np.random.default_rng(1))
    large = grown(nominal, 2.0, 0.5)
    for kind, expected in {"none": 1.0, "mass": 4.0, "stance": 8.0, "inertia": 16.0}.items():
        assert_allclose(factors(GainRule(kind), large, nominal), np.full((1, 4, 3), expected), rtol=1e-9)


@pytest.mark.parametrize("kind", ["none", "mass", "stance", "inertia"])
def test_the_nominal_body_keeps_its_gains(kind):
    nominal = random_skeleton(np.random.default_rng(2))
    assert_allclose(factors(GainRule(kind), nominal, nominal), np.ones((1, 4, 3)), rtol=1e-12)


def test_stance_rule_keeps_the_deflection_of_similar_bodies_under_their_weight():
    """Static torque / (eta kp) at every joint is that of the nominal body."""
    nominal = random_skeleton(np.random.default_rng(3))
    large = grown(nominal, 1.3)
    before, after = solve_stance(nominal), solve_stance(large)
    assert before.feasible.all()
    eta = gain_factors(GainRule("stance"), large, after, nominal, before, np.ones((1, 4)), NOMINAL)
    assert_allclose(after.torque / eta, before.torque, rtol=1e-9)


def test_stance_rule_uses_the_mean_length_of_the_legs():
    """Hind thighs 0.1 m longer: mean leg 0.5 -> 0.55 m; a kilogram more on ten."""
    nominal = straight_skeleton(0.25, 0.25)
    origin = nominal.joint_origin.copy()
    origin[:, 2:, 2, 2] = -0.35
    nominal = replace(nominal, link_inertia=nominal.link_inertia + np.eye(3) * 1e-3)
    body = replace(nominal, joint_origin=origin, base_mass=np.array([11.0]))
    assert_allclose(factors(GainRule("stance"), body, nominal), np.full((1, 4, 3), 1.1 * 1.1))


@settings(deadline=None, derandomize=True, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 3, 12]))
def test_polynomial_is_the_sum_of_its_documented_monomials(seed, blocks):
    """Written out term by term for four parameters x = xi - xi0."""
    rng = np.random.default_rng(seed)
    coefficients = rng.uniform(-0.05, 0.05, (blocks, 15))
    coefficients[:, 0] = 1
    designs, nominal_design = rng.uniform(0.6, 1.4, (7, 4)), rng.uniform(0.9, 1.1, 4)
    body = straight_skeleton(n=7)
    rule = GainRule("polynomial", tuple(coefficients.ravel()))
    eta = factors(rule, body, straight_skeleton(), designs, nominal_design)
    for row, (a, b, c, d) in enumerate(designs - nominal_design):
        terms = [1, a, b, c, d, a * a, a * b, a * c, a * d, b * b, b * c, b * d, c * c, c * d, d * d]
        for leg in range(4):
            for joint in range(3):
                block = {1: 0, 3: joint, 12: 3 * leg + joint}[blocks]
                assert eta[row, leg, joint] == pytest.approx(float(np.dot(coefficients[block], terms)))


def test_bad_rules_and_factors_are_named():
    body = straight_skeleton(n=2)
    with pytest.raises(MorphologyError, match="unknown gain rule 'size'"):
        GainRule("size")  # pyright: ignore[reportArgumentType]
    with pytest.raises(MorphologyError, match="'polynomial' needs coefficients"):
        GainRule("polynomial")
    with pytest.raises(MorphologyError, match="'mass': 'polynomial' needs coefficients, and no other"):
        GainRule("mass", (1.0,))
    with pytest.raises(MorphologyError, match="must be finite"):
        GainRule("polynomial", (1.0, np.nan))
    with pytest.raises(MorphologyError, match=r"4 design parameters need 15 coefficients .* got 2"):
        factors(GainRule("polynomial", (1.0, 1.0)), body, straight_skeleton())
    falling = GainRule("polynomial", (1.0, -4.0, *[0.0] * 13))
    designs = np.array([[1.0, 1, 1, 1], [1.3, 1, 1, 1]])
    with pytest.raises(MorphologyError, match=r"design 1 .* gives the factor -0\.2 for the hip joint of leg FL"):
        factors(falling, body, straight_skeleton(), designs)
