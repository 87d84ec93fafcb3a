"""When images are taken in and used, what is forgotten, and that training lives through what acting did."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from distill import (
    AdaptationConfig,
    DepthEncoderConfig,
    InterfaceError,
    VisionPolicy,
    VisionStudentConfig,
    build_vision_student,
)
from distill.vision import Convolution, DepthEncoder, Perception
from distill.vision.collect import VisionCollector
from distill.vision.depth_encoder import contrast
from distill.vision.unroll import unroll
from hypothesis import given
from hypothesis import strategies as st
from vision_toy import HEADING, PROPRIO, TERRAIN, VisionToy, VisionToyTeacher

DEPTH = DepthEncoderConfig((Convolution(4, 3, stride=2),), image_hidden=12, image_features=8, fusion=(12,), memory=10)
CONFIG = VisionStudentConfig(
    depth=DEPTH, adaptation=AdaptationConfig(history=4, frame_features=8, channels=(8,), features=8, estimator=(8,))
)


def make(config: VisionStudentConfig = CONFIG, num_envs: int = 4, seed: int = 1):
    torch.manual_seed(seed)
    return build_vision_student(VisionToy(num_envs), VisionToyTeacher(), config)


# -------------------------------------------------------------------------------------------------- network


def test_the_large_encoder_has_the_sizes_of_the_reference():
    encoder = DepthEncoder((58, 87), 53, 32, 2, 1.5, DepthEncoderConfig.large())
    widths = [layer.in_features for layer in encoder.image if isinstance(layer, torch.nn.Linear)]
    assert widths == [64 * 25 * 39, 128]
    assert encoder.gru.hidden_size == 512
    terrain, heading, memory = encoder.recall(
        encoder.features(torch.zeros(2, 58, 87)), torch.zeros(2, 53), torch.zeros(2, 512)
    )
    assert (terrain.shape, heading.shape, memory.shape) == ((2, 32), (2, 2), (2, 512))


@given(st.floats(-0.03, 0.03), st.floats(-0.01, 0.01), st.floats(1.7, 3.0))
def test_planes_have_no_contrast_and_a_low_step_has(down, right, middle):
    """Inverse depth of a plane is affine in the image, which a camera model tells without rays."""
    rows, columns = torch.meshgrid(torch.arange(24.0) - 11.5, torch.arange(36.0) - 17.5, indexing="ij")
    plane = 1.0 / (middle + down * rows + right * columns)  # a share of the farthest depth, 0.4 to 1
    flat = contrast((plane - 0.5)[None, None])[0, 0, 1:-1, 3:-3]
    torch.testing.assert_close(flat, torch.zeros_like(flat), rtol=0, atol=1e-4)
    step = plane.clone()
    step[10:12, 8:20] *= 0.95  # nearer by a twentieth
    edges = contrast((step - 0.5)[None, None])[0, 0].abs()
    assert edges[10:12, 8:20].min() > 0.5
    assert edges[14:-1, 24:-3].max() < 1e-4


def test_contrast_is_the_difference_from_what_pooling_says():
    image = torch.rand(2, 1, 24, 36) - 0.5
    inverse = (image + 0.5).clamp(min=0.1).reciprocal()
    around = torch.nn.functional.avg_pool2d(inverse, (3, 7), 1, (1, 3), count_include_pad=False)
    torch.testing.assert_close(contrast(image), (30.0 * (inverse - around)).clamp(-3.0, 3.0), rtol=0, atol=2e-4)


def test_contrast_of_what_is_too_near_or_too_far_is_bounded():
    image = torch.rand(1, 1, 24, 36).round() - 0.5
    assert contrast(image).abs().max() == 3.0
    assert not contrast(torch.full((1, 1, 24, 36), 0.5)).any()


def test_headings_and_terrain_stay_in_range():
    encoder = DepthEncoder((8, 12), 5, 4, 2, 1.5, DEPTH)
    with torch.no_grad():
        encoder.head.weight.mul_(1e3)
        terrain, heading, _ = encoder.recall(100.0 * torch.randn(50, 8), torch.randn(50, 5), torch.randn(50, 10))
    assert 1.4 < heading.abs().max() <= 1.5
    assert 0.9 < terrain.abs().max() <= 1.0


def test_a_broken_image_reads_as_nothing_and_leaves_the_memory_finite():
    student = make()
    image = torch.full((1, 8, 12), 0.5)
    broken = image.clone()
    broken[0, 2:4] = float("nan")
    broken[0, 5] = float("inf")
    assert torch.equal(student.features(broken), student.features(image))
    assert torch.equal(student.features(torch.full_like(image, -3.0)), student.features(torch.full_like(image, -0.5)))


def test_a_blind_student_sees_no_difference():
    seeing, blind = make(), make(replace(CONFIG, blind=True))
    images = torch.rand(2, 8, 12) - 0.5
    assert not torch.allclose(*seeing.features(images))
    assert torch.equal(*blind.features(images))
    assert torch.equal(blind.features(images), seeing.features(torch.full((2, 8, 12), 0.5)))


def test_an_image_that_is_too_small_is_refused():
    with pytest.raises(InterfaceError, match="images of 8 x 12 pixels are too small"):
        DepthEncoder((8, 12), 5, 4, 2, 1.5, DepthEncoderConfig((Convolution(4, 5), Convolution(4, 5))))


# --------------------------------------------------------------------------------------------------- timing


class Numbered:
    """Stands in for a student: terrain and heading are the number of the image, memory counts images."""

    def __init__(self, period: int, latency: int) -> None:
        self.depth_period, self.headings = period, 1
        self.config = replace(CONFIG, latency=latency, terrain_dim=1)
        self.depth_encoder = type("Encoder", (), {"memory": 1})()

    def see(self, features, proprio, memory):
        return features, features, memory + 1.0


@given(st.integers(1, 6), st.integers(0, 13), st.integers(20, 40))
def test_an_image_is_used_from_its_latency_on_until_the_next_one_is(period, latency, ticks):
    perception = Perception(Numbered(period, latency), 1)
    for tick in range(ticks):
        assert perception.due == (tick % period == 0)
        percept = perception.step(torch.full((1, 1), float(tick)), torch.zeros(1, 1))
        taken = [image for image in range(0, tick + 1, period) if image + latency <= tick]
        assert percept.seen.item() == bool(taken)
        assert percept.terrain.item() == percept.heading.item() == (taken[-1] if taken else 0.0)


@given(st.data())
def test_a_restarted_robot_sees_no_image_of_its_past(data):
    """Whatever is in use was taken in after the robot's last restart, and memory counts images since."""
    period, latency = data.draw(st.integers(1, 5)), data.draw(st.integers(0, 8))
    dones = data.draw(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=15, max_size=30))
    perception, began, images = Perception(Numbered(period, latency), 2), [0, 0], [0, 0]
    for tick, done in enumerate(dones):
        due = perception.due
        percept = perception.step(torch.full((2, 1), float(tick)), torch.zeros(2, 1))
        for robot in range(2):
            images[robot] += due
            taken = [t for t in range(0, tick + 1, period) if t >= began[robot] and t + latency <= tick]
            assert bool(percept.seen[robot]) == bool(taken)
            assert percept.terrain[robot].item() == (taken[-1] if taken else 0.0)
            assert perception.state().memory[robot].item() == images[robot]
            if done[robot]:
                began[robot], images[robot] = tick + 1, 0
        perception.reset(torch.tensor(done))


def test_an_image_that_is_due_must_be_given():
    with pytest.raises(ValueError, match=r"check Perception\.due"):
        Perception(make(), 4).step(None, torch.zeros(4, PROPRIO))


# --------------------------------------------------------------------------------- acting and living again


def collect(student, env, steps: int, rollouts: int = 1, mts: bool = True):
    collector = VisionCollector(env, VisionToyTeacher(), student, 0.6, mts, scan_latent=True)
    collector.restart(seed=5)
    return [collector.rollout(steps) for _ in range(rollouts)]


class Recording(VisionToy):
    """Remembers the actions that it was given."""

    def step(self, action):
        self.__dict__.setdefault("actions", []).append(action.clone())
        return super().step(action)


@pytest.mark.parametrize("mts", [True, False])
@pytest.mark.parametrize("latency", [0, 3, 5, 12])
def test_living_again_gives_the_actions_that_were_taken(latency, mts):
    """The second rollout begins with memories, images under way and robots in mid-episode."""
    student, env = make(replace(CONFIG, latency=latency), 6), Recording(6, episode=13)
    sequences = [sequence for sequence, _ in collect(student, env, 20, rollouts=2, mts=mts)]
    taken = torch.stack(env.actions).unflatten(0, (2, 20))
    for sequence, actions in zip(sequences, taken, strict=True):
        assert sequence.first.sum() >= 6
        found = unroll(student, sequence, 0.6 if mts else None)
        torch.testing.assert_close(found.action, actions, atol=1e-5, rtol=0)
        part = torch.tensor([4, 1])
        torch.testing.assert_close(
            unroll(student, sequence.rows(part), 0.6 if mts else None).action, actions[:, part], atol=1e-5, rtol=0
        )


def test_gradients_reach_the_images_before_but_none_of_another_episode():
    student, env = make(replace(CONFIG, latency=0), 2), VisionToy(2)
    ((sequence, _),) = collect(student, env, 20)
    first = torch.zeros(20, 2, dtype=torch.bool)
    first[0] = True
    first[7, 0] = True  # the first robot restarts between the images of ticks 5 and 10
    depth = sequence.depth.clone().requires_grad_(True)
    found = unroll(student, replace(sequence, depth=depth, first=first), 0.6)
    found.terrain[12].square().sum().backward()
    reached = depth.grad.abs().sum(dim=(2, 3)) > 0  # images of ticks 0, 5, 10, 15
    assert reached[:, 0].tolist() == [False, False, True, False]
    assert reached[:, 1].tolist() == [True, True, True, False]


def test_the_actions_do_not_bend_heading_and_velocity():
    student, env = make(replace(CONFIG, latency=0), 2), VisionToy(2)
    ((sequence, _),) = collect(student, env, 10)
    unroll(student, sequence, None).action.square().sum().backward()
    head = student.depth_encoder.head.weight.grad
    assert head[:TERRAIN].abs().sum() > 0
    assert not head[TERRAIN:].any()
    assert student.adaptation.estimator[0].weight.grad is None
    assert student.adaptation.encoder[1].weight.grad.abs().sum() > 0


def test_a_policy_forgets_on_done_and_never_reads_the_oracle():
    class Cheating(VisionToy):
        def observe(self):
            obs = super().observe()
            obs["proprio"][:, HEADING] = 9.0
            return obs

    student = make(num_envs=3)
    actions = []
    for env in (VisionToy(3, episode=7), Cheating(3, episode=7)):
        policy, obs = VisionPolicy(student, env), env.reset(seed=3)
        policy.reset()
        actions.append([])
        for _ in range(30):
            action = policy.act(obs)
            assert policy.velocity.shape == (3, 3)
            assert policy.heading.shape == (3, 2)
            actions[-1].append(action)
            obs, _, terminated, truncated, _ = env.step(action)
            policy.reset(terminated | truncated)
    assert torch.equal(torch.stack(actions[0]), torch.stack(actions[1]))


def test_a_fresh_policy_and_one_that_was_reset_act_alike():
    env, student = VisionToy(2, episode=100), make(num_envs=2)
    used, fresh = VisionPolicy(student, env), VisionPolicy(student, env)
    obs = env.reset(seed=3)
    for _ in range(10):
        obs = env.step(used.act(obs))[0]
    used.reset(torch.tensor([True, False]))
    for tick in range(12):
        mine, theirs = used.act(obs), fresh.act(obs)
        torch.testing.assert_close(mine[0], theirs[0], atol=1e-6, rtol=0)
        assert not torch.allclose(mine[1], theirs[1], atol=1e-4) or tick < 1
        obs = env.step(mine)[0]


def test_another_camera_is_refused():
    env = VisionToy(2)
    env.depth_period = 4
    with pytest.raises(InterfaceError, match="made for depth_period 5, this environment has 4"):
        VisionPolicy(make(), env)
