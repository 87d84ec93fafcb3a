"""A bundle is accepted only whole, unchanged and consistent."""

import copy
import json

import jsonschema
import numpy as np
import pytest
from deploy import BundleError, OnnxRuntime, check_golden, load_bundle
from deploy.bundles.loading import schema


def test_intact_bundle_gives_typed_values(bundle_dir):
    bundle = load_bundle(bundle_dir)
    manifest = json.loads((bundle_dir / "manifest.json").read_text())
    assert bundle.joint_names == tuple(joint["name"] for joint in manifest["joints"])
    assert bundle.per_joint("kp").tolist() == [joint["kp"] for joint in manifest["joints"]]
    assert bundle.robot.design == {"thigh": 1.0, "calf": 1.1}
    assert bundle.observation_size == 45
    assert bundle.period_ns == 20_000_000
    assert bundle.terms[0].scale == (0.25, 0.25, 0.25)


def test_schema_is_valid_2020_12():
    jsonschema.Draft202012Validator.check_schema(schema())


def walk(value, path=()):
    """Every position in a JSON value."""
    yield path
    if isinstance(value, dict):
        for key in value:
            yield from walk(value[key], (*path, key))
    elif isinstance(value, list) and value:
        yield from walk(value[0], (*path, 0))


def test_every_required_key_is_required(folder):
    """Removing any key that the schema requires, one at a time, is an error that names it."""
    root = folder.seal()
    intact = json.loads((root / "manifest.json").read_text())
    optional = {("policy", "outputs", "velocity")}
    removed = 0
    for path in walk(intact):
        if not path or isinstance(path[-1], int) or path[0] in ("files", "training") or path in optional:
            continue
        manifest = copy.deepcopy(intact)
        parent = manifest
        for key in path[:-1]:
            parent = parent[key]
        del parent[path[-1]]
        (root / "manifest.json").write_text(json.dumps(manifest))
        with pytest.raises(BundleError, match=r"manifest\.json") as error:
            load_bundle(root)
        assert str(path[-1]) in str(error.value)
        removed += 1
    assert removed > 50


@pytest.mark.parametrize(
    ("path", "value", "element"),
    [
        (("name",), 3, "name"),
        (("created",), "yesterday", "created"),
        (("surprise",), 1, "surprise"),
        (("robot", "total_mass"), 0, "total_mass"),
        (("robot", "total_mass"), "14", "total_mass"),
        (("robot", "feet"), ["a", "b", "c"], "feet"),
        (("robot", "scene"), "../scene.xml", "scene"),
        (("robot", "scene"), "/etc/passwd", "scene"),
        (("robot", "colour"), "red", "colour"),
        (("joints", 3, "kp"), -1, r"joints\[3\]\.kp"),
        (("joints", 3, "torque_limit"), None, r"joints\[3\]\.torque_limit"),
        (("joints",), [], "joints"),
        (("action", "scale"), 0, "scale"),
        (("action", "rule"), "target = action", "rule"),
        (("rates", "policy_hz"), 0, "policy_hz"),
        (("start", "quat_wxyz"), [1, 0, 0], "quat_wxyz"),
        (("command", "names"), ["vx"], "names"),
        (("observation", "terms", 0, "source"), "camera", "source"),
        (("observation", "terms", 0, "scale"), "1", "scale"),
        (("policy", "inputs", "image"), [1, 3], "image"),
        (("policy", "state", 0, "init"), "random", "init"),
        (("golden", "atol"), 0, "atol"),
        (("golden", "atol"), 0.1, "atol"),
        (("training",), "unknown", "training"),
    ],
)
def test_schema_violation_names_the_element(folder, path, value, element):
    parent = folder.manifest
    for key in path[:-1]:
        parent = parent[key]
    parent[path[-1]] = value
    with pytest.raises(BundleError, match=element):
        load_bundle(folder.seal())


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("joints", 1, "name"), "FL_hip_joint", "FL_hip_joint is listed twice"),
        (("joints", 1, "actuator"), "FL_hip_joint", "FL_hip_joint is listed twice"),
        (("joints", 1, "stance"), 9.0, "FL_thigh_joint: stance"),
        (("joints", 1, "kp"), 0, "FL_thigh_joint: kp is 0"),
        (("observation", "terms", 0, "size"), 4, "base_angular_velocity: size 4"),
        (("observation", "terms", 0, "scale"), [1, 2], "2 scale factors"),
        (("policy", "inputs", "obs"), [1, 44], "terms make"),
        (("policy", "outputs", "action"), [1, 11], "action is"),
        (("policy", "state", 1, "input"), "phase_in", "phase_in is listed twice"),
        (("policy", "torchscript"), "policy.ts.pt", "policy.ts.pt is used but not listed"),
        (("robot", "design", "values"), [1.0], "differ in length"),
        (("command", "low"), [2, -1, -1], "low above high"),
        (("rates", "physics_dt"), 0.003, "does not divide"),
        (("start", "quat_wxyz"), [1, 1, 0, 0], "unit quaternion"),
    ],
)
def test_contradiction_inside_the_manifest(folder, path, value, words):
    parent = folder.manifest
    for key in path[:-1]:
        parent = parent[key]
    parent[path[-1]] = value
    with pytest.raises(BundleError, match=words):
        load_bundle(folder.seal())


def test_other_version_says_so(folder):
    folder.manifest["schema_version"] = 2
    with pytest.raises(BundleError, match="schema_version is 2"):
        load_bundle(folder.seal())


@pytest.mark.parametrize("name", ["policy.onnx", "robot.urdf", "robot.xml", "scene.xml", "golden.npz"])
def test_changed_file_is_named(folder, name):
    root = folder.seal()
    data = bytearray((root / name).read_bytes())
    data[len(data) // 2] ^= 1
    (root / name).write_bytes(data)
    with pytest.raises(BundleError, match=f"{name}: content has changed"):
        load_bundle(root)


def test_missing_file_is_named(folder):
    root = folder.seal()
    (root / "scene.xml").unlink()
    with pytest.raises(BundleError, match=r"scene\.xml: file is missing"):
        load_bundle(root)


def test_extra_file_is_named(folder):
    root = folder.seal()
    (root / "payload.bin").write_bytes(b"")
    with pytest.raises(BundleError, match=r"payload\.bin: file is not listed"):
        load_bundle(root)


def test_link_out_of_the_bundle_is_refused(folder, tmp_path):
    root = folder.seal()
    (root / "robot.urdf").rename(tmp_path / "elsewhere.urdf")
    (root / "robot.urdf").symlink_to(tmp_path / "elsewhere.urdf")
    with pytest.raises(BundleError, match=r"robot\.urdf: not a plain file"):
        load_bundle(root)


@pytest.mark.parametrize("text", ["{", "[]", "\xff\xfe", '{"schema_version": 1, "name": NaN}'])
def test_unreadable_manifest(folder, text):
    root = folder.seal()
    (root / "manifest.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(BundleError, match=r"manifest\.json"):
        load_bundle(root)


def test_no_bundle_there(tmp_path):
    with pytest.raises(BundleError, match=r"no manifest\.json"):
        load_bundle(tmp_path)


def test_golden_trace_reproduced(bundle_dir):
    """The trace was computed in float64 from the definitions, so agreement is not with ourselves."""
    bundle = load_bundle(bundle_dir)
    result = check_golden(bundle, OnnxRuntime(bundle))
    assert result.ticks == 24
    assert 0 < result.obs < 1e-6
    assert 0 < result.action < 1e-6


@pytest.mark.parametrize("quantity", ["obs", "action", "target"])
@pytest.mark.parametrize("error", [2e-5, np.nan])
def test_golden_trace_not_reproduced(folder, golden, pack, quantity, error):
    golden[quantity][17, 5] += error
    folder.files["golden.npz"] = pack(golden)
    bundle = load_bundle(folder.seal())
    with pytest.raises(BundleError, match=f"tick 17: {quantity} differs"):
        check_golden(bundle, OnnxRuntime(bundle))


def test_golden_reset_in_the_middle_matters(folder, golden, pack):
    """Without the reset flag the recurrent state of tick 12 is another."""
    golden["reset"][12] = False
    folder.files["golden.npz"] = pack(golden)
    bundle = load_bundle(folder.seal())
    with pytest.raises(BundleError, match="tick 12: obs differs"):
        check_golden(bundle, OnnxRuntime(bundle))


def test_golden_with_pickle_inside_is_refused(folder, golden, pack):
    golden["obs"] = np.array([object()], dtype=object)
    folder.files["golden.npz"] = pack(golden)
    bundle = load_bundle(folder.seal())
    with pytest.raises(BundleError, match="not a golden trace"):
        check_golden(bundle, OnnxRuntime(bundle))


def test_golden_of_other_length(folder, golden, pack):
    folder.files["golden.npz"] = pack({name: values[:20] for name, values in golden.items()})
    bundle = load_bundle(folder.seal())
    with pytest.raises(BundleError, match="has shape"):
        check_golden(bundle, OnnxRuntime(bundle))
