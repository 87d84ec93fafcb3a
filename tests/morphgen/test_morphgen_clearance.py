"""Height of primitives above the floor against MuJoCo's distance to a plane, and what it does to stances."""

# pyright: reportAttributeAccessIssue=false
from dataclasses import replace

import mujoco
import numpy as np
from morphgen.scaling.articulate import Collisions
from morphgen.stance.clearance import lowest_points
from morphgen.stance.kinematics import forward_kinematics
from morphgen.stance.stance import solve_stance
from numpy.testing import assert_allclose
from random_skeletons import build_spec, random_skeleton, straight_skeleton

KINDS = {"box": 6, "cylinder": 5, "capsule": 3, "sphere": 2}


def random_rotation(rng):
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def one_box(part, position, sides, leg=0):
    """A box that stands upright at zero angles, on the front left leg."""
    return Collisions(
        (leg,), (part,), ("box",), np.array([[position]], float), np.eye(3)[None, None], np.array([[sides]], float)
    )


def test_lowest_points_agree_with_mujocos_distance_to_a_plane():
    rng = np.random.default_rng(0)
    body = random_skeleton(rng)
    angles = rng.uniform(-1, 1, (1, 4, 3))
    parts = [(-1, -1), *((leg, part) for leg in range(4) for part in range(4))]
    rows = [(*where, kind) for where in parts for kind in KINDS]
    sizes = rng.uniform(0.02, 0.2, (len(rows), 3))
    position = rng.uniform(-0.1, 0.1, (len(rows), 3))
    rotation = np.array([random_rotation(rng) for _ in rows])
    upright = next(i for i, row in enumerate(rows) if row == (-1, -1, "cylinder"))
    rotation[upright] = np.eye(3)
    shapes = Collisions(*(tuple(row[k] for row in rows) for k in range(3)), position[None], rotation[None], sizes[None])
    low = lowest_points(forward_kinematics(body, angles), shapes)[0]

    spec = build_spec(body)
    for i, (leg, part, kind) in enumerate(rows):
        name = "base" if leg < 0 else f"{('FL', 'FR', 'RL', 'RR')[leg]}_{('hip', 'thigh', 'shank', 'foot')[part]}"
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, rotation[i].ravel())
        radius, length = sizes[i, 0], sizes[i, 1] / 2
        size = sizes[i] / 2 if kind == "box" else [radius, length, 0]
        spec.body(name).add_geom(name=f"shape{i}", type=KINDS[kind], size=size, pos=position[i], quat=quat)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = [0, 0, 5, 1, 0, 0, 0, *angles.ravel()]
    mujoco.mj_forward(model, data)
    floor = model.geom("floor").id
    for i in range(len(rows)):
        segment = np.zeros(6)
        distance = mujoco.mj_geomDistance(model, data, floor, model.geom(f"shape{i}").id, 100, segment)
        assert_allclose(5 + low[i, 2], distance, atol=1e-9)
        if i != upright:
            assert_allclose(low[i] + (0, 0, 5), [*segment[3:5], distance], atol=1e-6)


def test_a_thick_thigh_is_kept_off_the_floor():
    """The knee of a 0.3 m thigh over a 0.11 m shank is low; a box that is 0.3 m deep around the thigh needs room."""
    body = straight_skeleton(0.3, 0.11)
    thin = solve_stance(body)
    knee = thin.base_height[0] - 0.3 * np.cos(thin.joints[0, 0, 1])
    box = one_box(1, (0, 0, -0.15), (0.3, 0.1, 0.3))
    thick = solve_stance(body, collisions=box)
    assert thin.feasible.all()
    assert thick.feasible.all()
    corner = -0.3 * np.cos(thick.joints[0, 0, 1]) - 0.15 * np.sin(abs(thick.joints[0, 0, 1]))
    assert knee - 0.15 * np.sin(thin.joints[0, 0, 1]) < 0.005
    assert thick.base_height[0] + corner >= 0.005
    assert not solve_stance(body, collisions=one_box(-1, (0, 0, -0.5), (0.1, 0.1, 0.1), leg=-1)).feasible.any()


def test_the_end_of_the_shank_is_foot():
    """A shank box that ends at the foot's centre and one that reaches 1 cm below the ball."""
    body = straight_skeleton()
    for below in (0.0, 0.03):
        stance = solve_stance(body, collisions=one_box(2, (0, 0, -(0.25 + below) / 2), (0.02, 0.02, 0.25 + below)))
        default = solve_stance(body)
        assert np.array_equal(stance.joints, default.joints)
        assert stance.feasible.all()
    long = one_box(2, (0, 0, -0.2), (0.02, 0.02, 0.4))
    assert not solve_stance(body, collisions=long).feasible.any()
    on_foot = replace(long, part=(3,), position=np.array([[[0, 0, 0.0]]]))
    assert solve_stance(body, collisions=on_foot).feasible.all()
