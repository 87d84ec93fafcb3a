"""The doctor refuses in words; a trace recorded from a run is a golden trace like any other."""

import json
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from deploy import BundleError, LogError, OnnxRuntime, RobotError, check_golden, load_bundle, run
from deploy.bundles.recording import record_golden
from deploy.cli import main
from deploy.control.controller import ControllerConfig
from deploy.doctor import examine
from deploy.robots.disturbances import Disturbances
from deploy.robots.mujoco_robot import MujocoRobot

QUICK = ControllerConfig(passive_s=0.04, stand_up_s=0.2, hold_s=0.1, ramp_in_s=0.08)


def test_a_sound_bundle(bundle_dir):
    found = examine(bundle_dir)
    assert found.problems == ()
    assert found.golden["onnx"].ticks == 24
    assert "robot: none named (--robot)" in found.skipped


def test_a_sound_bundle_that_sees(seeing_dir, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit) as exit_:
        main(["doctor", str(seeing_dir)])
    assert exit_.value.code == 0
    assert "6 x 8 px at 10 Hz, used 100 ms after it was taken" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b'name="FL_hip_joint"', b'name="LF_hip_joint"', "no joint FL_hip_joint in it"),
        (b'lower="-0.9"', b'lower="-0.8"', "joint FL_hip_joint: lower is -0.8 rad, the manifest says -0.9"),
        (b'effort="30.0"', b'effort="35"', "effort is 35 N m, the manifest says 30"),
        (b"</robot>", b"", "not XML"),
    ],
)
def test_a_urdf_of_another_body(folder, old, new, words):
    assert old in folder.files["robot.urdf"]
    folder.files["robot.urdf"] = folder.files["robot.urdf"].replace(old, new)
    found = examine(folder.seal())
    assert words in found.problems[0]


def test_a_scene_of_another_body(folder):
    folder.files["scene.xml"] = folder.files["scene.xml"].replace(b'mass="12"', b'mass="13"')
    [problem] = examine(folder.seal()).problems
    assert "total mass is 15, the manifest says 14" in problem


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("target_offset", 0.9 + 0.5, "gains: FR_thigh_joint needs 48.0 N m to hold the stance, its limit is 30.0"),
        ("kd", 0, "gains: FR_thigh_joint has no damping"),
    ],
)
def test_gains_that_cannot_hold(folder, golden, pack, field, value, words):
    joint = folder.manifest["joints"][4]
    if field == "target_offset":
        golden["target"][:, 4] += value - joint[field]
        folder.files["golden.npz"] = pack(golden)
    joint[field] = value
    assert any(words in problem for problem in examine(folder.seal()).problems)


def test_a_robot_with_other_joints_and_limits_is_refused_in_words(bundle_dir, capsys):
    """The box moves FL_hip_joint and so on as a Go2 does, but further and, in the calf, less."""
    with pytest.raises(SystemExit) as exit_:
        main(["doctor", str(bundle_dir), "--robot", "go2"])
    assert exit_.value.code == 1
    said = capsys.readouterr().err
    assert "refused: joint FL_hip_joint: trained with up to 30 N m, go2 gives 23.7 N m" in said
    assert "refused: body: the bundle was trained with calf 1.1, this go2 has 1" in said
    with pytest.raises(SystemExit):
        main(["doctor", str(bundle_dir), "--robot", "lite3"])
    assert "which lite3 does not have" in capsys.readouterr().err


def test_the_body_that_was_built_is_taken_into_account(bundle_dir):
    stock = examine(bundle_dir, "go2").problems
    built = examine(bundle_dir, "go2", {"calf": 1.1}).problems
    assert [problem for problem in stock if problem not in built] == [stock[0]]
    assert stock[0].startswith("body: ")


def test_an_unknown_robot(bundle_dir):
    with pytest.raises(RobotError, match="'spot' is not known; choose one of"):
        examine(bundle_dir, "spot")


def test_run_refuses_a_robot_of_metal_that_does_not_fit(bundle_dir, fake_robot):
    """Before it is started."""
    from deploy.robots.specs import spec_of

    robot = fake_robot()
    robot.spec = replace(spec_of("go2"))
    with pytest.raises(RobotError, match="must not run on go2: body"):
        run(bundle_dir, (0.3, 0, 0), 1.0, robot=robot)
    assert (robot.sent, robot.damped, robot.reads) == ([], 0, 0)


@pytest.fixture(scope="module")
def logs(bundle_dir, seeing_dir, tmp_path_factory):
    """A run of each policy, with noise."""
    made = {}
    for name, folder in (("blind", bundle_dir), ("seeing", seeing_dir)):
        path = tmp_path_factory.mktemp("log") / f"{name}.mcap"
        robot = MujocoRobot(load_bundle(folder), disturbances=Disturbances(joint_noise=0.01, depth_delay_s=0.04))
        summary = run(folder, (0.3, 0.0, 0.1), 1.0, path, robot, config=QUICK)
        assert summary.completed, summary.reason
        made[name] = path
    return made


@pytest.mark.parametrize("which", ["blind", "seeing"])
def test_golden_trace_of_a_run(request, logs, which, tmp_path, capsys):
    source = request.getfixturevalue("bundle_dir" if which == "blind" else "seeing_dir")
    out = tmp_path / "measured"
    main(["record-golden", str(logs[which]), "--bundle", str(source), "-o", str(out)])
    assert str(out) in capsys.readouterr().out
    bundle = load_bundle(out)
    result = check_golden(bundle, OnnxRuntime(bundle))
    assert result.ticks == bundle.golden.ticks == 54
    with np.load(out / "golden.npz") as trace:
        assert np.flatnonzero(trace["reset"]).tolist() == ([0, 27] if which == "blind" else [0, 25])
        assert trace["contact"].shape == (54, 4)
        if which == "seeing":
            assert np.flatnonzero(trace["depth_due"]).tolist() == list(range(0, 54, 5))
    before, after = (json.loads((folder / "manifest.json").read_text()) for folder in (source, out))
    changed = {key for key in before if before[key] != after[key]}
    assert changed == {"files", "golden"}


def test_a_golden_trace_of_a_run_is_not_reproduced_by_another_bundle(logs, bundle_dir, tmp_path):
    bundle = load_bundle(record_golden(logs["blind"], load_bundle(bundle_dir), tmp_path / "measured"))
    joints = tuple(replace(joint, stance=joint.stance + 1e-4) for joint in bundle.joints)
    other = replace(bundle, joints=joints)
    with pytest.raises(BundleError, match="tick 0: obs differs"):
        check_golden(other, OnnxRuntime(other))


def test_recording_does_not_overwrite(logs, bundle_dir, tmp_path):
    with pytest.raises(BundleError, match="exists already"):
        record_golden(logs["blind"], load_bundle(bundle_dir), tmp_path)


def test_recording_needs_a_run(bundle_dir, fake_robot, tmp_path):
    robot = fake_robot()
    robot.fault = lambda state: replace(state, q=state.q + 0.8)
    path = tmp_path / "short.mcap"
    run(bundle_dir, (0.3, 0.0, 0.0), 1.0, path, robot, config=QUICK)
    with pytest.raises(LogError, match="the policy ran for 0 ticks"):
        record_golden(path, load_bundle(bundle_dir), tmp_path / "measured")
    assert not (tmp_path / "measured").exists()


def test_replay_on_the_command_line(logs, bundle_dir, folder, capsys):
    main(["replay", str(logs["blind"]), "--bundle", str(bundle_dir)])
    assert "54 of 54 actions are reproduced in every bit" in capsys.readouterr().out
    folder.manifest["joints"][2]["stance"] += 0.01
    folder.files["golden.npz"] = b""  # replay compares with the log
    with pytest.raises(SystemExit) as exit_:
        main(["replay", str(logs["blind"]), "--bundle", str(folder.seal())])
    assert exit_.value.code == 2
    out = capsys.readouterr().out
    assert "first difference: tick" in out
    assert "observation joint_position_error[2]" in out


@pytest.mark.parametrize("flip", range(12))
def test_a_flipped_byte_anywhere_in_a_bundle_is_found(folder, flip):
    """In the manifest, that its content still is a valid one cannot be excluded; no other file may change."""
    root = folder.seal()
    rng = np.random.default_rng(flip)
    names = sorted(folder.files)
    name = names[flip % len(names)]
    data = bytearray((root / name).read_bytes())
    data[rng.integers(len(data))] ^= 1 << rng.integers(8)
    (root / name).write_bytes(data)
    with pytest.raises(BundleError, match=f"{name}: content has changed"):
        load_bundle(root)


def test_a_flipped_byte_of_the_manifest_is_refused(folder):
    root = folder.seal()
    data = (root / "manifest.json").read_bytes()
    rng = np.random.default_rng(0)
    for place in rng.choice(len(data), 60, replace=False):
        flipped = bytearray(data)
        flipped[place] ^= 1
        (root / "manifest.json").write_bytes(flipped)
        with pytest.raises(BundleError, match=r"manifest\.json"):
            load_bundle(root)


def test_another_gain_alone_is_refused(folder):
    """What the schema cannot tell from a right manifest."""
    root = folder.seal()
    folder.manifest["joints"][3]["kp"] += 1
    (root / "manifest.json").write_text(json.dumps(folder.manifest))
    with pytest.raises(BundleError, match=r"manifest\.json: content has changed since the export"):
        load_bundle(root)
    (root / "manifest.sha256").unlink()
    with pytest.raises(BundleError, match=r"manifest\.sha256: file is missing"):
        load_bundle(root)


@pytest.mark.skipif(shutil.which("sha256sum") is None, reason="coreutils are missing")
def test_coreutils_check_the_manifest(bundle_dir):
    done = subprocess.run(["sha256sum", "--check", "manifest.sha256"], cwd=bundle_dir, capture_output=True, text=True)
    assert done.stdout == "manifest.json: OK\n"
