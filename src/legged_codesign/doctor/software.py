"""What is installed: Python, packages, extras, robots, shipped policies."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path

from locorl import CheckpointError, load_policy
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from legged_codesign.doctor.finding import Finding
from legged_codesign.pretrained import shipped_policies
from legged_codesign.provenance import PACKAGES

EXTRAS = {
    ("legged-morphgen", "viewer"): "`morphgen view`, the robot in the browser",
    ("legged-morphgen", "real-robots"): "vendors' URDFs for the tests, 270 MB",
    ("legged-locorl", "gpu"): "simulation on a GPU by MuJoCo Warp",
    ("legged-locorl", "gym"): "the gymnasium adapter",
    ("legged-locorl", "rsl-rl"): "the rsl_rl adapter",
    ("legged-locorl", "play"): "`locorl play` and pictures of terrain",
    ("legged-locorl", "tensorboard"): "`locorl train --tensorboard`",
    ("legged-codesign-bo", "baselines"): "other searches to compare with: Hyperopt, Optuna, CMA-ES",
    ("legged-codesign-bo", "plots"): "pictures of a search",
    ("legged-codesign-bo", "ray"): "trials on many machines by Ray",
    ("legged-codesign-bo", "slurm"): "trials on a Slurm cluster by submitit",
    ("legged-distill", "video"): "`distill evaluate --video`",
    ("legged-distill", "leapp"): "`distill leapp`",
    ("legged-deploy", "plot"): "`deploy page` and `deploy energy`",
    ("legged-deploy", "realsense"): "a RealSense depth camera",
    ("legged-deploy", "sim"): "robots simulated by MuJoCo",
    ("legged-deploy", "torch"): "bundles by TorchScript",
    ("legged-deploy", "unitree"): "Unitree robots over DDS",
}
"""What each extra is for, by distribution and name; those for tests and development are left out."""
ROBOTS = ("go2", "lite3", "urdf")

Versions = Callable[[str], str]
"""Installed version of a distribution; raises PackageNotFoundError."""


def check_python(version: str = platform.python_version(), asked: str | None = None) -> Finding:
    """Whether Python is new enough."""
    asked = asked or metadata.metadata("legged-codesign")["Requires-Python"]
    if not SpecifierSet(asked).contains(version, prereleases=True):
        return Finding("Python", "fail", f"{version}, and {asked} is asked for", f"make a venv with Python {asked}")
    return Finding("Python", "ok", f"{version} ({asked} is asked for)")


def check_packages(
    required: Iterable[tuple[str, str]] | None = None, installed: Versions = metadata.version
) -> list[Finding]:
    """Whether what pyproject.toml asks for is installed.

    Args:
        required: distribution and requirement (PEP 508); None for those of this project.
        installed: versions.
    """
    wrong = []
    needed = {(owner, str(r)): r for owner, text in required or _requirements() if _applies(r := Requirement(text))}
    for (owner, _), requirement in needed.items():
        found = _version(requirement.name, installed)
        if not _met(requirement, installed):
            has = "it is not installed" if found is None else f"{found} is installed"
            text = f"{owner} needs {requirement.name}{requirement.specifier}, and {has}"
            wrong.append(Finding("packages", "fail", text, f"pip install '{requirement}'"))
    if wrong:
        return wrong
    main = ", ".join(f"{name} {_version(name, installed)}" for name in ("torch", "mujoco", "numpy"))
    return [Finding("packages", "ok", f"all {len(needed)} requirements are met ({main})")]


def check_extras(installed: Versions = metadata.version) -> list[Finding]:
    """Which optional extras are there; a missing one is no fault."""
    present, absent = [], []
    for (owner, extra), purpose in EXTRAS.items():
        requirements = [Requirement(text) for text in metadata.requires(owner) or ()]
        parts = [requirement for requirement in requirements if _of_extra(requirement, extra)]
        if all(_met(requirement, installed) for requirement in parts):
            present.append(f"{owner}[{extra}]")
        else:
            text, remedy = f"{owner}[{extra}] is not there: {purpose}", f"pip install '{owner}[{extra}]'"
            absent.append(Finding("extras", "ok", text, remedy))
    return [Finding("extras", "ok", "there: " + (", ".join(present) or "none")), *absent]


def check_robots(found: Sequence[metadata.EntryPoint] | None = None) -> Finding:
    """Whether robots can be found and made."""
    points = list(metadata.entry_points(group="legged.bodies")) if found is None else found
    broken = []
    for point in points:
        try:
            point.load()
        except (ImportError, AttributeError) as error:
            broken.append(f"{point.name} of {point.value}: {error}")
    missing = [name for name in ROBOTS if name not in {point.name for point in points}]
    if broken or missing:
        text = "; ".join([*broken, *([f"not found: {', '.join(missing)}"] if missing else [])])
        return Finding("robots", "fail", text, "pip install legged-morphgen (in a checkout: make install)")
    return Finding("robots", "ok", ", ".join(sorted(point.name for point in points)))


def check_policies(policies: Mapping[str, Path] | None = None) -> list[Finding]:
    """Whether the shipped policies can be read and are those that their provenance tells of."""
    policies = shipped_policies() if policies is None else policies
    remedy = "install legged-codesign again (in a checkout: git checkout the file)"
    if not policies:
        return [Finding("policies", "fail", "none ships with this installation", remedy)]
    wrong = []
    for name, path in policies.items():
        try:
            told = json.loads((path.parent / "provenance.json").read_text(encoding="utf-8"))["samples"]
            samples = load_policy(path).card.samples
            problem = "" if samples == told else f"was trained on {samples} samples, its provenance says {told}"
        except (CheckpointError, OSError, ValueError, KeyError) as error:
            problem = f"cannot be read: {error}"
        if problem:
            wrong.append(Finding("policies", "fail", f"{name} {problem}", remedy))
    return wrong or [Finding("policies", "ok", ", ".join(policies) + " can be read")]


def _requirements() -> list[tuple[str, str]]:
    return [(owner, text) for owner in PACKAGES for text in metadata.requires(owner) or ()]


def _applies(requirement: Requirement) -> bool:
    """Whether a requirement holds here without any extra."""
    return requirement.marker is None or requirement.marker.evaluate({"extra": ""})


def _of_extra(requirement: Requirement, extra: str) -> bool:
    return (
        not _applies(requirement) and requirement.marker is not None and requirement.marker.evaluate({"extra": extra})
    )


def _met(requirement: Requirement, installed: Versions) -> bool:
    found = _version(requirement.name, installed)
    return found is not None and requirement.specifier.contains(found, prereleases=True)


def _version(name: str, installed: Versions) -> str | None:
    try:
        return installed(name)
    except metadata.PackageNotFoundError:
        return None
