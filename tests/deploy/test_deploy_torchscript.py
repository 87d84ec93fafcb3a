"""The same bundle in TorchScript: golden trace, guards, and clear words where torch or the file is missing."""

import sys

import pytest
from deploy import BundleError, DeployError, OnnxRuntime, check_golden, load_bundle, run
from deploy.policy.torchscript_runtime import TorchScriptRuntime


@pytest.fixture
def torch():
    return pytest.importorskip("torch")


@pytest.fixture
def scripted(torch, seeing_folder):
    """The bundle that sees with both networks written again, in torch, from the constants of the ONNX files."""
    import onnx
    from onnx import numpy_helper
    from torch import nn

    constants = {}
    for name in ("policy.onnx", "depth_encoder.onnx"):
        graph = onnx.load_from_string(seeing_folder.files[name]).graph
        constants[name] = {t.name: torch.tensor(numpy_helper.to_array(t)) for t in graph.initializer}

    class Walk(nn.Module):
        def forward(self, obs, terrain, heading, phase_in, smooth_in):
            c = constants["policy.onnx"]
            smooth = smooth_in * c["keep"] + obs
            seen = (terrain @ c["action_terrain"] + heading @ c["action_heading"]) * c["share"]
            action = torch.sin(phase_in + c["offset"]) * c["amplitude"] + smooth @ c["w"] + seen
            return action, smooth @ c["v"], phase_in + c["step"], smooth

    class Look(nn.Module):
        def forward(self, depth, obs, memory_in):
            c = constants["depth_encoder.onnx"]
            flat = depth.flatten(1)
            terrain = flat @ c["terrain_depth"] + memory_in @ c["terrain_memory"]
            heading = 0.1 * (obs @ c["heading_obs"] + memory_in @ c["heading_memory"])
            return terrain, heading, 0.5 * memory_in + flat @ c["memory_depth"]

    sizes = {
        "policy.ts.pt": (Walk(), ((1, 45), (1, 4), (1, 2), (1, 1), (1, 45))),
        "depth_encoder.ts.pt": (Look(), ((1, 6, 8), (1, 45), (1, 3))),
    }
    for name, (module, shapes) in sizes.items():
        path = seeing_folder.root.with_suffix(f".{name}")
        torch.jit.save(torch.jit.trace(module, tuple(torch.zeros(shape) for shape in shapes)), path)
        seeing_folder.files[name] = path.read_bytes()
    seeing_folder.manifest["policy"]["torchscript"] = "policy.ts.pt"
    seeing_folder.manifest["depth"]["torchscript"] = "depth_encoder.ts.pt"
    return seeing_folder


@pytest.mark.filterwarnings("ignore:`torch.jit")
def test_golden_trace_and_a_run(scripted):
    root = scripted.seal()
    bundle = load_bundle(root)
    result = check_golden(bundle, TorchScriptRuntime(bundle))
    assert 0 < result.action < 1e-6
    assert 0 < result.terrain < 1e-6
    summaries = [run(root, (0.3, 0, 0), 0.4, runtime=name) for name in ("onnx", "torchscript")]
    assert [summary.completed for summary in summaries] == [True, True]
    assert summaries[0].energy_j_physics == pytest.approx(summaries[1].energy_j_physics, rel=1e-3)


@pytest.mark.filterwarnings("ignore:`torch.jit")
def test_networks_in_the_wrong_place_are_refused(scripted):
    section = scripted.manifest
    section["policy"]["torchscript"], section["depth"]["torchscript"] = "depth_encoder.ts.pt", "policy.ts.pt"
    bundle = load_bundle(scripted.seal())
    with pytest.raises(BundleError, match=r"depth_encoder\.ts\.pt: does not take obs, terrain"):
        check_golden(bundle, TorchScriptRuntime(bundle))


@pytest.mark.filterwarnings("ignore:`torch.jit")
def test_a_broken_file(scripted):
    scripted.files["policy.ts.pt"] = b"not a network"
    bundle = load_bundle(scripted.seal())
    with pytest.raises(BundleError, match=r"policy\.ts\.pt: torch cannot load it"):
        TorchScriptRuntime(bundle)


def test_a_bundle_without_torchscript(torch, bundle_dir):
    bundle = load_bundle(bundle_dir)
    with pytest.raises(BundleError, match=r"holds no TorchScript of policy\.onnx"):
        TorchScriptRuntime(bundle)


def test_torch_is_missing(bundle_dir, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    bundle = load_bundle(bundle_dir)
    with pytest.raises(DeployError, match=r"pip install 'legged-deploy\[torch\]'"):
        TorchScriptRuntime(bundle)
    OnnxRuntime(bundle)
