"""Robots as they are built, and what keeps a bundle off them."""

from dataclasses import replace

import numpy as np
import pytest
from deploy.bundles.loading import load_bundle
from deploy.errors import RobotError
from deploy.robots.specs import GO2, LITE3, ROBOTS, mismatches, spec_of


@pytest.fixture(scope="module")
def bundle(bundle_dir):
    """A bundle that fits a Go2 as it is sold."""
    loaded = load_bundle(bundle_dir)
    limits = {name: (low, high) for name, low, high in zip(GO2.joint_names, GO2.lower, GO2.upper, strict=True)}
    joints = tuple(
        replace(joint, torque_limit=23.7, lower=limits[joint.name][0], upper=limits[joint.name][1])
        for joint in loaded.joints
    )
    robot = replace(loaded.robot, name="go2", design={"front_thigh": 1.0, "hind_shank": 1.0})
    return replace(loaded, robot=robot, joints=joints)


def test_go2_has_the_vendors_order_and_mirror_symmetric_limits():
    assert GO2.joint_names[:4] == ("FR_hip_joint", "FR_thigh_joint", "FR_calf_joint", "FL_hip_joint")
    assert [name[:2] for name in GO2.joint_names[::3]] == ["FR", "FL", "RR", "RL"]
    assert GO2.feet == ("FR_foot", "FL_foot", "RR_foot", "RL_foot")
    # mechanical power of a motor through different gears is the same: 23.7 * 30.1 and 45.43 * 15.70 W
    np.testing.assert_allclose(np.multiply(GO2.torque_limit, GO2.velocity_limit), 713.3, atol=0.1)
    order = [GO2.joint_names.index(name) for name in ("FL_thigh_joint", "FR_thigh_joint", "RL_thigh_joint")]
    assert [GO2.lower[i] for i in order] == [-1.5708, -1.5708, -0.5236]


def test_lite3_has_front_and_hind_legs_alike():
    assert LITE3.joint_names[:3] == ("FL_HipX", "FL_HipY", "FL_Knee")
    assert LITE3.lower == (-0.523, -2.67, 0.524) * 4
    assert LITE3.torque_limit == (24.0, 24.0, 36.0) * 4


@pytest.mark.parametrize("spec", ROBOTS.values(), ids=lambda spec: spec.name)
def test_tables_are_whole(spec):
    for values in (spec.lower, spec.upper, spec.torque_limit, spec.velocity_limit):
        assert len(values) == len(spec.joint_names) == len(set(spec.joint_names)) == 12
    assert np.all(np.less(spec.lower, spec.upper))
    assert spec_of(spec.name) is spec


def test_a_fitting_bundle_fits(bundle):
    assert mismatches(bundle, GO2) == []


def test_an_unknown_robot_is_named_with_the_known_ones():
    with pytest.raises(RobotError, match=r"'spot' is not known; choose one of go2, lite3"):
        spec_of("spot")


def test_another_robot(bundle):
    assert mismatches(bundle, LITE3) == ["body: the bundle was made for a go2, this is a lite3; take one made for it"]


def test_permuted_joints_fit(bundle):
    assert mismatches(replace(bundle, joints=bundle.joints[::-1]), GO2) == []


def test_other_joints(bundle):
    odd = replace(bundle.joints[0], name="FL_ankle_joint")
    found = mismatches(replace(bundle, joints=(odd, *bundle.joints[1:])), GO2)
    assert found == [
        "joints: the bundle moves ['FL_ankle_joint'], which go2 does not have",
        "joints: go2 has ['FL_hip_joint'], which the bundle does not move",
    ]


def test_another_body_is_refused_unless_it_was_built(bundle):
    longer = replace(bundle, robot=replace(bundle.robot, design={"front_thigh": 1.12, "hind_shank": 1.0}))
    (found,) = mismatches(longer, GO2)
    assert found.startswith("body: the bundle was trained with front_thigh 1.12, this go2 has 1;")
    assert mismatches(longer, GO2, {"front_thigh": 1.12}) == []
    assert "hind_shank 1, this go2 has 0.9" in mismatches(bundle, GO2, {"hind_shank": 0.9})[0]
    assert "no design parameter 'tail'" in mismatches(bundle, GO2, {"tail": 1.0})[0]
    assert mismatches(replace(bundle, robot=replace(bundle.robot, design={"a": float("nan")})), GO2)


def test_wider_limits_and_stronger_motors_are_refused(bundle):
    wide = replace(bundle.joints[1], upper=3.6)
    strong = replace(bundle.joints[2], torque_limit=60.0)
    found = mismatches(replace(bundle, joints=(bundle.joints[0], wide, strong, *bundle.joints[3:])), GO2)
    assert found == [
        "joint FL_thigh_joint: trained within [-1.571, 3.6] rad, go2 moves within [-1.571, 3.491] rad",
        "joint FL_calf_joint: trained with up to 60 N m, go2 gives 45.43 N m",
    ]


def test_a_policy_that_is_too_fast(bundle):
    found = mismatches(replace(bundle, policy_hz=1000.0), GO2)
    assert found == [
        "rate: the policy runs at 1000 Hz, go2 reports at 500 Hz",
        "rate: the policy runs at 1000 Hz, go2 takes 500 Hz",
    ]


def test_what_a_robot_does_not_know_is_not_compared(bundle, fake_robot):
    assert mismatches(bundle, fake_robot().spec) == []
