"""The C++ runner: built against the torch wheel, it reproduces golden traces and depth images."""

import io
import json
import math
import os
import shutil
import subprocess
import sysconfig
import warnings
from pathlib import Path

import numpy as np
import onnx
import pytest
from deploy.depth.optics import DepthOptics
from deploy.depth.preprocess import DepthPreprocessor
from deploy.depth.sources import to_metres
from deploy.interfaces import DepthFrame, Intrinsics
from deploy_seeing import weights
from onnx import numpy_helper

torch = pytest.importorskip("torch", reason="the C++ runner is built against the torch wheel: pip install torch")
PATH = os.pathsep.join((sysconfig.get_path("scripts"), os.environ.get("PATH", "")))
CMAKE, NINJA = shutil.which("cmake", path=PATH), shutil.which("ninja", path=PATH)
if CMAKE is None:
    pytest.skip("the C++ runner is built with cmake: pip install 'legged-deploy[test-cpp]'", allow_module_level=True)

pytestmark = [pytest.mark.slow, pytest.mark.timeout(2400)]
SOURCE = Path(__file__).parents[2] / "packages" / "deploy" / "cpp"


@pytest.fixture(scope="module")
def runner(tmp_path_factory):
    """Runs the built runner; gives status, output and errors."""
    build = tmp_path_factory.mktemp("cpp")
    generator = ["-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={NINJA}"] if NINJA else []
    prefix = f"-DCMAKE_PREFIX_PATH={torch.utils.cmake_prefix_path}"
    for command in (["-S", SOURCE, "-B", build, *generator, prefix], ["--build", build]):
        done = subprocess.run([CMAKE, *map(str, command)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr

    def run(*words):
        return subprocess.run([build / "legged_runner", *map(str, words)], capture_output=True, text=True)

    return run


class Trot(torch.nn.Module):
    """The hand-made policy of conftest.py, from its definition."""

    def __init__(self, policy: bytes, sees: bool) -> None:
        super().__init__()
        graph = onnx.load_from_string(policy).graph
        self.c = {t.name: torch.from_numpy(numpy_helper.to_array(t).copy()) for t in graph.initializer}
        self.sees = sees

    def forward(self, obs, *rest):
        c, (phase, smooth) = self.c, rest[-2:]
        smooth = 0.9 * smooth + obs
        action = torch.sin(phase + c["offset"]) * c["amplitude"] + smooth @ c["w"]
        if self.sees:
            action = action + 0.3 * (rest[0] @ c["action_terrain"] + rest[1] @ c["action_heading"])
        return action, smooth @ c["v"], phase + c["step"], smooth


class Eye(torch.nn.Module):
    """The hand-made depth encoder of deploy_seeing.py, from its definition."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.w = {name: torch.from_numpy(value) for name, value in weights(size).items()}

    def forward(self, depth, obs, memory):
        w, flat = self.w, depth.flatten(1)
        terrain = flat @ w["terrain_depth"] + memory @ w["terrain_memory"]
        heading = 0.1 * (obs @ w["heading_obs"] + memory @ w["heading_memory"])
        return terrain, heading, 0.5 * memory + flat @ w["memory_depth"]


def torchscript(module, *shapes) -> bytes:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        traced = torch.jit.trace(module.eval(), tuple(torch.zeros(1, *shape) for shape in shapes))
        return traced.save_to_buffer()


def add_torchscript(folder, sees=False):
    folder.manifest["policy"]["torchscript"] = "policy.ts.pt"
    seen = [(4,), (2,)] if sees else []
    folder.files["policy.ts.pt"] = torchscript(Trot(folder.files["policy.onnx"], sees), (45,), *seen, (1,), (45,))
    if sees:
        folder.manifest["depth"]["torchscript"] = "depth_encoder.ts.pt"
        folder.files["depth_encoder.ts.pt"] = torchscript(Eye(45), (6, 8), (45,), (3,))
    return folder


def test_reproduces_the_golden_trace_with_its_reset(runner, folder, golden):
    assert np.flatnonzero(golden["reset"]).tolist() == [0, 12]
    done = runner(add_torchscript(folder).seal(), "--golden")
    assert done.returncode == 0, done.stderr
    assert "box trot: 24 ticks" in done.stdout
    rows = [line.split() for line in done.stdout.splitlines() if "largest difference" in line]
    largest = {row[0]: float(row[3]) for row in rows}
    assert largest.keys() == {"action", "obs", "target"}
    assert 0 < max(largest.values()) < 1e-5


def test_reproduces_the_golden_trace_of_a_policy_that_sees(runner, seeing_folder):
    done = runner(add_torchscript(seeing_folder, sees=True).seal(), "--golden")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "terrain" in done.stdout
    assert "heading" in done.stdout


@pytest.mark.parametrize("latency", [4, 6])
def test_another_latency_is_another_trace(runner, seeing_folder, latency):
    seeing_folder.manifest["depth"]["latency_ticks"] = latency
    done = runner(add_torchscript(seeing_folder, sees=True).seal(), "--golden")
    assert done.returncode == 1
    assert "TOO LARGE" in done.stdout


def every_source(folder, pack) -> None:
    """Make of a bundle one whose observation has every source and whose action is clipped; action = obs W."""
    rng = np.random.default_rng(3)
    sizes = {"roll_pitch": 2, "heading_error": 1, "next_heading_error": 1, "commanded_speed": 1, "foot_contact": 4}
    terms = folder.manifest["observation"]["terms"]
    for name, size in sizes.items():
        scale = list(rng.uniform(0.5, 2.0, size)) if size > 1 else 0.7
        terms.append({"name": name, "source": name, "frame": "", "unit": "", "size": size, "scale": scale})
    w = 0.1 * rng.standard_normal((54, 12))
    folder.manifest["policy"] |= {"inputs": {"obs": [1, 54]}, "outputs": {"action": [1, 12]}, "state": []}
    folder.manifest["action"]["clip"] = 0.5
    with np.load(io.BytesIO(folder.files["golden.npz"])) as file:
        trace = dict(file)
    ticks = len(trace["reset"])
    trace["contact"] = rng.random((ticks, 4)) < 0.5
    offset = np.array([joint["target_offset"] for joint in folder.manifest["joints"]])
    scales = np.concatenate([np.broadcast_to(term["scale"], term["size"]) for term in terms])
    obs = np.zeros((ticks, 54))
    last = np.zeros(12)
    for t, (qw, qx, qy, qz) in enumerate(trace["quat_wxyz"]):
        last = last * (not trace["reset"][t])
        roll = math.atan2(2 * (qw * qx + qy * qz), 1 - 2 * (qx * qx + qy * qy))
        pitch = math.asin(2 * (qw * qy - qz * qx))
        raw = np.r_[trace["obs"][t, :33] / scales[:33], last, roll, pitch, 0, 0, trace["command"][t, 0]]
        obs[t] = scales * np.r_[raw, trace["contact"][t] - 0.5]
        trace["action"][t] = obs[t] @ w
        last = np.clip(trace["action"][t], -0.5, 0.5)
        trace["target"][t] = offset + 0.25 * last
    trace["obs"] = obs

    class Linear(torch.nn.Module):
        weight = torch.from_numpy(w.astype(np.float32))

        def forward(self, obs):
            return (obs @ self.weight,)

    folder.manifest["policy"]["torchscript"] = "policy.ts.pt"
    folder.files["policy.ts.pt"] = torchscript(Linear(), (54,))
    folder.files["golden.npz"] = pack(trace)
    assert np.abs(trace["action"]).max() > 0.5


def without_ticks(folder, pack):
    with np.load(io.BytesIO(folder.files["golden.npz"])) as file:
        folder.files["golden.npz"] = pack({name: values[:-2] for name, values in file.items()})
    return "golden trace: has 22 ticks, manifest.json says 24"


def without_contacts(folder, pack):
    every_source(folder, pack)
    with np.load(io.BytesIO(folder.files["golden.npz"])) as file:
        folder.files["golden.npz"] = pack({name: values for name, values in file.items() if name != "contact"})
    return "the policy feels its feet, the state has no contacts"


def with_a_nan_reading(folder, pack):
    with np.load(io.BytesIO(folder.files["golden.npz"])) as file:
        trace = dict(file)
    trace["gyro"][7, 1] = np.nan
    folder.files["golden.npz"] = pack(trace)
    return "observation: base_angular_velocity is not finite"


def with_a_nan_action(folder, pack):
    trot = Trot(folder.files["policy.onnx"], sees=False)
    trot.c["amplitude"].flatten()[3] = float("nan")
    folder.files["policy.ts.pt"] = torchscript(trot, (45,), (1,), (45,))
    return "is not finite; damp the robot"


@pytest.mark.parametrize("spoil", [without_ticks, without_contacts, with_a_nan_reading, with_a_nan_action])
def test_what_must_not_reach_a_motor_ends_the_run(runner, folder, pack, spoil):
    add_torchscript(folder)
    words = spoil(folder, pack)
    done = runner(folder.seal(), "--golden")
    assert done.returncode == 1
    assert words in done.stderr


def test_a_golden_trace_that_proves_nothing_is_refused(runner, folder):
    folder.manifest["golden"]["atol"] = 1.0
    done = runner(add_torchscript(folder).seal(), "--golden")
    assert (done.returncode, "an atol of up to 0.001" in done.stderr) == (1, True)


def compressed(trace) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **trace)
    return buffer.getvalue()


def test_every_source_of_observations_clipped_actions_and_a_compressed_trace(runner, folder):
    every_source(folder, compressed)
    done = runner(folder.seal(), "--golden")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("value", [1e-4, float("nan")])
def test_an_altered_trace_is_refused(runner, folder, golden, pack, value):
    golden["action"][13, 5] += value
    folder.files["golden.npz"] = pack(golden)
    done = runner(add_torchscript(folder).seal(), "--golden")
    assert done.returncode == 1
    (line,) = [line for line in done.stdout.splitlines() if "TOO LARGE" in line]
    assert line.split()[0] == "action"


def spoil_golden(folder):
    folder.files["golden.npz"] = folder.files["golden.npz"][:-200]


def flip_golden(folder):
    data = bytearray(folder.files["golden.npz"])
    data[data.index(b"NUMPY") + 400] ^= 0x10
    folder.files["golden.npz"] = bytes(data)


def spoil_network(folder):
    folder.files["policy.ts.pt"] = folder.files["policy.ts.pt"][:1000]


def without_torchscript(folder):
    del folder.manifest["policy"]["torchscript"]


def other_version(folder):
    folder.manifest["schema_version"] = 2


def unknown_source(folder):
    folder.manifest["observation"]["terms"][0]["source"] = "smell"


@pytest.mark.parametrize(
    ("spoil", "file", "words"),
    [
        (spoil_golden, "golden.npz", "not arrays of numpy: not a zip archive, or torn"),
        (flip_golden, "golden.npz", "not arrays of numpy: damaged"),
        (spoil_network, "policy.ts.pt", "LibTorch cannot load it"),
        (without_torchscript, "manifest.json", '"torchscript" is missing'),
        (other_version, "manifest.json", "schema_version is 2, this runner reads 1"),
        (unknown_source, "", "this runner cannot give smell"),
    ],
)
def test_a_spoilt_bundle_is_refused_in_words(runner, folder, spoil, file, words):
    spoil(add_torchscript(folder))
    done = runner(folder.seal(), "--golden")
    assert done.returncode == 1
    assert file in done.stderr
    assert words in done.stderr


@pytest.mark.parametrize("text", ["{", '{"a": }', "[1, 2", '{"schema_version": 1e999}', "{} x", "[" * 100, '"\\q"', ""])
def test_text_that_is_not_json(runner, folder, text):
    path = add_torchscript(folder).seal() / "manifest.json"
    path.write_text(text)
    done = runner(path.parent, "--golden")
    assert done.returncode == 1
    assert "manifest.json: not valid JSON at byte" in done.stderr


def test_no_bundle_and_no_such_option(runner, tmp_path):
    done = runner(tmp_path, "--golden")
    assert (done.returncode, "manifest.json: cannot be read" in done.stderr) == (1, True)
    done = runner(tmp_path, "--dance")
    assert (done.returncode, "legged_runner BUNDLE --golden" in done.stderr) == (2, True)


LENS = Intrinsics(424.0, 424.0, 420.5, 243.0)


@pytest.mark.parametrize(
    ("size", "lens"),
    [((480, 848), None), ((480, 848), LENS), ((480, 640), Intrinsics(310.0, 310.0, 322.0, 236.0)), ((24, 36), None)],
)
@pytest.mark.parametrize("kind", ["16UC1", "32FC1"])
def test_depth_is_preprocessed_as_in_python(runner, seeing_folder, tmp_path, size, lens, kind):
    depth = seeing_folder.manifest["depth"]
    focal = 53.0 / math.tan(math.radians(43.5))
    depth["image"] |= {"rows": 24, "columns": 36}
    depth["camera"] |= {"fx": focal * 36 / 98, "fy": focal * 24 / 58, "cx": 18.0, "cy": 30 * 24 / 58, "near": 0.3}
    depth["camera"] |= {"raw_size": [60, 106], "crop_bottom": 2, "crop_sides": 4}
    bundle = add_torchscript(seeing_folder, sees=True).seal()
    rng = np.random.default_rng(1)
    raw = rng.integers(0, 3000, size).astype(np.uint16)
    raw[rng.random(size) < 0.7] = 0  # many holes,
    raw[: size[0] // 3, : size[1] // 3] = 0  # and a large one
    if kind == "32FC1":
        odd = rng.choice([np.nan, np.inf, -np.inf, 0.0, -1.0], size, p=[0.4, 0.05, 0.05, 0.3, 0.2])
        odd[: size[0] // 3, : size[1] // 3] = np.nan
        raw = np.where(raw == 0, odd, raw * 1e-3).astype(np.float32)
    np.save(tmp_path / "frame.npy", raw)
    words = [] if lens is None else [lens.fx, lens.fy, lens.cx, lens.cy]
    done = runner(bundle, "--depth", tmp_path / "frame.npy", tmp_path / "image.npy", *words)
    assert done.returncode == 0, done.stderr
    metres = raw if raw.dtype == np.float32 else to_metres(raw)
    expected = DepthPreprocessor(DepthOptics.from_manifest(depth))(DepthFrame(0, 0, metres, lens))
    found = np.load(tmp_path / "image.npy")
    assert found.shape == (24, 36)
    np.testing.assert_allclose(found, expected.image, atol=1e-6)
    assert float(done.stdout.split()[1]) == pytest.approx(expected.measured, abs=1e-5)
    assert 0.2 < expected.measured < 1.0


@pytest.mark.parametrize(("value", "words"), [(0.0, "every pixel is 0"), (np.nan, "every pixel is NaN")])
def test_frames_that_show_nothing_are_told_apart(runner, seeing_folder, tmp_path, value, words):
    bundle = add_torchscript(seeing_folder, sees=True).seal()
    np.save(tmp_path / "frame.npy", np.full((6, 8), value, np.float32))
    done = runner(bundle, "--depth", tmp_path / "frame.npy", tmp_path / "image.npy")
    assert words in done.stdout
    np.testing.assert_array_equal(np.load(tmp_path / "image.npy"), 0.5)


@pytest.mark.parametrize("pixels", [4, 5])
def test_a_nearly_blind_camera_is_a_fault_as_in_python(runner, seeing_folder, tmp_path, pixels):
    bundle = add_torchscript(seeing_folder, sees=True).seal()
    image = np.zeros((6, 8), np.float32)
    image.flat[:pixels] = 1.0
    np.save(tmp_path / "frame.npy", image)
    done = runner(bundle, "--depth", tmp_path / "frame.npy", tmp_path / "image.npy")
    fault = DepthPreprocessor(DepthOptics.from_manifest(seeing_folder.manifest["depth"]))(DepthFrame(0, 0, image)).fault
    assert done.stdout.splitlines()[1] == (fault or "")
    assert (fault is None) == (pixels == 5)


def test_cameras_that_do_not_fit(runner, seeing_folder, folder, tmp_path):
    np.save(tmp_path / "frame.npy", np.ones((480, 848), np.float32))
    bundle = add_torchscript(seeing_folder, sees=True).seal()
    done = runner(bundle, "--depth", tmp_path / "frame.npy", tmp_path / "image.npy")
    assert (done.returncode, "another aspect ratio" in done.stderr) == (1, True)
    done = runner(bundle, "--depth", tmp_path / "frame.npy", tmp_path / "image.npy", 900, 900, 424, 240)
    assert (done.returncode, "field of view misses" in done.stderr) == (1, True)
    done = runner(add_torchscript(folder).seal(), "--depth", tmp_path / "frame.npy", tmp_path / "image.npy")
    assert (done.returncode, "the policy is blind" in done.stderr) == (1, True)


def test_the_manifest_of_a_bundle_is_read_as_json_says(runner, folder):
    path = add_torchscript(folder).seal() / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["name"] = 'sch\u00f6n "q" \\ \u2603\t/'
    path.write_text(json.dumps(manifest, ensure_ascii=True, indent=3))
    done = runner(path.parent, "--golden")
    assert 'sch\u00f6n "q" \\ \u2603\t/: 24 ticks' in done.stdout
