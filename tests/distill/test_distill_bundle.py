"""Export: what lies in the folder, that all networks agree, and that nothing half-made is left."""

from __future__ import annotations

import hashlib
import json
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from distill import BundleError, RawStates, export_bundle, verify_bundle
from distill import export as export_module
from distill.golden import plausible_states
from distill.leapp import write_leapp
from distill.manifest import checksum_line

FILES = {"policy.onnx", "policy.ts.pt", "golden.npz", "robot.urdf", "robot.xml", "scene.xml"}


@pytest.fixture(scope="module")
def exported(spec, student, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("exported") / "bundle"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return export_bundle(folder, student, spec)


@pytest.fixture
def known_onnx(exported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Spare the seconds that converting the same student again would take."""
    monkeypatch.setattr(
        export_module, "save_onnx", lambda student, example, path: shutil.copy(exported / "policy.onnx", path)
    )


@pytest.fixture
def bundle(exported: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(exported, tmp_path / "bundle"))


def rewrite(folder: Path, manifest: dict) -> None:
    """A manifest whose own checksum is right."""
    (folder / "manifest.json").write_text(json.dumps(manifest))
    (folder / "manifest.sha256").write_text(checksum_line(folder / "manifest.json"))


def manifest_of(folder: Path) -> dict:
    return json.loads((folder / "manifest.json").read_text())


def test_the_folder_is_complete_and_hashed(bundle, spec):
    manifest = manifest_of(bundle)
    assert {path.name for path in bundle.iterdir()} == FILES | {"manifest.json", "manifest.sha256"}
    assert set(manifest["files"]) == FILES
    for name, digest in manifest["files"].items():
        assert hashlib.sha256((bundle / name).read_bytes()).hexdigest() == digest
    assert (bundle / "robot.urdf").read_text() == spec.urdf
    assert (bundle / "robot.xml").read_text() == spec.robot_xml
    assert (bundle / "scene.xml").read_text() == spec.scene_xml


def test_the_manifest_keeps_the_schema_and_every_digit(bundle, spec):
    manifest = manifest_of(bundle)
    schema = json.loads(Path(export_module.__file__).with_name("bundle.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(manifest, schema)
    assert manifest["robot"]["design"] == {"names": ["front_thigh", "hind_shank"], "values": [1.0 / 3.0, 1.3]}
    for joint, row in zip(spec.joints, manifest["joints"], strict=True):
        assert all(row[name] == getattr(joint, name) for name in row)
    assert manifest["policy"]["state"][0]["shape"] == [1, 12, 45]
    assert [term["size"] for term in manifest["observation"]["terms"]] == [3, 3, 3, 12, 12, 12]
    assert manifest["observation"]["terms"][2]["scale"] == [2.0, 2.0, 0.25]
    assert manifest["training"] == {"seed": 3, "curve": [0.1, 0.2]}
    assert manifest["generator"]["commit"] == "0123abc"


def test_the_onnx_file_stands_alone(bundle, tmp_path):
    lonely = tmp_path / "elsewhere" / "policy.onnx"
    lonely.parent.mkdir()
    shutil.copy(bundle / "policy.onnx", lonely)
    model = onnx.load(lonely)
    onnx.checker.check_model(model, full_check=True)
    assert [opset.version for opset in model.opset_import if opset.domain == ""] == [18]
    assert not any(tensor.external_data for tensor in model.graph.initializer)
    session = onnxruntime.InferenceSession(lonely, providers=["CPUExecutionProvider"])
    assert [(item.name, item.shape) for item in session.get_inputs()] == [
        ("obs", [1, 45]),
        ("history_in", [1, 12, 45]),
    ]
    assert [(item.name, item.shape) for item in session.get_outputs()] == [
        ("action", [1, 12]),
        ("velocity", [1, 3]),
        ("history_out", [1, 12, 45]),
    ]


def test_all_networks_agree_over_recurrent_steps_with_resets(bundle, student):
    """Each network runs on its own history for 330 steps; observations are random and of mixed scale."""
    session = onnxruntime.InferenceSession(bundle / "policy.onnx", providers=["CPUExecutionProvider"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        scripted = torch.jit.load(bundle / "policy.ts.pt")
    generator = torch.Generator().manual_seed(2)
    for step in range(330):
        if step % 110 == 0:
            eager = torchscript = torch.zeros(1, 12, 45)
            onnx_history = eager.numpy()
        obs = torch.randn(1, 45, generator=generator) * torch.logspace(-1, 0.7, 45)
        with torch.no_grad():
            action, velocity, eager = student(obs, eager)
            ts_action, ts_velocity, torchscript = scripted(obs, torchscript)
        onnx_action, onnx_velocity, onnx_history = session.run(None, {"obs": obs.numpy(), "history_in": onnx_history})
        for found, wanted in (
            (ts_action.numpy(), action),
            (ts_velocity.numpy(), velocity),
            (onnx_action, action),
            (onnx_velocity, velocity),
            (onnx_history, eager),
        ):
            np.testing.assert_allclose(found, wanted.numpy(), atol=1e-5, rtol=0)


def test_the_golden_trace_follows_from_raw_states_and_manifest_alone(bundle):
    """Recomputed with matrices and onnxruntime from nothing but the bundle, as a robot would."""
    manifest, trace = manifest_of(bundle), np.load(bundle / "golden.npz", allow_pickle=False)
    joints = manifest["joints"]
    stance, offset = (np.array([joint[name] for joint in joints]) for name in ("stance", "target_offset"))
    session = onnxruntime.InferenceSession(bundle / "policy.onnx", providers=["CPUExecutionProvider"])
    assert trace["reset"].sum() == 2
    assert trace["reset"][[0, 128]].all()
    for tick in range(manifest["golden"]["ticks"]):
        if trace["reset"][tick]:
            history, last = np.zeros((1, 12, 45), np.float32), np.zeros(12)
        w, x, y, z = trace["quat_wxyz"][tick]
        world_z_in_base = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z])
        obs = np.concatenate(
            (
                0.25 * trace["gyro"][tick],
                -world_z_in_base,
                np.array([2.0, 2.0, 0.25]) * trace["command"][tick],
                trace["q"][tick] - stance,
                0.05 * trace["dq"][tick],
                last,
            )
        )
        np.testing.assert_allclose(trace["obs"][tick], obs, atol=1e-5)
        feed = {"obs": obs[None].astype(np.float32), "history_in": history}
        action, _, history = session.run(None, feed)
        np.testing.assert_allclose(trace["action"][tick], action[0], atol=1e-5)
        last = action[0].clip(-0.1, 0.1)
        np.testing.assert_allclose(trace["target"][tick], offset + 0.25 * last, atol=1e-5)
    assert (np.abs(trace["action"]) > 0.1).any()  # the limit was reached, so it was tested


@pytest.mark.usefixtures("known_onnx")
def test_recorded_states_are_taken_over(spec, student, tmp_path):
    states = plausible_states(spec, 40, seed=11)
    arrays = {name: getattr(states, name) for name in ("quat_wxyz", "gyro", "q", "dq", "command")}
    reset = np.arange(40) % 25 == 0
    folder = export_bundle(tmp_path / "bundle", student, spec, RawStates(**arrays, reset=reset))
    trace = np.load(folder / "golden.npz", allow_pickle=False)
    for name, array in (*arrays.items(), ("reset", reset)):
        np.testing.assert_array_equal(trace[name], array)
    assert manifest_of(folder)["golden"]["ticks"] == 40


def test_verification_passes_and_counts(bundle):
    found = verify_bundle(bundle)
    assert (found.files, found.ticks) == (6, 256)
    assert set(found.errors) == {"policy.onnx", "policy.ts.pt"}
    assert max(found.errors.values()) < 1e-5


@pytest.mark.parametrize("name", sorted(FILES))
def test_a_changed_file_is_named(bundle, name):
    path = bundle / name
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(BundleError, match=rf"{name}: altered"):
        verify_bundle(bundle)


def test_missing_and_added_parts_are_named(bundle):
    (bundle / "extra.bin").touch()
    with pytest.raises(BundleError, match=r"holds extra\.bin"):
        verify_bundle(bundle)
    (bundle / "extra.bin").unlink()
    (bundle / "robot.urdf").unlink()
    with pytest.raises(BundleError, match=r"robot\.urdf: missing"):
        verify_bundle(bundle)
    (bundle / "manifest.json").unlink()
    with pytest.raises(BundleError, match=r"manifest\.json: missing"):
        verify_bundle(bundle)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda manifest: manifest.update(schema_version=2), "schema version 2"),
        (lambda manifest: manifest["joints"].pop(), r"\$\.joints"),
        (lambda manifest: manifest["files"].pop("policy.onnx"), r"no hash for policy\.onnx"),
        (lambda manifest: manifest["files"].update({"../x": "0" * 64}), "schema"),
    ],
)
def test_a_manifest_that_is_wrong_is_refused(bundle, change, message):
    manifest = manifest_of(bundle)
    change(manifest)
    rewrite(bundle, manifest)
    with pytest.raises(BundleError, match=message):
        verify_bundle(bundle)


def test_a_manifest_with_another_gain_is_refused(bundle):
    manifest = manifest_of(bundle)
    manifest["joints"][3]["kp"] += 1
    (bundle / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(BundleError, match=r"manifest\.json: altered"):
        verify_bundle(bundle)
    (bundle / "manifest.sha256").unlink()
    with pytest.raises(BundleError, match=r"manifest\.sha256: missing"):
        verify_bundle(bundle)


def test_a_manifest_cut_short_is_refused(bundle):
    path = bundle / "manifest.json"
    path.write_text(path.read_text()[:200])
    with pytest.raises(BundleError, match="not readable as JSON"):
        verify_bundle(bundle)


def test_a_network_that_is_not_the_one_recorded_is_found_out(bundle):
    """The hash is made to match: only the golden trace can tell."""
    trace = dict(np.load(bundle / "golden.npz", allow_pickle=False))
    trace["action"] = trace["action"] + 1e-3
    np.savez(bundle / "golden.npz", **trace)
    manifest = manifest_of(bundle)
    manifest["files"]["golden.npz"] = hashlib.sha256((bundle / "golden.npz").read_bytes()).hexdigest()
    rewrite(bundle, manifest)
    with pytest.raises(BundleError, match=r"policy\.onnx: differs from the golden trace by 1\.00e-03"):
        verify_bundle(bundle)


@pytest.mark.usefixtures("known_onnx")
def test_a_new_bundle_replaces_the_old_one(bundle, spec, student):
    export_bundle(bundle, student, replace(spec, name="second"))
    assert manifest_of(bundle)["name"] == "second"
    assert [path.name for path in bundle.parent.iterdir()] == ["bundle"]


@pytest.mark.usefixtures("known_onnx")
def test_a_failed_export_keeps_the_old_bundle(bundle, spec, student, monkeypatch):
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(export_module, "write_manifest", fail)
    with pytest.raises(BundleError, match=r"bundle: cannot be written .*No space left"):
        export_bundle(bundle, student, replace(spec, name="second"))
    verify_bundle(bundle)
    assert manifest_of(bundle)["name"] == "toy-walk"
    assert [path.name for path in bundle.parent.iterdir()] == ["bundle"]


@pytest.mark.usefixtures("known_onnx")
def test_a_crash_between_the_renames_loses_nothing(bundle, spec, student, monkeypatch):
    rename = export_module.os.rename

    def crash(source: Path, target: Path) -> None:
        if Path(target) == bundle:
            raise KeyboardInterrupt
        rename(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(export_module.os, "rename", crash)
        with pytest.raises(KeyboardInterrupt):
            export_bundle(bundle, student, spec)
    with pytest.raises(BundleError, match="observation terms add up"):
        export_bundle(bundle, student, replace(spec, observation=spec.observation[:2]))
    export_bundle(bundle, student, replace(spec, name="third"))
    assert manifest_of(bundle)["name"] == "third"
    assert [path.name for path in bundle.parent.iterdir()] == ["bundle"]


def test_a_folder_with_other_things_in_it_is_left_alone(spec, student, tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(BundleError, match="something other than a bundle"):
        export_bundle(tmp_path, student, spec)
    assert (tmp_path / "thesis.tex").read_text() == "precious"


def test_a_runtime_that_disagrees_stops_the_export(spec, student, tmp_path, monkeypatch):
    save = export_module.save_onnx

    def save_another(network, example, path):
        with torch.no_grad():
            network.velocity.bias += 1e-3
        save(network, example, path)
        with torch.no_grad():
            network.velocity.bias -= 1e-3

    monkeypatch.setattr(export_module, "save_onnx", save_another)
    with pytest.raises(BundleError, match=r"policy\.onnx: action differs from the eager network"):
        export_bundle(tmp_path / "bundle", student, spec)
    assert not list(tmp_path.iterdir())


def test_specifications_that_contradict_themselves_are_refused(spec):
    joints, terms = spec.joints, spec.observation
    for changes, message in (
        ({"joints": joints[:11]}, "11 joints are listed"),
        ({"joints": (replace(joints[0], stance=3.0), *joints[1:])}, "stance 3.0 is outside"),
        ({"joints": (replace(joints[0], kp=0.0), *joints[1:])}, "does nothing"),
        ({"command_low": (2.0, 0.0, 0.0)}, "upside down"),
        ({"physics_dt": 0.003}, "does not divide"),
        ({"start_quat_wxyz": (1.0, 1.0, 0.0, 0.0)}, "not a unit quaternion"),
        ({"joints": (*joints[:11], joints[0])}, "joint FL_hip_joint is listed more than once"),
        ({"joints": (replace(joints[0], kp=float("nan")), *joints[1:])}, "'FL_hip_joint': kp is nan"),
        ({"observation": (replace(terms[0], source="lidar"),)}, "'lidar' is none of"),
        ({"observation": (replace(terms[0], scale=(1.0, 2.0)),)}, "2 scales for 3 elements"),
        ({"scene_xml": " "}, "scene_xml is empty"),
    ):
        with pytest.raises(BundleError, match=message):
            replace(spec, **changes)


@pytest.mark.usefixtures("known_onnx")
def test_numbers_that_json_lacks_are_refused(spec, student, tmp_path):
    with pytest.raises(BundleError, match="cannot be written as JSON"):
        export_bundle(tmp_path / "bundle", student, replace(spec, total_mass=float("inf")))
    with pytest.raises(BundleError, match="total_mass"):
        export_bundle(tmp_path / "bundle", student, replace(spec, total_mass=-1.0))
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------- LEAPP


def test_leapps_own_reader_repeats_the_golden_trace(bundle, tmp_path):
    leapp = pytest.importorskip("leapp")
    path = write_leapp(bundle, tmp_path / "leapp")
    assert {each.name for each in path.parent.iterdir()} == {
        "leapp.yaml",
        "policy.onnx",
        "initial_values.safetensors",
    }
    graph = leapp.InferenceManager(str(path))
    assert (graph.inputs, graph.feedback_inputs) == (["policy/obs"], ["policy/history_in"])
    assert graph.outputs == ["policy/action", "policy/velocity"]
    with np.load(bundle / "golden.npz") as trace:
        for obs, reset, action in zip(trace["obs"], trace["reset"], trace["action"], strict=True):
            if reset:
                graph.reset()
            found = graph({"policy/obs": torch.from_numpy(obs)[None]})["policy/action"]
            np.testing.assert_allclose(found[0].numpy(), action, atol=1e-5)


def test_the_leapp_description_carries_the_manifest_and_the_hashes(bundle, tmp_path):
    yaml = pytest.importorskip("yaml")
    pytest.importorskip("safetensors")
    path = write_leapp(bundle, tmp_path / "leapp")
    found = yaml.safe_load(path.read_text())
    assert found["extra"]["legged_bundle"] == manifest_of(bundle)
    assert found["frequency"] == 50.0
    parameters = found["models"]["policy"]["parameters"]
    data = (path.parent / parameters["model_path"]).read_bytes()
    assert parameters["sha256sum"] == hashlib.sha256(data).hexdigest()
    assert parameters["md5sum"] == hashlib.md5(data, usedforsecurity=False).hexdigest()
    # an altered bundle is not described
    (bundle / "robot.urdf").write_text("<robot/>")
    with pytest.raises(BundleError, match="altered"):
        write_leapp(bundle, tmp_path / "other")
    assert not (tmp_path / "other").exists()
