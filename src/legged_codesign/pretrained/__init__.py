"""What ships with the project, a folder each: generalists with their evaluation, students with teacher and bundle."""

from __future__ import annotations

from pathlib import Path

_HERE = Path(__file__).parent


def shipped_policies() -> dict[str, Path]:
    """Path of each shipped policy by its name, such as `go2-rough`."""
    return {path.parent.name: path for path in sorted(_HERE.glob("*/policy.pt"))}


def shipped_policy(robot: str, task: str = "flat") -> Path:
    """Path of the generalist shipped for a robot and a task.

    Raises:
        FileNotFoundError: there is none; pre-train with `--from-scratch`.
    """
    path = _HERE / f"{robot}-{task}" / "policy.pt"
    if not path.is_file():
        known = ", ".join(shipped_policies()) or "none"
        raise FileNotFoundError(
            f"no generalist ships for robot '{robot}' and task '{task}' (there is: {known}); "
            "train one with codesign run --from-scratch"
        )
    return path


def shipped(policy: str) -> Path:
    """Path of a policy that is given by the name of a shipped folder, such as `go2-rough`, or by its own path.

    Raises:
        FileNotFoundError: there is neither.
    """
    for path in (_HERE / policy / "policy.pt", Path(policy)):
        if path.is_file():
            return path
    known = ", ".join(shipped_policies()) or "none"
    raise FileNotFoundError(f"no policy '{policy}': give the path of one, or a shipped one (there is: {known})")


def shipped_bundle(student: str) -> Path:
    """Bundle of a shipped student, such as `go2-blind`.

    Raises:
        FileNotFoundError: there is none; `codesign student` makes one.
    """
    path = _HERE / student / "bundle"
    if not path.is_dir():
        known = ", ".join(each.parent.name for each in sorted(_HERE.glob("*/bundle"))) or "none"
        raise FileNotFoundError(f"no student '{student}' ships (there is: {known}); codesign student makes one")
    return path
