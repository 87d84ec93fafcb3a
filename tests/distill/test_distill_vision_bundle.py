"""Export of a seeing student: two networks, one camera, and a trace that any consumer can repeat."""

from __future__ import annotations

import io
import json
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from distill import (
    AdaptationConfig,
    AdaptationModule,
    BundleError,
    BundleSpec,
    CameraSpec,
    DepthEncoderConfig,
    ObservationTerm,
    VisionStudent,
    VisionStudentConfig,
    export_vision_bundle,
    verify_bundle,
)
from distill.inspection import print_bundle
from distill.leapp import write_leapp
from distill.manifest import check_schema, checksum_line
from distill.networks import mlp
from distill.spec import HEADINGS
from distill.vision import Convolution
from rich.console import Console

ROWS, COLUMNS, PERIOD, LATENCY = 10, 14, 5, 7
TERMS = (
    ObservationTerm("turning", "base_angular_velocity", 0.25, "base", "rad/s"),
    ObservationTerm("attitude", "roll_pitch", 1.0, "base", "rad"),
    ObservationTerm("way", "heading_error", 1.0, "base", "rad"),
    ObservationTerm("way after", "next_heading_error", 1.0, "base", "rad"),
    ObservationTerm("speed", "commanded_speed", 2.0, "base", "m/s"),
    ObservationTerm("joints", "joint_position_error", 1.0, "joint", "rad"),
    ObservationTerm("rates", "joint_velocity", 0.05, "joint", "rad/s"),
    ObservationTerm("action", "last_action", 1.0, "joint", "1"),
    ObservationTerm("feet", "foot_contact", 1.0, "foot", "1"),
)
CAMERA = CameraSpec((0.27, 0.0, 0.03), (-0.08, 0.09), 8.0, 9.0, 7.0, 5.5, 0.1, 2.0, (60, 106), 2, 4)


@pytest.fixture(scope="module")
def seeing_spec(spec: BundleSpec) -> BundleSpec:
    return replace(spec, name="toy-parkour", observation=TERMS, camera=CAMERA)


@pytest.fixture(scope="module")
def seeing(seeing_spec: BundleSpec) -> VisionStudent:
    """Untrained; random weights make every input count."""
    with torch.random.fork_rng():
        torch.manual_seed(7)
        depth = DepthEncoderConfig(
            (Convolution(4, 3, pool=2), Convolution(6, 2)), image_hidden=16, image_features=8, fusion=(16,), memory=12
        )
        config = VisionStudentConfig(depth=depth, latency=LATENCY, terrain_dim=6, latent_dim=5)
        proprio, way = seeing_spec.proprio, slice(5, 7)
        sizes = AdaptationConfig(history=6, frame_features=8, channels=(8,), features=16, estimator=(16,))
        actor = mlp(proprio + 6 + 3 + 5, (32,), 12)
        with torch.no_grad():  # so that one tick's memory matters to the next
            actor[0].weight.mul_(3.0)
        adaptation = AdaptationModule(proprio, 5, sizes, range(5, 7))
        return VisionStudent(proprio, way, (ROWS, COLUMNS), PERIOD, config, adaptation, actor).eval()


@pytest.fixture(scope="module")
def exported(seeing_spec, seeing, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("seeing") / "bundle"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return export_vision_bundle(folder, seeing, seeing_spec)


@pytest.fixture
def bundle(exported: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(exported, tmp_path / "bundle"))


def rewrite(folder: Path, manifest: dict) -> None:
    """A manifest whose own checksum is right."""
    (folder / "manifest.json").write_text(json.dumps(manifest))
    (folder / "manifest.sha256").write_text(checksum_line(folder / "manifest.json"))


def manifest_of(folder: Path) -> dict:
    return json.loads((folder / "manifest.json").read_text())


def session(path: Path) -> onnxruntime.InferenceSession:
    return onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])


def test_the_folder_holds_two_networks_that_stand_alone(bundle):
    networks = {"policy.onnx", "policy.ts.pt", "depth_encoder.onnx", "depth_encoder.ts.pt"}
    body = {"robot.urdf", "robot.xml", "scene.xml"}
    manifest = {"manifest.json", "manifest.sha256"}
    assert {path.name for path in bundle.iterdir()} == networks | body | manifest | {"golden.npz"}
    for name in ("policy.onnx", "depth_encoder.onnx"):
        model = onnx.load(bundle / name)
        onnx.checker.check_model(model, full_check=True)
        assert [opset.version for opset in model.opset_import if opset.domain == ""] == [18]
        assert not any(tensor.external_data for tensor in model.graph.initializer)


def test_the_manifest_says_what_a_robot_needs(bundle):
    manifest = manifest_of(bundle)
    check_schema(manifest, "manifest.json")
    depth = manifest["depth"]
    assert (depth["period_ticks"], depth["latency_ticks"], manifest["rates"]["depth_hz"]) == (PERIOD, LATENCY, 10.0)
    assert depth["camera"]["pitch"] == [-0.08, 0.09]
    assert depth["camera"]["position"] == [0.27, 0.0, 0.03]
    for network, path in ((manifest["policy"], "policy.onnx"), (depth, "depth_encoder.onnx")):
        found = {item.name: item.shape for item in session(bundle / path).get_inputs()}
        states = {state["input"]: state["shape"] for state in network["state"]}
        assert found == {**network["inputs"], **states}
        gives = {item.name: item.shape for item in session(bundle / path).get_outputs()}
        assert gives == {**network["outputs"], **{s["output"]: s["shape"] for s in network["state"]}}


def test_the_golden_trace_follows_from_raw_states_images_and_manifest_alone(bundle):
    """As a robot's software would do it, with onnxruntime and nothing of distill; a reset falls between two images."""
    manifest, trace = manifest_of(bundle), np.load(bundle / "golden.npz", allow_pickle=False)
    policy, encoder = session(bundle / "policy.onnx"), session(bundle / "depth_encoder.onnx")
    stance, offset = (np.array([joint[key] for joint in manifest["joints"]]) for key in ("stance", "target_offset"))
    starts = np.flatnonzero(trace["reset"]).tolist()
    assert starts == [0, 128]
    assert starts[1] % PERIOD
    image, start = 0, 0
    for tick in range(manifest["golden"]["ticks"]):
        if trace["reset"][tick]:
            history, memory, last, start, pending = np.zeros((1, 6, 48)), np.zeros((1, 12)), np.zeros(12), tick, {}
            terrain, heading = np.zeros((1, 6)), np.zeros((1, 2))
        w, x, y, z = trace["quat_wxyz"][tick]
        roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        pitch = np.arcsin(2 * (w * y - x * z))
        obs = np.concatenate(
            (
                0.25 * trace["gyro"][tick],
                (roll, pitch, 0.0, 0.0, 2.0 * trace["command"][tick, 0]),
                trace["q"][tick] - stance,
                0.05 * trace["dq"][tick],
                last,
                trace["contact"][tick] - 0.5,
            )
        )
        np.testing.assert_allclose(trace["obs"][tick], obs, atol=1e-5)
        assert trace["depth_due"][tick] == ((tick - start) % PERIOD == 0)
        if trace["depth_due"][tick]:
            feed = {"depth": trace["depth"][image][None], "obs": obs[None], "memory_in": memory}
            *seen, memory = encoder.run(None, {name: value.astype(np.float32) for name, value in feed.items()})
            pending[tick + LATENCY] = seen
            image += 1
        terrain, heading = pending.get(tick, (terrain, heading))
        np.testing.assert_allclose(trace["heading"][tick], heading[0], atol=1e-5)
        np.testing.assert_allclose(trace["terrain"][tick], terrain[0], atol=1e-5)
        feed = {"obs": obs[None], "terrain": terrain, "heading": heading, "history_in": history}
        action, _, history = policy.run(None, {name: value.astype(np.float32) for name, value in feed.items()})
        np.testing.assert_allclose(trace["action"][tick], action[0], atol=1e-5)
        last = action[0].clip(-0.1, 0.1)
        np.testing.assert_allclose(trace["target"][tick], offset + 0.25 * last, atol=1e-5)
    assert image == len(trace["depth"]) == 52
    assert (np.abs(np.diff(trace["heading"], axis=0)).max(axis=1) > 1e-4).sum() > 40  # the images were different


def test_all_networks_agree_over_300_recurrent_steps_with_resets(bundle, seeing):
    policy, encoder = session(bundle / "policy.onnx"), session(bundle / "depth_encoder.onnx")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        scripted, its_eyes = (torch.jit.load(bundle / name) for name in ("policy.ts.pt", "depth_encoder.ts.pt"))
    generator = torch.Generator().manual_seed(2)
    for step in range(330):
        if step % 110 == 0:
            eager = torch_ = (torch.zeros(1, 6, 48), torch.zeros(1, 12))
            onnx_ = tuple(state.numpy() for state in eager)
        obs = torch.randn(1, 48, generator=generator) * torch.logspace(-1, 0.7, 48)
        image = torch.rand(1, ROWS, COLUMNS, generator=generator) - 0.5
        image[0, 2, 3] = float("nan") if step % 7 == 0 else 0.0
        with torch.no_grad():
            terrain, heading, memory = seeing.see(seeing.features(image), obs, eager[1])
            action, velocity, history = seeing(obs, terrain, heading, eager[0])
            ts_terrain, ts_heading, ts_memory = its_eyes(image, obs, torch_[1])
            ts_action, ts_velocity, ts_history = scripted(obs, ts_terrain, ts_heading, torch_[0])
        feed = {"depth": image.numpy(), "obs": obs.numpy(), "memory_in": onnx_[1]}
        o_terrain, o_heading, o_memory = encoder.run(None, feed)
        feed = {"obs": obs.numpy(), "terrain": o_terrain, "heading": o_heading, "history_in": onnx_[0]}
        o_action, o_velocity, o_history = policy.run(None, feed)
        eager, torch_, onnx_ = (history, memory), (ts_history, ts_memory), (o_history, o_memory)
        wanted = (action, velocity, terrain, heading, memory)
        for found in (
            (ts_action, ts_velocity, ts_terrain, ts_heading, ts_memory),
            (o_action, o_velocity, o_terrain, o_heading, o_memory),
        ):
            for mine, theirs in zip(found, wanted, strict=True):
                np.testing.assert_allclose(np.asarray(mine), theirs.numpy(), atol=1e-5, rtol=0)


def test_verification_replays_both_networks_and_names_a_changed_file(bundle):
    found = verify_bundle(bundle)
    assert (found.files, found.ticks) == (8, 256)
    assert set(found.errors) == {"policy.onnx", "policy.ts.pt"}
    assert max(found.errors.values()) < 1e-5
    data = bytearray((bundle / "depth_encoder.onnx").read_bytes())
    data[len(data) // 2] ^= 1
    (bundle / "depth_encoder.onnx").write_bytes(data)
    with pytest.raises(BundleError, match=r"depth_encoder\.onnx: altered"):
        verify_bundle(bundle)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m["depth"].update(latency_ticks=-1), r"\$\.depth\.latency_ticks"),
        (lambda m: m["depth"]["camera"].pop("fx"), "'fx' is a required property"),
        (lambda m: m["depth"].update(latency_ticks=LATENCY + 1), "differs from the golden trace"),
        (lambda m: m["depth"].update(period_ticks=PERIOD + 1), "images are not those of every 6th tick"),
        (lambda m: m["files"].pop("depth_encoder.onnx"), r"no hash for depth_encoder\.onnx"),
    ],
)
def test_a_manifest_that_is_wrong_is_refused(bundle, change, message):
    manifest = manifest_of(bundle)
    change(manifest)
    rewrite(bundle, manifest)
    with pytest.raises(BundleError, match=message):
        verify_bundle(bundle)


def test_what_does_not_fit_together_is_named(seeing, seeing_spec, tmp_path):
    plain = tuple(term for term in TERMS if term.source not in HEADINGS)
    with pytest.raises(BundleError, match=r"needs BundleSpec\.camera"):
        export_vision_bundle(tmp_path / "b", seeing, replace(seeing_spec, camera=None, observation=plain))
    order = (TERMS[0], TERMS[2], TERMS[3], TERMS[1], *TERMS[4:])
    with pytest.raises(BundleError, match=r"headings in columns \[3, 4\], the student predicts those of 5 to 6"):
        export_vision_bundle(tmp_path / "b", seeing, replace(seeing_spec, observation=order))
    with pytest.raises(BundleError, match=r"images have shape \(3, 10, 14\), expected \(52, 10, 14\)"):
        export_vision_bundle(tmp_path / "b", seeing, seeing_spec, images=np.zeros((3, ROWS, COLUMNS), np.float32))
    with pytest.raises(BundleError, match="headings, which no sensor gives"):
        replace(seeing_spec, camera=None)
    with pytest.raises(BundleError, match="0 <= near < far"):
        replace(CAMERA, near=3.0)
    assert not (tmp_path / "b").exists()


def test_inspection_tells_a_stranger_what_it_is(bundle):
    console = Console(width=160, record=True, file=io.StringIO())
    print_bundle(bundle, console)
    text = console.export_text()
    for part in (
        "toy-parkour: a policy for one body of the robot 'toy', 15 kg",
        "front_thigh 0.3333, hind_shank 1.3",
        "10 x 14 pixels each 5 ticks (10 Hz), used 7 ticks (140 ms) after it was taken",
        "vx -0.6 to 1",
        "RR_calf_joint",
        "commanded_speed",
        "memory_out -> memory_in [1, 12]",
        "8 files are as they were written",
        "depth_encoder.onnx",
    ):
        assert part in text, part


def test_leapp_joins_both_networks(bundle, seeing, tmp_path):
    """Its graph has one rate: a step of it is an image and its use at once, without latency."""
    leapp = pytest.importorskip("leapp")
    graph = leapp.InferenceManager(str(write_leapp(bundle, tmp_path / "leapp")))
    assert sorted(graph.inputs) == ["depth/depth", "depth/obs", "policy/obs"]
    assert sorted(graph.feedback_inputs) == ["depth/memory_in", "policy/history_in"]
    torch.manual_seed(3)
    history, memory = torch.zeros(1, seeing.history, seeing.proprio), torch.zeros(1, 12)
    for _ in range(3):
        obs, image = torch.randn(1, seeing.proprio), torch.rand(1, ROWS, COLUMNS) - 0.5
        found = graph({"depth/depth": image, "depth/obs": obs, "policy/obs": obs})
        with torch.no_grad():
            terrain, heading, memory = seeing.see(seeing.features(image), obs, memory)
            action, _, history = seeing(obs, terrain, heading, history)
        torch.testing.assert_close(found["policy/action"], action, atol=1e-5, rtol=0)
