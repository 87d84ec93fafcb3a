"""The command line."""

import json

import pytest
from deploy.cli import main


def test_doctor(bundle_dir, capsys):
    with pytest.raises(SystemExit) as exit_:
        main(["doctor", str(bundle_dir)])
    assert exit_.value.code == 0
    out = capsys.readouterr().out
    assert "box trot: intact" in out
    assert "24 ticks" in out


def test_run_then_report_agree(bundle_dir, tmp_path, capsys):
    log = str(tmp_path / "walk.mcap")
    args = ["--command", "0.3", "-0.0", "0", "--duration", "0.5", "--log", log, "--json"]
    with pytest.raises(SystemExit) as exit_:
        main(["run", str(bundle_dir), *args])
    assert exit_.value.code == 0
    ran = json.loads(capsys.readouterr().out)
    main(["report", log, "--json"])
    assert json.loads(capsys.readouterr().out) == ran
    assert ran["ticks"] == 25
    main(["report", log])
    assert "energy_j_physics" in capsys.readouterr().out


def test_errors_are_one_line_and_exit_1(tmp_path, capsys):
    with pytest.raises(SystemExit) as exit_:
        main(["doctor", str(tmp_path)])
    assert exit_.value.code == 1
    captured = capsys.readouterr()
    assert "manifest.json" in captured.err
    assert captured.err.count("\n") == 1


def test_a_run_that_falls_short_exits_2(folder, capsys):
    """Servos too weak to stand on."""
    scene = folder.files["scene.xml"].decode().replace('forcerange="-30.0 30.0"', 'forcerange="-1 1"')
    folder.files["scene.xml"] = scene.encode()
    for joint in folder.manifest["joints"]:
        joint["torque_limit"] = 1.0
    with pytest.raises(SystemExit) as exit_:
        main(["run", str(folder.seal()), "--duration", "5", "--json"])
    assert exit_.value.code == 2
    assert json.loads(capsys.readouterr().out)["fell"]
