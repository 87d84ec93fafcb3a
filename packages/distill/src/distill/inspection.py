"""A bundle explained to a person who has never seen it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from distill.manifest import CHECKSUM, MANIFEST, read_manifest
from distill.verify import verify_bundle


def inspect_bundle(folder: Path) -> Group:
    """What a bundle is, needs and promises, as text and tables for a terminal.

    Its files are checked and its golden trace is replayed first.

    Raises:
        BundleError: the bundle is not right.
    """
    found = verify_bundle(folder)
    manifest = read_manifest(folder / MANIFEST)
    worst = max(found.errors.values())
    checked = (
        f"Checked: {found.files} files are as they were written; {', '.join(found.errors)} repeat the recorded "
        f"{found.ticks} ticks to {worst:.1e}."
    )
    return Group(
        *(Text(line) for line in _story(manifest)),
        Text(checked),
        Text(),
        _observation(manifest),
        Text(),
        _joints(manifest),
        Text(),
        _networks(manifest),
        Text(),
        _files(folder, manifest),
    )


def print_bundle(folder: Path, console: Console) -> None:
    """Print what `inspect_bundle` tells."""
    console.print(inspect_bundle(folder))


def _story(m: Mapping[str, Any]) -> Iterator[str]:
    robot, rates, action, command = m["robot"], m["rates"], m["action"], m["command"]
    generator, design = m["generator"], robot["design"]
    body = ", ".join(f"{name} {value:.4g}" for name, value in zip(design["names"], design["values"], strict=True))
    origin = f" (commit {generator['commit']})" if generator["commit"] else ""
    yield f"{m['name']}: a policy for one body of the robot '{robot['name']}', {robot['total_mass']:.3g} kg."
    yield f"Body: {body or 'nominal'}. Never run it on another one; robot.urdf says what this one is."
    writer = f"{generator['package']} {generator['version']}{origin}, torch {generator['torch']}"
    yield f"Written {m['created']} by {writer}."
    yield (
        f"Each 1/{rates['policy_hz']:g} s: observation -> network -> action -> joint targets "
        f"({action['rule']}; scale {action['scale']:g} rad, clip {action['clip']}); servos hold them with kp and kd."
    )
    ranges = ", ".join(
        f"{name} {low:g} to {high:g}"
        for name, low, high in zip(command["names"], command["low"], command["high"], strict=True)
    )
    yield f"Commands that it was trained on: {ranges} (m/s, rad/s)."
    yield f"Start: standing at the stance, base {m['start']['height']:.3f} m above the ground."
    yield from _sight(m)


def _sight(m: Mapping[str, Any]) -> Iterator[str]:
    if "depth" not in m:
        yield "It is blind: it needs no camera."
        return
    depth, hertz = m["depth"], m["rates"]["policy_hz"]
    camera, image = depth["camera"], depth["image"]
    x, y, z = camera["position"]
    late = depth["latency_ticks"]
    yield (
        f"It sees: a depth image of {image['rows']} x {image['columns']} pixels each {depth['period_ticks']} ticks "
        f"({m['rates']['depth_hz']:g} Hz), used {late} ticks ({1e3 * late / hertz:g} ms) after it was taken, always."
    )
    yield (
        f"Camera: at ({x:g}, {y:g}, {z:g}) m in the base frame, fx {camera['fx']:.4g} fy {camera['fy']:.4g} px, "
        f"{camera['near']:g} to {camera['far']:g} m; a pixel is {image['rule']}, without a measurement it reads "
        f"{image['invalid']}."
    )
    yield f"It predicts the way to go itself, up to {depth['heading']['limit']:g} rad to either side."


def _observation(m: Mapping[str, Any]) -> Table:
    table = Table("observation", "columns", "source", "frame", "unit", "scale", title="What it is told, in this order")
    start = 0
    for term in m["observation"]["terms"]:
        end = start + term["size"]
        scale = term["scale"]
        text = ", ".join(f"{x:g}" for x in scale) if isinstance(scale, list) else f"{scale:g}"
        table.add_row(term["name"], f"{start} to {end - 1}", term["source"], term["frame"], term["unit"], text)
        start = end
    return table


def _joints(m: Mapping[str, Any]) -> Table:
    table = Table(
        "joint",
        "stance",
        "offset",
        "lower",
        "upper",
        "kp",
        "kd",
        "torque limit",
        title="Joints (rad, N m), bound by name",
    )
    for joint in m["joints"]:
        keys = ("stance", "target_offset", "lower", "upper", "kp", "kd", "torque_limit")
        table.add_row(joint["name"], *(f"{joint[key]:.4g}" for key in keys))
    return table


def _networks(m: Mapping[str, Any]) -> Table:
    table = Table("network", "inputs", "outputs", "fed back, zeros at a start", title="Networks, batch 1")
    for network in (m["policy"], *((m["depth"],) if "depth" in m else ())):
        states = ", ".join(f"{s['output']} -> {s['input']} {s['shape']}" for s in network["state"])
        inputs, outputs = (_shapes(network[key]) for key in ("inputs", "outputs"))
        table.add_row(network["file"], inputs, outputs, states)
    return table


def _shapes(shapes: Mapping[str, list[int]]) -> str:
    return ", ".join(f"{name} {shape}" for name, shape in shapes.items())


_PURPOSE = {
    "policy.onnx": "the policy, for onnxruntime",
    "policy.ts.pt": "the same for LibTorch",
    "depth_encoder.onnx": "what is fed with images, for onnxruntime",
    "depth_encoder.ts.pt": "the same for LibTorch",
    "golden.npz": "recorded states, observations and targets to test a robot's software with",
    "robot.urdf": "the body",
    "robot.xml": "the body for MuJoCo, with servos and sensors",
    "scene.xml": "the ground that it was trained on, with the body",
}


def _files(folder: Path, m: Mapping[str, Any]) -> Table:
    table = Table("file", "kB", "what it is", title=f"Files; {MANIFEST} holds their hashes, {CHECKSUM} its own")
    for name in m["files"]:
        size = (folder / name).stat().st_size / 1000
        table.add_row(name, f"{size:.0f}", _PURPOSE.get(name, ""))
    return table
