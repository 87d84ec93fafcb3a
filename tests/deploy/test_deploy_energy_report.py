"""The energy of whole runs: legs, joints, errors, comparison and plot."""

import hashlib
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from deploy import LogError, run
from deploy.bundles.loading import checksum_line
from deploy.cli import main
from deploy.logs.reading import read_log
from deploy.measure.account import account
from deploy.measure.legs import fore_joints
from PIL import Image
from rosbags.highlevel import AnyReader

LEGS = ("FL", "FR", "RL", "RR")


def urdf(order=LEGS):
    """The box robot; hips on a fixed bracket that is turned about z, so that x of the base comes from its y."""
    joint = '<joint name="{}" type="{}"><origin xyz="{}" rpy="{}"/><parent link="{}"/><child link="{}"/></joint>'
    parts = [joint.format("bracket_joint", "fixed", "0.05 0 0", "0 0 1.5707963267948966", "base", "bracket")]
    for leg in order:
        x = 0.2 if leg[0] == "F" else -0.2
        y = 0.1 if leg[1] == "L" else -0.1
        parts += [
            joint.format(f"{leg}_calf_joint", "revolute", "5 0 0", "0 0 0", f"{leg}_thigh", f"{leg}_calf"),
            joint.format(f"{leg}_hip_joint", "revolute", f"{y} {-x} 0", "0 0 0", "bracket", f"{leg}_hip"),
            joint.format(f"{leg}_thigh_joint", "revolute", "-9 0 0", "0 0 0", f"{leg}_hip", f"{leg}_thigh"),
        ]
    return f'<robot name="box">{"".join(parts)}</robot>'


NAMES = tuple(f"{leg}_{part}_joint" for leg in LEGS for part in ("hip", "thigh", "calf"))


@pytest.mark.parametrize("order", [LEGS, LEGS[::-1]])
def test_front_legs_are_those_that_start_in_front(order):
    fore = fore_joints(urdf(order), NAMES)
    assert fore.tolist() == [name[0] == "F" for name in NAMES]


def test_a_description_that_does_not_tell():
    assert fore_joints('<robot name="box"/>', NAMES) is None
    assert fore_joints("not xml", NAMES) is None
    assert fore_joints(urdf(), ("FL_wheel",)) is None


@pytest.fixture(scope="module")
def logs(bundle_dir, tmp_path_factory):
    """Two bodies by their scales, with legs in their descriptions, at different commands, 4 s each."""
    root = tmp_path_factory.mktemp("energy")
    made = []
    for name, scales, speed in (("nominal", [1.0, 1.0], 0.3), ("longer", [1.0, 1.1], 0.2)):
        bundle = shutil.copytree(bundle_dir, root / f"bundle_{name}")
        manifest = json.loads((bundle / "manifest.json").read_text())
        manifest["robot"]["design"]["values"] = scales
        manifest["files"]["robot.urdf"] = hashlib.sha256(urdf().encode()).hexdigest()
        (bundle / "robot.urdf").write_text(urdf())
        text = json.dumps(manifest)
        (bundle / "manifest.json").write_text(text)
        (bundle / "manifest.sha256").write_text(checksum_line(hashlib.sha256(text.encode()).hexdigest()))
        made.append(root / f"{name}.mcap")
        run(bundle, (speed, 0.0, 0.0), duration=4.0, log=made[-1])
    return made


def test_account_recomputed_from_the_messages(logs):
    """Per joint and per leg from /power as rosbags reads it, no code of the package."""
    with AnyReader([logs[0]]) as reader:
        messages = {}
        for connection, time, raw in reader.messages():
            messages.setdefault(connection.topic, {})[time] = reader.deserialize(raw, connection.msgtype)
    full = [t for t, m in messages["/controller"].items() if m.mode == "policy"]
    after = max(full) + 20_000_000
    work = messages["/power"][after].joint_energy_pos_j - messages["/power"][min(full)].joint_energy_pos_j
    body = account(read_log(logs[0]))
    assert body.seconds == pytest.approx(4.0)
    assert body.mass == 14.0
    assert body.state_hz == pytest.approx(200.0)
    np.testing.assert_allclose([body.joints_j[name] for name in NAMES], work, rtol=1e-12)
    assert body.fore_j == pytest.approx(work[:6].sum())
    assert body.hind_j == pytest.approx(work[6:].sum())
    assert body.energy_j == pytest.approx(work.sum())
    assert body.cumulative_j[-1] == pytest.approx(work.sum())
    assert len(body.time) == len(body.power_w) == 200
    assert body.power_w.mean() == pytest.approx(work.sum() / 4.0)
    # two sums of the same work differ by what the bars say, to first order in step with the ticks
    gap = abs(body.summary.energy_j_50hz - body.energy_j)
    assert body.error_50hz_j == pytest.approx(gap * 4 / 3)
    assert body.error_state_j == pytest.approx(gap / 3)


def test_only_the_first_seconds(logs):
    log = read_log(logs[0])
    whole, first = account(log), account(log, seconds=1.0)
    assert first.seconds == 1.0
    assert first.summary.ticks == 50
    np.testing.assert_allclose(first.cumulative_j, whole.cumulative_j[:50])
    assert first.energy_j == pytest.approx(whole.cumulative_j[49])
    for seconds in (4.5, 0.0):
        with pytest.raises(LogError, match="asked for"):
            account(log, seconds=seconds)


def test_hardware_has_samples_at_the_policy_rate_and_no_error_bar(bundle_dir, fake_robot, tmp_path):
    run(bundle_dir, (0.3, 0.0, 0.0), duration=0.5, log=tmp_path / "a.mcap", robot=fake_robot())
    body = account(read_log(tmp_path / "a.mcap"))
    assert (body.error_j, body.error_50hz_j, body.state_hz, body.fore_j) == (None, None, None, None)
    assert body.energy_j == 0.0
    json.dumps(body.to_dict(), allow_nan=False)


def test_a_run_without_control_has_no_energy(bundle_dir, fake_robot, tmp_path):
    robot = fake_robot()
    robot.fault = lambda state: replace(state, quat_wxyz=np.array([0.0, 1.0, 0.0, 0.0]))
    run(bundle_dir, (0.3, 0.0, 0.0), duration=0.5, log=tmp_path / "a.mcap", robot=robot)
    with pytest.raises(LogError, match="never had full control"):
        account(read_log(tmp_path / "a.mcap"))


def test_comparison_on_the_command_line(logs, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "140")
    plot = tmp_path / "plots" / "power.png"
    main(["energy", str(logs[1]), str(logs[0]), "-o", str(plot), "--joints"])
    out = capsys.readouterr().out
    nominal, longer = account(read_log(logs[0])), account(read_log(logs[1]))
    cheaper = longer.summary.cost_of_transport < nominal.summary.cost_of_transport
    assert ("longer (cheapest)" in out, "nominal (cheapest)" in out) == (cheaper, not cheaper)
    assert f"{nominal.summary.eq10_w_ticks:.4g} W·ticks" in out
    assert f"{longer.energy_j:.4g} ± {longer.error_j:.2g} J at 200 Hz" in out
    ratio = longer.summary.cost_of_transport / nominal.summary.cost_of_transport - 1
    assert f"{100 * ratio:+.1f} %" in out
    assert "RR_calf_joint" in out
    assert "the commands differ" in out
    pixels = np.asarray(Image.open(plot).convert("RGB")).reshape(-1, 3)
    assert (np.abs(pixels.astype(int) - (0x0B, 0x7A, 0x75)).max(axis=1) < 8).sum() > 200  # the best body's curve
    with pytest.raises(SystemExit):
        main(["energy", str(logs[0]), "-o", str(tmp_path / "power.doc")])
    assert "ends in .png" in capsys.readouterr().err


def test_comparison_as_json(logs, capsys):
    main(["energy", str(logs[0]), str(logs[1]), "--seconds", "2", "--json"])
    first, second = json.loads(capsys.readouterr().out)
    assert first["name"] == "nominal"
    assert second["design"] == {"thigh": 1.0, "calf": 1.1}
    assert sum(first["joints_j"].values()) == pytest.approx(first["energy_j_physics"])
    assert first["fore_j"] + first["hind_j"] == pytest.approx(first["energy_j_physics"])


def test_energy_of_nothing(capsys):
    with pytest.raises(SystemExit) as exit_:
        main(["energy"])
    assert exit_.value.code == 1
    assert "no log given" in capsys.readouterr().err
