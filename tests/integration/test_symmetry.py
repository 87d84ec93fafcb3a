"""Mirror images of morphgen's robots and design spaces: the physics agrees with them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from locorl import LeggedEnv, sample_designs
from locorl.bodies.pairs import mirror_pairs
from morphgen import BodyFactory, DesignSpace, load_robot

sys.path.insert(0, str(Path(__file__).parents[1] / "locorl"))

from locorl_twin import everything, largest_differences, twin

OTHER_SIDE = [2, 3, 0, 1, 6, 7, 4, 5]
"""Parameters of `DesignSpace.per_leg` of the other side: thigh and shank of FL, FR, RL, RR."""


@pytest.mark.parametrize(
    ("factory", "design", "tolerance"),
    [
        # the trunk's products of inertia are not symmetric
        (load_robot("go2"), [0, 1, 2, 3], 0.005),
        # the vendor's hips are no mirror images: centres of mass are up to 7 mm off
        (load_robot("lite3"), [0, 1, 2, 3], 0.05),
        (load_robot("go2", rule="stretch", space=DesignSpace.wide()), list(range(10)), 0.005),
        (load_robot("go2", space=DesignSpace.per_leg(0.9, 1.1)), OTHER_SIDE, 0.005),
    ],
    ids=["go2", "lite3", "wide", "per leg"],
)
def test_the_image_of_a_robot_moves_as_the_image_of_its_motion(
    factory: BodyFactory, design: list[int], tolerance: float
) -> None:
    designs = sample_designs(factory, 8, np.random.default_rng(0))
    env = LeggedEnv(factory, designs, everything(), seed=3, threads=1)
    env.reset()
    assert mirror_pairs(factory).design.tolist() == design
    for name, gap in largest_differences(env, twin(env, designs=designs[:, design]), steps=8).items():
        assert gap < tolerance, name


@pytest.mark.parametrize("robot", ["go2", "lite3"])
def test_joints_are_paired_as_morphgen_pairs_them(robot: str) -> None:
    factory = load_robot(robot)
    pairs = mirror_pairs(factory)
    assert pairs.joint.tolist() == list(factory.layout.mirror_joint)
    assert pairs.joint_sign.tolist() == list(factory.layout.mirror_sign)
    assert pairs.foot.tolist() == [1, 0, 3, 2]


def test_a_space_of_one_side_is_refused() -> None:
    factory = load_robot("go2", space=DesignSpace.of(front_thigh=(0.8, 1.2), rl_shank=(0.8, 1.2)))
    with pytest.raises(ValueError, match="go2: design parameter 'rl_shank' acts on left and right differently"):
        mirror_pairs(factory)
