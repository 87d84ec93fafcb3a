"""What a bundle says of the robot, as a file."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from distill import BundleError, CameraSpec, read_spec, write_spec

CAMERA = CameraSpec((0.27, 0.0, 0.03), (-0.09, 0.09), 20.0, 21.0, 18.0, 12.0, 0.0, 2.0, (60, 106), 2, 4)


def test_what_is_written_is_read_back(spec, tmp_path):
    whole = replace(spec, camera=CAMERA, start_quat_wxyz=(0.6, 0.8, 0.0, 0.0))
    for each in (spec, whole):
        write_spec(each, tmp_path / "spec.json")
        assert read_spec(tmp_path / "spec.json") == replace(each, training={"seed": 3, "curve": [0.1, 0.2]})


def test_texts_may_be_files_beside_it(spec, tmp_path):
    write_spec(spec, tmp_path / "spec.json")
    table = json.loads((tmp_path / "spec.json").read_text())
    (tmp_path / "body").mkdir()
    (tmp_path / "body" / "a.urdf").write_text("<robot name='a'/>")
    (tmp_path / "spec.json").write_text(json.dumps({**table, "urdf": "body/a.urdf"}))
    assert read_spec(tmp_path / "spec.json").urdf == "<robot name='a'/>"
    (tmp_path / "spec.json").write_text(json.dumps({**table, "urdf": "body/b.urdf"}))
    with pytest.raises(BundleError, match=r"spec\.json: urdf: .*b\.urdf"):
        read_spec(tmp_path / "spec.json")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.pop("joints"), "lacks joints"),
        (lambda t: t.update(legs=6), "has legs, which means nothing"),
        (lambda t: t["joints"][3].pop("kp"), r"joints\[3\]: lacks kp"),
        (lambda t: t["observation"].append("imu"), r"observation\[6\]: must be a table, is str"),
        (lambda t: t.update(camera={"fx": 1.0}), "camera: lacks position"),
        (lambda t: t.update(joints={}), "'joints' must be a list"),
        (lambda t: t.update(scene_xml=3), "scene_xml must be a text"),
        (lambda t: t.update(scene_xml=" "), "scene_xml is empty"),
        (lambda t: t["joints"].pop(), "11 joints"),
        (lambda t: t.update(physics_dt="fast"), "wrong type"),
    ],
)
def test_errors_name_file_and_element(spec, tmp_path, change, message):
    path = tmp_path / "spec.json"
    write_spec(spec, path)
    table = json.loads(path.read_text())
    change(table)
    path.write_text(json.dumps(table))
    with pytest.raises(BundleError, match=message):
        read_spec(path)


def test_what_is_no_json_is_named(spec, tmp_path):
    (tmp_path / "spec.json").write_text("{")
    with pytest.raises(BundleError, match=r"spec\.json: not readable"):
        read_spec(tmp_path / "spec.json")
    with pytest.raises(BundleError, match=r"gone\.json: not readable"):
        read_spec(tmp_path / "gone.json")
    with pytest.raises(BundleError, match="cannot be written as JSON"):
        write_spec(replace(spec, training={"loss": float("nan")}), tmp_path / "nan.json")
