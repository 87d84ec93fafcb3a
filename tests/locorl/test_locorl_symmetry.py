"""Left-right mirror images: by hand, twice, in the simulator, and of robots that have none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from locorl import TASKS, LeggedEnv, ObservationConfig, ScanConfig, TaskConfig, make_task
from locorl.bodies.pairs import mirror_pairs
from locorl.env.observation import PROPRIO
from locorl.env.scan import HeightScan
from locorl.env.symmetry import Symmetry
from locorl.terrain.heights import HeightGrid
from locorl_box import BoxQuadruped, Space, box_spec
from locorl_twin import HIPS_TURN, everything, largest_differences, twin

BY_HAND = {
    "base_angular_velocity": [-1, 2, -3],
    "projected_gravity": [1, -2, 3],
    "roll_pitch": [-1, 2],
    "heading_error": [-1],
    "next_heading_error": [-1],
    "command": [1, -2, -3],
    "commanded_speed": [1],
    "joint_position_error": [-4, 5, 6, -1, 2, 3, -10, 11, 12, -7, 8, 9],
    "joint_velocity": [-4, 5, 6, -1, 2, 3, -10, 11, 12, -7, 8, 9],
    "last_action": [-4, 5, 6, -1, 2, 3, -10, 11, 12, -7, 8, 9],
    "foot_contact": [2, 1, 4, 3],
    "base_linear_velocity": [1, -2, 3],
    "design": [1, 2, 3, 4],
    "mass_ratio": [1],
    "centre_of_mass": [1, -2, 3],
    "stance_height": [1],
    "friction": [1],
    "joint_damping": [1],
    "payload": [1],
    "motor_strength": [4, 5, 6, 1, 2, 3, 10, 11, 12, 7, 8, 9],
    "motor_damping": [4, 5, 6, 1, 2, 3, 10, 11, 12, 7, 8, 9],
    # two rows of three points, right, middle, left
    "heights": [3, 2, 1, 6, 5, 4],
}
"""What becomes of the numbers 1, 2, 3, ... in each term of the box quadruped."""


class Changed(BoxQuadruped):
    """The quadruped of boxes with a change to its model."""

    def __init__(self, change: Callable[[mujoco.MjSpec], None]) -> None:
        super().__init__()
        self.change = change

    def compiled(self, design: np.ndarray, scene: mujoco.MjSpec | None = None) -> mujoco.MjModel:
        spec = box_spec(np.asarray(design, dtype=float), scene)
        self.change(spec)
        return spec.compile()


class Sided(BoxQuadruped):
    """Longer front or hind thighs, and heavier thighs on either side."""

    def __init__(self, starboard: float = 1.0, low: float = 0.6) -> None:
        super().__init__()
        names = ("front", "port", "hind", "starboard")
        self.space = Space(names, low=np.array([0.6, 0.6, 0.6, low]))
        self.starboard = starboard

    def compiled(self, design: np.ndarray, scene: mujoco.MjSpec | None = None) -> mujoco.MjModel:
        front, port, hind, starboard = design
        spec = box_spec(np.array([front, 1.0, hind, 1.0]), scene)
        for leg in "FR":
            spec.geom(f"{leg}L_thigh").mass *= port
            spec.geom(f"{leg}R_thigh").mass *= starboard**self.starboard
        return spec.compile()


@pytest.fixture(scope="module")
def env(factory, designs) -> LeggedEnv:
    task = everything(history=2)
    scan = ScanConfig(forward=(0.0, 0.2), sideways=(-0.2, 0.2), spacing=0.2)
    return LeggedEnv(factory, designs, replace(task, observation=replace(task.observation, scan=scan)), threads=1)


@pytest.fixture(scope="module")
def symmetry(env) -> Symmetry:
    return Symmetry.of(env)


def test_every_term_is_mirrored_as_by_hand(env, symmetry):
    for group in ("proprio", "explicit", "implicit", "scan"):
        terms = env.layout.groups[group]
        obs = torch.cat([torch.arange(1.0, term.size + 1) for term in terms])
        expected = torch.cat([torch.tensor(BY_HAND[term.name], dtype=torch.float32) for term in terms])
        assert torch.equal(symmetry.observation({group: obs[None]})[group], expected[None])
    assert set(PROPRIO) < set(BY_HAND)
    assert symmetry.action(torch.arange(1.0, 13.0)[None]).flatten().tolist() == BY_HAND["last_action"]


def test_every_frame_of_the_history_is_mirrored_as_proprio(env, symmetry):
    frames = torch.randn(5, 2, env.group_dims["proprio"], generator=torch.Generator().manual_seed(0))
    image = symmetry.observation({"history": frames.flatten(1)})["history"].view_as(frames)
    for age in range(2):
        assert torch.equal(image[:, age], symmetry.observation({"proprio": frames[:, age]})["proprio"])


@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(1, 5))
def test_the_image_of_the_image_is_the_original(env, symmetry, seed, rows):
    generator = torch.Generator().manual_seed(seed)
    obs = {group: torch.randn(rows, size, generator=generator) for group, size in env.group_dims.items()}
    kept = {group: values.clone() for group, values in obs.items()}
    image = symmetry.observation(obs)
    assert list(image) == list(obs)
    for group, values in symmetry.observation(image).items():
        assert torch.equal(values, obs[group])
        assert torch.equal(obs[group], kept[group])
    action = torch.randn(rows, 12, generator=generator)
    assert torch.equal(symmetry.action(symmetry.action(action)), action)


@given(y=st.floats(-1.0, 1.0), yaw=st.floats(-3.0, 3.0), slope=st.floats(-0.3, 0.3), bend=st.floats(-0.1, 0.1))
def test_a_mirrored_robot_scans_the_mirrored_ground(env, symmetry, y, yaw, slope, bend):
    x, across = np.meshgrid(np.linspace(-3, 3, 601), np.linspace(-3, 3, 601), indexing="ij")
    config, height = env.observer.scanner.config, torch.tensor([0.3])
    scans = []
    for side in (1.0, -1.0):
        ground = HeightGrid(slope * side * across + bend * x * side * across + 0.1 * x, (-3.0, -3.0), cell=0.01)
        where = torch.tensor([[0.2, side * y, 0.4]])
        scans.append(HeightScan(config, ground).measure(where, torch.tensor([side * yaw]), height))
    # points fall onto nodes 1 cm apart
    torch.testing.assert_close(scans[1], symmetry.observation({"scan": scans[0]})["scan"], atol=0.02, rtol=0.0)


def same_axes(_: mujoco.MjSpec) -> None:
    """Left and right hips turn about the same axis."""


def opposite_axes(spec: mujoco.MjSpec) -> None:
    """Hips that swing both legs outwards at positive angles."""
    for leg in ("FR", "RR"):
        spec.joint(f"{leg}_hip_joint").axis = [-1, 0, 0]


@pytest.mark.parametrize(("change", "sign"), [(same_axes, HIPS_TURN), (opposite_axes, torch.ones(12))])
def test_the_image_of_a_robot_moves_as_the_image_of_its_motion(designs, change, sign):
    env = LeggedEnv(Changed(change), designs, everything(), seed=3, threads=1)
    env.reset()
    image = twin(env, sign)
    for name, gap in largest_differences(env, image, steps=8).items():
        assert gap < 1e-5, name
    # not because nothing differs between left and right
    assert largest_differences(env, twin(env, -sign), steps=4)["joint_position_error"] > 0.1


@pytest.mark.parametrize("preset", ["laptop", "paper"])
@pytest.mark.parametrize("name", TASKS)
def test_every_task_has_a_mirror_image(factory, designs, name, preset):
    env = LeggedEnv(factory, designs[:2], make_task(name, preset), threads=1)
    obs = env.reset()
    symmetry = Symmetry.of(env)
    assert set(symmetry.groups) == set(env.group_dims)
    for group, values in symmetry.observation(symmetry.observation(obs)).items():
        assert torch.equal(values, obs[group])


def heavier_thigh(spec: mujoco.MjSpec) -> None:
    spec.geom("FL_thigh").mass = 0.9


def trunk_to_the_left(spec: mujoco.MjSpec) -> None:
    spec.geom("base").pos = [0.01, 0.01, 0.0]


def displaced_knee(spec: mujoco.MjSpec) -> None:
    spec.body("RR_calf").pos += [0.01, 0.0, 0.0]


def displaced_foot(spec: mujoco.MjSpec) -> None:
    spec.site("FR_foot").pos += [0.0, 0.01, 0.0]


def slanted_axis(spec: mujoco.MjSpec) -> None:
    spec.joint("FL_thigh_joint").axis = [0.0, 1.0, 0.1]


def stiff_knee(spec: mujoco.MjSpec) -> None:
    spec.joint("RL_calf_joint").damping = [0.2, 0.0, 0.0]


def narrow_hip(spec: mujoco.MjSpec) -> None:
    for leg in ("FL", "FR", "RL", "RR"):
        spec.joint(f"{leg}_hip_joint").range = [-40.0, 20.0]  # degrees


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (heavier_thigh, "mass of link 'FL_thigh' .* are 0.111 of the larger one apart"),
        (trunk_to_the_left, "centre of mass of link 'base'"),
        (displaced_knee, "place of joint 'RL_calf_joint'"),
        (displaced_foot, "place of foot 'FL_foot'"),
        (slanted_axis, "axis of joint 'FL_thigh_joint'"),
        (stiff_knee, "drive of joint 'RL_calf_joint' .* are 0.5 of the larger one apart"),
        (narrow_hip, "range about the stance of joint 'FL_hip_joint' .*are 0.494 rad apart"),
    ],
)
def test_a_robot_whose_sides_differ_is_refused(change, message):
    with pytest.raises(ValueError, match=f"^box: left and right differ: {message}"):
        mirror_pairs(Changed(change))


def test_sides_may_differ_as_little_as_built_robots_do():
    def tolerances(spec: mujoco.MjSpec) -> None:
        spec.geom("FL_thigh").mass = 0.81
        spec.geom("RR_hip").pos = [0.003, 0.005, 0.0]
        spec.body("RR_calf").pos += [0.001, 0.0, 0.0]

    assert mirror_pairs(Changed(tolerances)).foot.tolist() == [1, 0, 3, 2]


def test_design_parameters_of_one_side_are_paired_with_those_of_the_other():
    assert mirror_pairs(Sided()).design.tolist() == [0, 3, 2, 1]
    with pytest.raises(ValueError, match="design parameter 'port' acts on left and right differently"):
        mirror_pairs(Sided(starboard=0.0))
    with pytest.raises(
        ValueError, match="design parameters 'port' and 'starboard' are mirror images, but their bounds"
    ):
        mirror_pairs(Sided(low=0.7))


def test_a_scan_that_sees_more_to_one_side_is_refused(factory, designs):
    observation = ObservationConfig(scan=ScanConfig(sideways=(-0.3, 0.45)))
    env = LeggedEnv(factory, designs, TaskConfig(observation=observation), threads=1)
    with pytest.raises(ValueError, match=r"sideways \(-0.3, 0.45\) every 0.15 m is not the same .*make it \(-w, w\)"):
        Symmetry.of(env)


def test_a_term_without_a_rule_is_refused(env):
    layout = replace(env.layout, explicit=(replace(env.layout.explicit[0], name="smell"),))
    other = SimpleNamespace(factory=env.factory, observer=env.observer, device=env.device, layout=layout)
    with pytest.raises(ValueError, match="no mirror image for the 3 columns of term 'smell'"):
        Symmetry.of(other)
