"""Stances of any quadruped: triangles by hand, brute force, MuJoCo's kinematics and its simulation."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from morphgen.errors import MorphologyError
from morphgen.skeleton import Skeleton
from morphgen.stance.inverse import leg_angles, sagittal_legs
from morphgen.stance.stance import solve_stance
from numpy.testing import assert_allclose
from random_skeletons import LEGS, build_spec, posed, random_skeleton, straight_skeleton

ALIKE = settings(deadline=None, derandomize=True, max_examples=60)


def limited(body: Skeleton, joint: int, lower: float, upper: float, legs: slice = slice(None)) -> Skeleton:
    low, high = body.lower.copy(), body.upper.copy()
    low[legs, joint], high[legs, joint] = lower, upper
    return replace(body, lower=low, upper=high)


def mirrored(body: Skeleton) -> Skeleton:
    """The body with its right legs made mirror images of its left ones."""
    flip = np.array([1, -1, 1])
    changed = {}
    for name, image in (
        ("joint_origin", lambda v: v * flip),
        ("link_com", lambda v: v * flip),
        ("link_inertia", lambda v: v * np.outer(flip, flip)),
        ("link_mass", lambda v: v),
    ):
        values = getattr(body, name).copy()
        values[:, [1, 3]] = image(values[:, [0, 2]])
        changed[name] = values
    return replace(body, **changed, base_com=body.base_com * (1, 0.1, 1))


# ---------------------------------------------------------------- geometry


def test_a_shank_that_points_forward_at_zero_bends_by_that_much_less():
    """Equal sides: each is acos(0.75) off the vertical; the shank starts a quarter turn in front of the thigh."""
    body = straight_skeleton(0.3, 0.3)
    origin = body.joint_origin.copy()
    origin[:, :, 3] = (0.3, 0, 0)
    stance = solve_stance(replace(body, joint_origin=origin))
    assert_allclose(stance.joints[0], np.tile([0, np.arccos(0.75), np.pi / 2 - 2 * np.arccos(0.75)], (4, 1)))
    assert_allclose(stance.base_height, 0.75 * 0.6 + 0.02)
    assert_allclose(stance.foot_offset, 0, atol=1e-12)
    assert stance.feasible.all()


def test_straight_legs_give_the_law_of_cosines_to_the_last_bit():
    """Trained policies depend on the stances of straight legs, so their rounding stays."""
    rng = np.random.default_rng(2)
    thigh, shank = rng.uniform(0.25, 0.3, (2, 50, 4))
    body = straight_skeleton(n=50)
    origin = body.joint_origin.copy()
    origin[:, :, 2, 2], origin[:, :, 3, 2] = -thigh, -shank
    stance = solve_stance(replace(body, joint_origin=origin))
    height = 0.75 * (thigh + shank).min(axis=1) - np.zeros(50) + 0.02
    reach = height[:, None] + 0.0 - 0.02
    cos_hip = (thigh**2 + reach**2 - shank**2) / (2 * thigh * reach)
    cos_knee = (reach**2 - thigh**2 - shank**2) / (2 * thigh * shank)
    assert np.array_equal(stance.joints[..., 1], np.arccos(cos_hip))
    assert np.array_equal(stance.joints[..., 2], -np.arccos(cos_knee))
    assert stance.feasible.all()


def test_random_quadrupeds_stand_level_on_all_feet_in_mujoco():
    """Oblique and offset segments, axes of either sign, feet of different radii."""
    body = random_skeleton(np.random.default_rng(3), 30)
    stance = solve_stance(body)
    assert stance.feasible.sum() > 20
    for row in np.flatnonzero(stance.feasible):
        model, data = posed(body, stance.joints[row], stance.base_height[row], row)
        load = np.array([data.body(f"{leg}_foot").xpos for leg in LEGS])
        assert_allclose(load[:, 2], body.foot_radius[row], atol=1e-9)
        thigh = np.array([data.body(f"{leg}_thigh").xpos for leg in LEGS])
        assert_allclose(load[:, 0] - thigh[:, 0], stance.foot_offset[row], atol=1e-9)
        assert stance.hip_height[row] == pytest.approx(thigh[:, 2].mean())
        for i, leg in enumerate(LEGS):
            assert data.body(f"{leg}_shank").xpos[2] >= max(0.03, 30 / 22 * body.foot_radius[row, i]) - 1e-12


@ALIKE
@given(st.integers(0, 2**32 - 1), st.floats(-0.9, 0.9), st.floats(0.2, 0.95), st.sampled_from([1, -1]))
def test_inverse_kinematics_puts_the_foot_and_the_knee_where_asked(seed, aim, stretch, side):
    """Any direction within the reach; checked with MuJoCo."""
    body = random_skeleton(np.random.default_rng(seed))
    legs = sagittal_legs(body, [side] * 4)
    near, far = np.abs(np.diff(legs.length[0], axis=-1))[:, 0], legs.length[0].sum(axis=-1)
    distance = near + stretch * (far - near)
    reach, offset = distance * np.cos(aim), distance * np.sin(aim)
    solution = leg_angles(legs, reach[None], offset[None])
    assert solution.reachable.all()
    angles = np.concatenate([np.zeros((4, 1)), solution.joint[0]], axis=1)
    _, data = posed(body, angles)
    for i, leg in enumerate(LEGS):
        thigh, knee, foot = (data.body(f"{leg}_{part}").xpos for part in ("thigh", "shank", "foot"))
        assert_allclose((foot - thigh)[[0, 2]], (offset[i], -reach[i]), atol=1e-9)
        line, to_knee = (foot - thigh)[[0, 2]], (knee - thigh)[[0, 2]]
        # the knee lies behind the line from thigh joint down to foot if it is to its right, seen from +y
        assert np.sign(line[0] * to_knee[1] - line[1] * to_knee[0]) in (-side, 0)


# ---------------------------------------------------------------- side of the knee


@pytest.mark.parametrize("axis", [1, -1])
@pytest.mark.parametrize(("lower", "upper", "side"), [(-2.7, -0.8, 1), (0.8, 2.7, -1), (-1.5, 2.7, -1), (-2.7, 1.5, 1)])
def test_limits_tell_to_which_side_a_knee_bends(axis, lower, upper, side):
    body = straight_skeleton()
    if axis < 0:
        body = replace(body, axis=body.axis * np.array([1, 1, -1])[:, None])
        lower, upper = -upper, -lower
    stance = solve_stance(limited(body, 2, lower, upper))
    assert stance.feasible.all()
    assert_allclose(stance.joints[0, :, 2] * axis, -side * 2 * np.arccos(0.75))
    assert_allclose(stance.joints[0, :, 1], side * np.arccos(0.75))


@pytest.mark.parametrize("bounds", [(-np.inf, np.inf), (-9.42, 9.42), (-3.0, 3.0), (-np.inf, 2.5)])
def test_knees_bend_backwards_where_limits_do_not_tell(bounds):
    stance = solve_stance(limited(straight_skeleton(), 2, *bounds))
    assert (stance.joints[..., 2] < 0).all()


def test_of_two_knees_within_limits_the_one_nearer_to_their_middle_is_taken():
    rng = np.random.default_rng(4)
    compared = 0
    for _ in range(40):
        body = limited(random_skeleton(rng), 2, *(rng.uniform(-0.5, 0.5) + np.array([-2.9, 2.9])))
        reach, offset = np.full((1, 4), 0.35), rng.uniform(-0.1, 0.1, (1, 4))
        taken, back, front = (
            leg_angles(sagittal_legs(body, knees), reach, offset).joint[0, :, 1] for knees in (None, [1] * 4, [-1] * 4)
        )
        lower, upper = body.lower[:, 2], body.upper[:, 2]
        both = np.all([(lower < q) & (q < upper) for q in (back, front)], axis=0)
        nearer = np.where(np.abs(2 * back - lower - upper) < np.abs(2 * front - lower - upper), back, front)
        assert_allclose(taken[both], nearer[both])
        compared += both.sum()
    assert compared > 80


def test_the_thigh_limits_decide_where_only_one_knee_keeps_them():
    body = limited(straight_skeleton(), 1, -2.0, 0.1, slice(0, 2))
    stance = solve_stance(body)
    assert stance.feasible.all()
    assert (stance.joints[0, :2, 2] > 0).all()
    assert (stance.joints[0, 2:, 2] < 0).all()


def test_knees_given_by_hand_win():
    stance = solve_stance(limited(straight_skeleton(), 2, -2.7, 2.6), knees=[1, 1, -1, None])
    assert_allclose(np.sign(stance.joints[0, :, 2]), [-1, -1, 1, -1])
    assert not solve_stance(limited(straight_skeleton(), 2, -2.7, -0.8), knees=[-1] * 4).feasible.any()
    with pytest.raises(MorphologyError, match="knees: needs 1"):
        solve_stance(straight_skeleton(), knees=[1, 1, 2, 1])


def test_angles_a_whole_turn_away_keep_limits_that_lie_there():
    turn = 2 * np.pi
    body = limited(limited(straight_skeleton(), 2, turn - 2.5, turn - 0.5), 1, -turn, -turn + 1.5)
    stance = solve_stance(body)
    assert stance.feasible.all()
    assert_allclose(stance.joints[0, 0], [0, np.arccos(0.75) - turn, turn - 2 * np.arccos(0.75)])


# ---------------------------------------------------------------- search and feasibility


def go2_like(scales) -> Skeleton:
    """Straight legs of Go2's lengths and limits times scales of front thigh, front shank, hind thigh, hind shank."""
    body = limited(limited(straight_skeleton(), 1, -1.57, 3.49), 2, -2.72, -0.84)
    origin = body.joint_origin.copy()
    origin[0, :, 2:, 2] = -0.213 * np.asarray(scales).reshape(2, 2)[[0, 0, 1, 1]]
    return replace(body, joint_origin=origin, foot_radius=np.full((1, 4), 0.022), effort=np.full((4, 3), 40.0))


def leg_is_sound(thigh: float, shank: float, height: float, offset: float) -> bool:
    """Whether a straight leg of Go2 reaches the point with its knee behind, within limits and 3 cm up: scalars only."""
    distance = np.hypot(height, offset)
    if not abs(thigh - shank) <= distance <= thigh + shank:
        return False
    at_hip = np.arccos((thigh**2 + distance**2 - shank**2) / (2 * thigh * distance)) - np.arctan(offset / height)
    at_knee = np.pi - np.arccos((thigh**2 + shank**2 - distance**2) / (2 * thigh * shank))
    return -1.57 <= at_hip <= 3.49 and 0.84 <= at_knee <= 2.72 and height + 0.022 - thigh * np.cos(at_hip) >= 0.03


@pytest.mark.parametrize("scales", [(1.4, 0.6, 0.6, 0.6), (0.6, 0.6, 1.4, 0.6), (1.35, 0.62, 0.7, 0.6)])
def test_where_the_default_is_not_sound_the_nearest_sound_cell_is_taken(scales):
    """The shares of height and offsets are multiples of 0.05; no nearer one of them passes the scalar checks."""
    body = go2_like(scales)
    lengths = 0.213 * np.asarray(scales).reshape(2, 2)
    total = lengths.sum(axis=1)
    stance = solve_stance(body)
    assert stance.feasible[0]
    height = (stance.hip_height[0] - 0.022) / total.min()
    front, hind = stance.foot_offset[0, [0, 2]] / total
    found = np.array([height - 0.75, front, hind])
    assert_allclose(found * 20, np.round(found * 20), atol=1e-6)
    cells = np.arange(-10, 11) * 0.05
    for h in 0.75 + np.arange(-5, 5) * 0.05:
        fits = [[leg_is_sound(*lengths[p], h * total.min(), c * total[p]) for c in cells] for p in (0, 1)]
        away = [np.abs(cells[fit]).min(initial=np.inf) for fit in np.array(fits)]
        assert np.hypot(np.hypot(*away), h - 0.75) >= np.linalg.norm(found) - 1e-9


def test_hind_feet_follow_a_centre_of_mass_that_lies_behind_them():
    body = replace(straight_skeleton(), base_com=np.array([[-0.22, 0, 0]]))
    stance = solve_stance(body)
    assert stance.feasible.all()
    assert stance.foot_offset[0, 2] < -0.02
    assert_allclose(stance.foot_offset[0, 2], stance.foot_offset[0, 3])
    front, hind = 0.2 + stance.foot_offset[0, 0], -0.2 + stance.foot_offset[0, 2]
    # all four feet carry at least 5 % of the weight: the pair in front at least a tenth
    assert (-0.22 - hind) / (front - hind) >= 0.1


@pytest.mark.parametrize(
    "change",
    [
        lambda body: replace(body, effort=np.full((4, 3), 0.5)),
        lambda body: replace(body, base_com=np.array([[1.0, 0, 0]])),
        lambda body: replace(body, base_com=np.array([[0, 0.16, 0]])),
        lambda body: limited(body, 0, 0.2, 0.5),
        lambda body: limited(body, 2, -3.1, -3.0),
    ],
    ids=["weak", "falls forward", "falls sideways", "spread hips", "folded knees"],
)
def test_bodies_without_a_sound_stance_are_marked_and_keep_their_limits(change):
    body = change(straight_skeleton())
    stance = solve_stance(body)
    assert not stance.feasible.any()
    assert np.all((stance.joints >= body.lower) & (stance.joints <= body.upper))
    assert np.all(np.abs(stance.torque) <= body.effort)
    assert all(np.isfinite(getattr(stance, name)).all() for name in stance.__dataclass_fields__)


def test_one_body_does_not_change_the_stance_of_another():
    """Sound, searched and infeasible bodies in one call and each alone."""
    bodies = [go2_like(s) for s in ((1, 1, 1, 1), (1.4, 0.6, 0.6, 0.6), (1.4, 0.2, 0.3, 0.3))]
    together = replace(bodies[0])
    shared = ("axis", "lower", "upper", "effort", "velocity", "damping", "friction")
    names = [name for name in Skeleton.__dataclass_fields__ if name not in shared]
    together = replace(together, **{name: np.concatenate([getattr(b, name) for b in bodies]) for name in names})
    stance = solve_stance(together)
    assert stance.feasible.tolist() == [True, True, False]
    for row, body in enumerate(bodies):
        alone = solve_stance(body)
        for name in stance.__dataclass_fields__:
            assert np.array_equal(getattr(stance, name)[row], getattr(alone, name)[0])


def test_axes_written_as_3_1415_pass_and_others_are_named():
    body = straight_skeleton()
    axis = body.axis.copy()
    axis[1, 2] = (0, -np.cos(9.3e-5), np.sin(9.3e-5))
    assert solve_stance(replace(body, axis=axis)).feasible.all()
    axis[1, 2] = (0, 0, 1)
    with pytest.raises(MorphologyError, match=r"leg FR: its knee joint turns about \[0. 0. 1.\]"):
        solve_stance(replace(body, axis=axis))
    origin = body.joint_origin.copy()
    origin[0, 3, 2] = (0, 0.2, 0)
    with pytest.raises(MorphologyError, match="leg RR: the thigh has no length"):
        solve_stance(replace(body, joint_origin=origin))


# ---------------------------------------------------------------- simulation


def test_random_quadrupeds_are_held_for_three_seconds_on_their_feet():
    """Angles + torque / kp as targets, kp for each robot's weight: under 5 degrees of pitch, 10 % of sag, only feet."""
    body = mirrored(random_skeleton(np.random.default_rng(6), 24))
    stance = solve_stance(body)
    assert stance.feasible.sum() >= 12
    for row in np.flatnonzero(stance.feasible)[:12]:
        kp = 4 * body.total_mass[row]
        model = build_spec(body, row, kp=kp, kd=kp / 50).compile()
        data = mujoco.MjData(model)
        data.qpos[:] = [0, 0, stance.base_height[row], 1, 0, 0, 0, *stance.joints[row].ravel()]
        data.ctrl[:] = (stance.joints[row] + stance.torque[row] / kp).ravel()
        touched = set()
        for _ in range(1500):
            mujoco.mj_step(model, data)
            touched |= {model.body(model.geom_bodyid[g]).name for pair in data.contact.geom for g in pair}
        up = data.body("base").xmat.reshape(3, 3)[2, 2]
        assert np.degrees(np.arccos(up)) < 5
        assert data.qpos[2] > stance.base_height[row] - 0.1 * stance.hip_height[row]
        assert touched == {"world", *(f"{leg}_foot" for leg in LEGS)}
