"""Observation and network: frames, order, recurrent state, no torch."""

import subprocess
import sys
from dataclasses import replace

import mujoco
import numpy as np
import onnx
import pytest
from deploy import BundleError, OnnxRuntime, RobotError, check_golden, load_bundle
from deploy.interfaces import RobotState
from deploy.policy.observation import ObservationBuilder, projected_gravity, rotate_inverse
from deploy.policy.tick import Policy
from hypothesis import given, settings
from hypothesis import strategies as st

numbers = st.floats(-1, 1)
quaternions = st.tuples(numbers, numbers, numbers, numbers).filter(lambda q: np.linalg.norm(q) > 0.1)


@settings(deadline=None, max_examples=50)
@given(quaternions, st.tuples(numbers, numbers, numbers))
def test_rotation_agrees_with_mujoco(quat, vector):
    quat = np.array(quat) / np.linalg.norm(quat)
    inverse, expected = np.zeros(4), np.zeros(3)
    mujoco.mju_negQuat(inverse, quat)
    mujoco.mju_rotVecQuat(expected, np.array(vector, dtype=float), inverse)
    np.testing.assert_allclose(rotate_inverse(quat, np.array(vector)), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("axis", "angle", "down"),
    [
        ((0, 0, 1), 1.0, (0, 0, -1)),  # heading does not show
        ((1, 0, 0), np.pi / 2, (0, -1, 0)),  # rolled onto its right side: down is base -y
        ((0, 1, 0), np.pi / 2, (1, 0, 0)),  # nose down: down is forward
        ((1, 0, 0), np.pi, (0, 0, 1)),  # on its back
    ],
)
def test_projected_gravity(axis, angle, down):
    quat = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * np.array(axis)])
    np.testing.assert_allclose(projected_gravity(quat), down, atol=1e-12)


def state_of(golden, tick):
    row = {name: golden[name][tick] for name in ("q", "dq", "quat_wxyz", "gyro")}
    return RobotState(stamp_ns=0, seq=tick, tau=np.zeros(12), acc=np.zeros(3), **row)


def test_terms_follow_the_order_and_scale_of_the_manifest(folder, golden):
    terms = folder.manifest["observation"]["terms"]
    terms.reverse()
    terms[-1]["scale"] = [1.0, 2.0, 3.0]
    bundle = load_bundle(folder.seal())
    obs = ObservationBuilder(bundle).build(state_of(golden, 0), golden["command"][0], np.arange(12.0))
    np.testing.assert_array_equal(obs[:12], np.arange(12, dtype=np.float32))
    np.testing.assert_allclose(obs[12:24], golden["dq"][0] * 0.05, rtol=1e-6)
    np.testing.assert_allclose(obs[-3:], golden["gyro"][0] * [1, 2, 3], rtol=1e-6)


def test_attitude_and_speed_are_terms_too(folder, golden):
    """Against MuJoCo: yaw, then pitch, then roll."""
    folder.manifest["observation"]["terms"][:2] = [
        {"name": name, "source": name, "frame": "base", "unit": "SI", "size": size, "scale": 2.0}
        for name, size in (("roll_pitch", 2), ("commanded_speed", 1))
    ]
    folder.manifest["policy"]["inputs"]["obs"] = [1, 42]
    bundle, quat = load_bundle(folder.seal()), np.zeros(4)
    mujoco.mju_euler2Quat(quat, [0.9, -0.3, 0.2], "zyx")
    state = replace(state_of(golden, 0), quat_wxyz=quat)
    obs = ObservationBuilder(bundle).build(state, np.array([0.7, 0.1, 0.3]), np.zeros(12))
    np.testing.assert_allclose(obs[:3], [2 * 0.2, 2 * -0.3, 2 * 0.7], atol=1e-6)


def test_a_policy_that_feels_its_feet_takes_no_reading_without_them(folder, golden):
    term = folder.manifest["observation"]["terms"][0]
    term |= {"name": "feet", "source": "foot_contact", "size": 4, "scale": 2.0}
    folder.manifest["policy"]["inputs"]["obs"] = [1, 46]
    bundle = load_bundle(folder.seal())
    build, state = ObservationBuilder(bundle).build, state_of(golden, 0)
    feet = np.array([True, False, True, False])
    obs = build(replace(state, contact=feet), np.zeros(3), np.zeros(12))
    assert obs[:4].tolist() == [1.0, -1.0, 1.0, -1.0]
    with pytest.raises(RobotError, match="without foot contacts"):
        build(replace(state, contact=None), np.zeros(3), np.zeros(12))
    with pytest.raises(BundleError, match=r"golden\.npz: not a golden trace .*contact"):
        check_golden(bundle, None)


def test_recurrent_state_is_fed_back_and_reset(bundle_dir, golden):
    runtime = OnnxRuntime(load_bundle(bundle_dir))
    rows = golden["obs"].astype(np.float32)
    first = [runtime.step(obs).action for obs in rows[:12]]
    np.testing.assert_allclose(first, golden["action"][:12], atol=1e-5)
    assert np.abs(runtime.step(rows[0]).action - first[0]).max() > 0.05
    runtime.reset()
    np.testing.assert_array_equal(runtime.step(rows[0]).action, first[0])


def test_velocity_estimate(bundle_dir, golden):
    runtime = OnnxRuntime(load_bundle(bundle_dir))
    model = onnx.load(bundle_dir / "policy.onnx")
    v = next(onnx.numpy_helper.to_array(t) for t in model.graph.initializer if t.name == "v")
    obs = golden["obs"][0].astype(np.float32)
    np.testing.assert_allclose(runtime.step(obs).velocity, obs @ v, atol=1e-6)


def test_clip_limits_target_and_memory(folder, golden):
    folder.manifest["action"]["clip"] = 0.1
    bundle = load_bundle(folder.seal())
    policy = Policy(bundle, OnnxRuntime(bundle))
    step = policy.step(state_of(golden, 0), golden["command"][0])
    np.testing.assert_allclose(step.action, golden["action"][0], atol=1e-5)
    assert np.abs(step.action).max() > 0.2
    clipped = np.clip(step.action, -0.1, 0.1)
    np.testing.assert_allclose(step.target, bundle.per_joint("target_offset") + 0.25 * clipped)
    again = policy.step(state_of(golden, 1), golden["command"][1])
    np.testing.assert_array_equal(again.obs[-12:], clipped.astype(np.float32))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("phase_in", "hidden", "inputs are"),
        ("phase_out", "hidden", "outputs are"),
        ("action", "act", "outputs are"),
    ],
)
def test_network_with_other_names(folder, old, new, words):
    model = onnx.load_from_string(folder.files["policy.onnx"])
    for value in [*model.graph.input, *model.graph.output]:
        value.name = new if value.name == old else value.name
    for node in model.graph.node:
        for names in (node.input, node.output):
            names[:] = [new if name == old else name for name in names]
    folder.files["policy.onnx"] = model.SerializeToString()
    with pytest.raises(BundleError, match=words):
        OnnxRuntime(load_bundle(folder.seal()))


def test_network_with_other_shape(folder):
    folder.manifest["policy"]["state"][0]["shape"] = [1, 2]
    with pytest.raises(BundleError, match="phase_in has shape"):
        OnnxRuntime(load_bundle(folder.seal()))


def test_broken_network(folder):
    folder.files["policy.onnx"] = b"not a network"
    with pytest.raises(BundleError, match=r"policy\.onnx: onnxruntime cannot open it"):
        OnnxRuntime(load_bundle(folder.seal()))


def test_runs_where_torch_cannot_be_imported(bundle_dir):
    program = f"""
import sys
sys.modules["torch"] = None  # any `import torch` raises ImportError
import deploy
summary = deploy.run({str(bundle_dir)!r}, (0.3, 0.0, 0.0), duration=0.2)
assert summary.ticks == 10 and summary.completed, summary
assert not [name for name in sys.modules if name.split(".")[0] == "torch" and name != "torch"]
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)
