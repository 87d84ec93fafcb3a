"""A robot given as the path of a URDF: name of the run, binding of the folder, errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import locorl.providers
import numpy as np
import pytest
import trimesh
import yaml
from morphgen import BodyFactory, MorphologyError
from rich.console import Console

from legged_codesign import RunConfig, pipeline
from legged_codesign.commands.run import Run
from legged_codesign.robots import FileConfig, body_factory
from legged_codesign.run_folder import bind, read_config
from legged_codesign.stages import RunError

Codesign = Callable[..., tuple[int, str]]


class Opener:
    """The entry point that opens URDFs."""

    name = "urdf"

    def load(self) -> Callable[[Path], BodyFactory]:
        return lambda path: BodyFactory(path.stem, path.read_text(), source=str(path))


@pytest.fixture
def robot(go2: BodyFactory, design: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A relative path, seen from the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(locorl.providers, "entry_points", lambda group: [Opener()])
    Path("mine").mkdir()
    Path("mine/wolf.urdf").write_text(go2.urdf(design))
    return "mine/wolf.urdf"


def test_the_run_is_named_after_the_file(robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started = []

    def run(config: RunConfig, folder: Path, *_: object) -> None:
        started.append((config, folder))
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "run", run)
    for name in (robot, "go2"):
        with pytest.raises(KeyboardInterrupt):
            Run(preset="smoke", robot=name).run(Console())
    (mine, folder), (builtin, default) = started
    assert folder == Path("runs/smoke-wolf-flat-cost-of-transport")
    assert mine.robot == str(tmp_path / "mine/wolf.urdf")
    assert (builtin.robot, default) == ("go2", Path("runs/smoke-go2-flat-cost-of-transport"))


def test_the_factory_is_named_after_the_file(robot: str) -> None:
    assert body_factory(robot).name == "wolf"


def with_a_mesh(text: str) -> str:
    trimesh.creation.box((0.3762, 0.0935, 0.114)).export(Path("shapes/trunk.stl"))
    return text.replace('<box size="0.3762 0.0935 0.114"/>', '<mesh filename="trunk.stl"/>')


def with_an_impossible_inertia(text: str) -> str:
    return text.replace('iyy="0.098077"', 'iyy="0.98077"')


def with_an_arm(text: str) -> str:
    joint = '<joint name="arm_joint" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>'
    limit = '<limit lower="-1" upper="1" effort="9" velocity="9"/></joint>'
    inertia = '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>'
    link = f'<link name="arm"><inertial><mass value="0.5"/>{inertia}</inertial></link>'
    return text.replace("</robot>", f"{link}{joint}{limit}</robot>")


def without_a_limit(text: str) -> str:
    return text.replace('effort="23.7" ', "")


@pytest.mark.parametrize(
    ("spoil", "words", "options"),
    [
        (with_a_mesh, "--mesh-path", {"mesh_path": (Path("shapes"),)}),
        (with_an_impossible_inertia, "--repair", {"repair": True}),
        (with_an_arm, "lock", {"lock": ("arm_joint",)}),
        (without_a_limit, "--torque-limit", {"torque_limit": 23.7}),
    ],
)
def test_a_file_that_alone_does_not_say_enough(
    robot: str, tmp_path: Path, spoil: Callable[[str], str], words: str, options: dict[str, object]
) -> None:
    Path("shapes").mkdir()
    path, nominal = Path(robot), np.ones((1, 4))
    mass = body_factory(robot).batch(nominal).total_mass[0]
    text = spoil(path.read_text())
    assert text != path.read_text()
    path.write_text(text)
    with pytest.raises(MorphologyError, match=words):
        body_factory(robot).batch(nominal)
    config = Run(preset="smoke", robot=robot, **options).config()  # pyright: ignore[reportArgumentType]
    bind(tmp_path / "run", config)
    assert read_config(tmp_path / "run") == config  # also from another folder
    made = body_factory(config.robot, config.bodies).batch(nominal)
    assert made.total_mass[0] == pytest.approx(mass + 0.5 * ("lock" in options))
    np.testing.assert_allclose(made.torque_limit[0, :2], 23.7)


def test_servos_and_hips_of_a_file(robot: str) -> None:
    """The robot turned about the vertical by 180 degrees."""
    turned = ("RR_hip_joint", "RL_hip_joint", "FR_hip_joint", "FL_hip_joint")
    factory = body_factory(robot, Run(robot=robot, hips=turned, kp=55.0, kd=1.5).bodies)
    assert factory.layout.joints[::3] == turned
    batch = factory.batch(np.ones((1, 4)))
    assert (batch.kp[0, 0], batch.kd[0, 0]) == (55.0, 1.5)
    with pytest.raises(ValueError, match="names 3 joints; name one for each of FL, FR, RL, RR"):
        FileConfig(hips=("a", "b", "c"))


def test_an_installed_robot_is_opened_as_it_is() -> None:
    with pytest.raises(LookupError, match=r"'go2' is no file.*for the path of a \.urdf"):
        body_factory("go2", Run(repair=True).bodies)


def test_the_plan_tells_how_a_file_is_opened(robot: str, codesign: Codesign, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    code, output = codesign("run", "--preset", "smoke", "--robot", robot, "--kp", "55", "--repair", "--dry-run")
    assert code == 0, output
    shown = {line.split("│")[1].strip(): line.split("│")[2].strip() for line in output.splitlines() if "│" in line}
    assert (shown["bodies.file.kp"], shown["bodies.file.repair"], shown["body.kp"]) == ("55", "True", "55")


def test_a_changed_file_does_not_continue_a_run(robot: str, tmp_path: Path) -> None:
    config = Run(preset="smoke", robot=robot).config()
    bind(tmp_path / "run", config)
    bind(tmp_path / "run", config)
    assert read_config(tmp_path / "run") == config
    Path(robot).write_text(Path(robot).read_text().replace("<robot", "<!-- longer --><robot"))
    for use in (lambda: bind(tmp_path / "run", config), lambda: read_config(tmp_path / "run")):
        with pytest.raises(RunError, match=r"wolf\.urdf has changed since the run in .* began; restore it or choose"):
            use()


def test_a_folder_from_before_robot_files_still_opens(tmp_path: Path) -> None:
    config = Run(preset="smoke").config()
    bind(tmp_path, config)
    path = tmp_path / "config.yaml"
    content = yaml.safe_load(path.read_text())
    del content["robot_sha256"]
    path.write_text(yaml.safe_dump(content))
    assert read_config(tmp_path) == config


def test_errors(robot: str, codesign: Codesign, monkeypatch: pytest.MonkeyPatch) -> None:
    """A missing file, no generalist to start from, no package to open it; nothing is left behind."""
    cases = [("mine/fox.urdf", "no robot file"), (robot, "--from-scratch")]
    for name, words in cases:
        code, output = codesign("run", "--preset", "laptop", "--robot", name)
        assert code == 1, output
        assert words in output
        assert Path(name).name in output
    monkeypatch.setattr(locorl.providers, "entry_points", lambda group: [])
    code, output = codesign("run", "--preset", "laptop", "--robot", robot)
    assert code == 1
    assert "pip install legged-morphgen" in output
    assert not Path("runs").exists()
