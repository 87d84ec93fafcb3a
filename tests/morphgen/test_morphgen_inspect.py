"""What `morphgen inspect` says about robots whose numbers are known."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import robot_defects as defects
from morphgen import MorphologyError
from morphgen.cli import main
from morphgen.inspection.inspect import inspect


def found(name: str, tmp_path, **options):
    return inspect(defects.write(name, tmp_path), **options)


def test_the_legs_by_hand(tmp_path):
    seen = found("clean", tmp_path)
    assert seen.scalable
    assert seen.total_mass == pytest.approx(7.5 + 4 * (0.74 + 1.18 + 0.19 + 0.05))
    assert [leg.name for leg in seen.legs] == list(defects.SIDES)
    for leg in seen.legs:
        assert leg.joints == tuple(f"{leg.name}_{part}_joint" for part in ("hip", "thigh", "shank"))
        assert leg.links == tuple((f"{leg.name}_{part}",) for part in ("hip", "thigh", "shank", "foot"))
        lengths = (leg.hip_offset, leg.thigh, leg.shank, leg.foot_radius)
        assert lengths == pytest.approx((0.094, 0.22, 0.225, 0.024))
        # law of cosines at the knee's limits, -2.7 and -0.4 rad
        expected = [np.sqrt(0.22**2 + 0.225**2 + 2 * 0.22 * 0.225 * np.cos(knee)) for knee in (2.7, 0.4)]
        assert leg.reach == pytest.approx(expected, rel=1e-9)
    assert seen.asymmetries == seen.missing_inertials == seen.carried == seen.repaired == ()
    parts = {link.name: link.part for link in seen.links}
    assert parts["trunk"] == "trunk"
    assert (parts["RL_shank"], parts["RL_foot"]) == ("RL shank", "RL foot")
    thigh = next(link for link in seen.links if link.name == "FR_thigh")
    tensor = np.array([[0.0062, -7e-5, -2.6e-4], [-7e-5, 0.0061, -7e-4], [-2.6e-4, -7e-4, 0.0011]])
    assert thigh.moments == pytest.approx(np.linalg.eigvalsh(tensor))
    assert (thigh.mass, thigh.com) == (1.18, (-0.005, 0.021, -0.038))


@pytest.mark.parametrize("name", [*defects.SAME, *defects.OTHER])
def test_what_can_be_scaled_is_said_to_be(tmp_path, name):
    seen = found(name, tmp_path)
    assert seen.scalable
    assert seen.refused == ()
    json.dumps(seen.to_json(), allow_nan=False)


@pytest.mark.parametrize("name", [*defects.REFUSED, *defects.REPAIRABLE])
def test_what_cannot_be_scaled_is_said_to_be(tmp_path, name):
    seen = found(name, tmp_path)
    assert not seen.scalable
    assert found(name, tmp_path, repair=True).scalable == (name in defects.REPAIRABLE)
    json.dumps(seen.to_json(), allow_nan=False)


def test_every_reason_is_given_at_once(tmp_path):
    path = defects.write("invalid_shank", tmp_path)
    text = path.read_text().replace('<sphere radius="0.024"/>', '<mesh filename="none.stl"/>')
    path.write_text(text)
    refused = inspect(path).refused
    assert [sum(f"link '{leg}_shank'" in reason for reason in refused) for leg in defects.SIDES] == [1] * 4
    assert sum("none.stl" in reason for reason in refused) == 1


def test_links_and_joints_that_lack_something(tmp_path):
    seen = found("massless_links", tmp_path)
    assert set(seen.collision_only) == set(seen.missing_inertials) == {f"{leg}_shank_lower" for leg in defects.SIDES}
    missing = {joint.name: joint.missing for joint in found("continuous_joints", tmp_path).joints}
    assert len(missing) == 12
    assert set(missing.values()) == {("limits", "effort", "velocity")}
    assert all(joint.missing == () for joint in seen.joints)


def test_rotors_and_drives_are_listed(tmp_path):
    rotors = {f"{leg}_{part}_rotor" for leg in defects.SIDES for part in ("hip", "thigh", "shank")}
    assert set(found("rotors", tmp_path).carried) == rotors
    assert set(found("knee_drive", tmp_path).carried) == {f"{leg}_KFE_drive" for leg in defects.SIDES}


def test_asymmetries_in_millimetres_and_percent(tmp_path):
    seen = {(a.part, a.quantity): (a.difference, a.unit) for a in found("asymmetric", tmp_path).asymmetries}
    tensor = np.array([[5.2e-4, -4e-6, 0], [-4e-6, 8.8e-4, 0], [0, 0, 6.1e-4]])
    percent = 100 * 0.1 * 8.8e-4 / np.linalg.norm(tensor)
    for pair in ("front", "hind"):
        assert seen.pop((f"{pair} hip", "centre of mass")) == (pytest.approx(5.0), "mm")
        assert seen.pop((f"{pair} hip", "inertia")) == (pytest.approx(percent), "%")
    assert seen == {}


def test_collisions_that_differ_are_an_asymmetry(tmp_path):
    path = defects.write("clean", tmp_path)
    text = path.read_text()
    start = text.index('<link name="FL_shank">')
    path.write_text(text[:start] + text[start:].replace('radius="0.012"', 'radius="0.014"', 1))
    (only,) = inspect(path).asymmetries
    assert (only.part, only.quantity, only.unit) == ("front shank", "collision", "mm")
    assert only.difference == pytest.approx(2.0)
    path.write_text(
        text[:start] + text[start:].replace('<cylinder radius="0.012" length="0.14"/>', '<box size="1 1 1"/>', 1)
    )
    (only,) = inspect(path).asymmetries
    assert np.isinf(only.difference)


def test_meshes_found_and_missing(tmp_path):
    (mesh,) = found("several_materials", tmp_path, mesh_paths=[tmp_path]).meshes
    assert mesh.path == str(tmp_path / "meshes" / "thigh.obj")
    assert (mesh.collision, len(mesh.links)) == (False, 4)
    (mesh,) = found("missing_mesh", tmp_path).meshes
    assert (mesh.path, mesh.collision) == (None, True)
    assert "--mesh-path" in mesh.problem


def test_the_command_prints_and_tells_by_its_status(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["inspect", str(defects.write("rotors", tmp_path))]) == 0
    out = capsys.readouterr().out
    assert "can be scaled" in out
    assert "17.100 kg" in out  # 16.14 and twelve rotors of 80 g
    assert re.search(r"FL\s+FL_hip_joint\s+FL_foot\s+0\.094\s+0\.220\s+0\.225", out)
    assert main(["inspect", str(defects.write("invalid_sensor", tmp_path))]) == 2
    out = capsys.readouterr().out
    assert "cannot be scaled" in out
    assert re.search(r"link 'camera'.*--repair", out)
    assert main(["inspect", str(tmp_path / "invalid_sensor.urdf"), "--repair"]) == 0
    assert re.search(r"link 'camera'.*nearest possible", capsys.readouterr().out)
    arm = [f"arm{i}_joint" for i in range(3)]
    path = str(defects.write("five_legs", tmp_path))
    assert main(["inspect", path]) == 2
    assert main(["inspect", path, "--lock", *arm]) == 0
    hips = [f"{leg}_hip_joint" for leg in defects.SIDES]
    assert main(["inspect", str(defects.write("clean", tmp_path)), "--hips", *hips]) == 0


def test_the_command_says_which_joints_can_be_hips(tmp_path, capsys):
    hips = [f"{leg}_hip_joint" for leg in defects.SIDES]
    can_be = "hip joints can be " + ", ".join(f"'{hip}'" for hip in hips)
    path = str(defects.write("five_legs", tmp_path))
    for named, reason in (
        (["arm0_joint", *hips[1:]], "'arm0_joint', named for FL (--hips)"),
        ([*hips[:3], hips[0]], f"'{hips[0]}' is named for FL and for RR"),
    ):
        assert main(["inspect", path, "--hips", *named]) == 2
        out = capsys.readouterr().out
        assert reason in out
        assert can_be in out


def test_json_is_the_inspection(tmp_path, capsys):
    path = defects.write("continuous_joints", tmp_path)
    assert main(["inspect", str(path), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data == json.loads(json.dumps(inspect(path).to_json()))
    assert data["scalable"] is True
    assert data["legs"][0]["thigh"] == pytest.approx(0.22)
    assert data["joints"][0]["lower"] is None


def test_files_that_cannot_be_opened(tmp_path, capsys):
    assert main(["inspect", str(tmp_path / "none.urdf")]) == 2
    assert "none.urdf" in capsys.readouterr().err
    (tmp_path / "latin.urdf").write_bytes('<robot name="é"/>'.encode("latin-1"))
    assert main(["inspect", str(tmp_path / "latin.urdf")]) == 2
    assert "save it as UTF-8" in capsys.readouterr().out
    with pytest.raises(MorphologyError, match="not a folder"):
        inspect(defects.write("clean", tmp_path), mesh_paths=[tmp_path / "none"])
