"""A bundle described in LEAPP's format, for runtimes that read that instead of our manifest.

LEAPP (Lightweight Export Annotations for Policy Pipelines, NVIDIA) wires networks into a graph by a YAML file. Isaac
Lab and Isaac ROS Deploy run such graphs. The networks stay as they are, ONNX files of the bundle; the bundle's own
manifest goes along below `extra`, since the format has no place for gains, limits, body and camera. Nor has it one for
two rates: the depth encoder must be run at every `period_ticks`th tick only, and its outputs held back by
`latency_ticks`; a blind policy needs nothing of that.
"""

from __future__ import annotations

import hashlib
import json
import platform
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch

from distill.errors import ProviderError
from distill.manifest import MANIFEST, read_manifest
from distill.verify import verify_bundle

_VERSION = "0.7.2"
"""Of the LEAPP whose reader was tried."""
_KINDS = {
    "action": "target/joint/position",
    "velocity": "state/body/linear_velocity",
    "obs": "observation",
    "depth": "sensor/depth",
}
"""Meaning of an input or output; names outside of LEAPP's own list are allowed."""


def write_leapp(bundle: Path, out_dir: Path) -> Path:
    """Check a bundle, and write `leapp.yaml`, the networks and their initial state to `out_dir`.

    Returns:
        Path of the YAML file.

    Raises:
        BundleError: the bundle is not right.
        ProviderError: a package of the extra `leapp` is missing.
    """
    try:
        import yaml
        from safetensors.torch import save_file
    except ModuleNotFoundError as error:
        raise ProviderError(f"this needs {error.name}: pip install 'legged-distill[leapp]'") from error
    verify_bundle(bundle)
    manifest = read_manifest(bundle / MANIFEST)
    networks = {name: manifest[name] for name in ("depth", "policy") if name in manifest}
    out_dir.mkdir(parents=True, exist_ok=True)
    for network in networks.values():
        shutil.copyfile(bundle / network["file"], out_dir / network["file"])
    initial = {
        f"{name}/{state['input']}": torch.zeros(state["shape"])
        for name, network in networks.items()
        for state in network["state"]
    }
    save_file(initial, out_dir / "initial_values.safetensors")
    description = {
        "models": {name: _model(out_dir, network) for name, network in networks.items()},
        "pipeline": {**_pipeline(networks), "initial_values": "initial_values.safetensors"},
        "system information": {
            "leapp version": _VERSION,
            "torch version": str(torch.__version__),
            "python version": platform.python_version(),
        },
        "frequency": manifest["rates"]["policy_hz"],
        "extra": {"legged_bundle": manifest},
    }
    path = out_dir / "leapp.yaml"
    path.write_text(yaml.safe_dump(json.loads(json.dumps(description)), sort_keys=False), encoding="utf-8")
    return path


def _model(folder: Path, network: Mapping[str, Any]) -> dict[str, object]:
    """One node: inputs and outputs in the order of the ONNX file, states last."""
    states = network["state"]
    inputs = {**network["inputs"], **{state["input"]: state["shape"] for state in states}}
    outputs = {**network["outputs"], **{state["output"]: state["shape"] for state in states}}
    data = (folder / network["file"]).read_bytes()
    return {
        "inputs": [_tensor(name, shape) for name, shape in inputs.items()],
        "outputs": [_tensor(name, shape) for name, shape in outputs.items()],
        "parameters": {
            "model_path": network["file"],
            "md5sum": hashlib.md5(data, usedforsecurity=False).hexdigest(),
            "sha256sum": hashlib.sha256(data).hexdigest(),
            "backend": "onnx",
        },
    }


def _tensor(name: str, shape: list[int]) -> dict[str, object]:
    kind = {"kind": _KINDS[name]} if name in _KINDS else {}
    return {"name": name, "dtype": "float32", "shape": shape, "type": "tensor", **kind}


def _pipeline(networks: Mapping[str, Mapping[str, Any]]) -> dict[str, object]:
    """How outputs feed inputs: from image to action, and each state back to where it came from."""
    flow = dict(_between(networks))
    fed = {target for targets in flow.values() for target in targets}
    return {
        "data_flow": flow,
        "feedback_flow": {
            f"{name}/{state['output']}": [f"{name}/{state['input']}"]
            for name, network in networks.items()
            for state in network["state"]
        },
        "inputs": {
            name: [key for key in network["inputs"] if f"{name}/{key}" not in fed] for name, network in networks.items()
        },
        "outputs": {
            name: [key for key in network["outputs"] if f"{name}/{key}" not in flow]
            for name, network in networks.items()
            if any(f"{name}/{key}" not in flow for key in network["outputs"])
        },
    }


def _between(networks: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, list[str]]]:
    if "depth" in networks:
        for name in networks["depth"]["outputs"]:
            yield f"depth/{name}", [f"policy/{name}"]
