"""Memory: the order of its frames, and when it is cleared."""

from __future__ import annotations

import pytest
import torch
from distill import Student, StudentConfig, StudentPolicy
from distill.history import HistoryBuffer, push
from distill.rollouts import RolloutRing
from hypothesis import given, settings
from hypothesis import strategies as st


def test_the_newest_frame_is_last():
    history = torch.zeros(1, 3, 1)
    for value in (1.0, 2.0, 3.0, 4.0):
        history = push(history, torch.tensor([[value]]))
    assert history.flatten().tolist() == [2.0, 3.0, 4.0]


def test_a_reset_clears_only_the_robots_that_are_done():
    buffer = HistoryBuffer(3, 2, 1)
    buffer.update(torch.ones(3, 2, 1))
    buffer.reset(torch.tensor([False, True, False]))
    assert buffer.frames[:, :, 0].tolist() == [[1, 1], [0, 0], [1, 1]]
    buffer.reset()
    assert not buffer.frames.any()


def test_a_frame_that_is_not_finite_does_not_outlive_its_episode():
    buffer = HistoryBuffer(2, 2, 1)
    buffer.update(torch.tensor([[[float("nan")], [1.0]], [[1.0], [1.0]]]))
    buffer.reset(torch.tensor([True, False]))
    assert buffer.frames[:, :, 0].tolist() == [[0, 0], [1, 1]]


@settings(deadline=None, max_examples=40)
@given(
    history=st.integers(1, 5),
    capacity=st.integers(1, 7),
    dones=st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=30),
)
def test_the_ring_gives_the_histories_that_the_student_had(history, capacity, dones):
    """Cut out of the ring, every sample sees exactly what the acting student saw, resets included."""
    ring = RolloutRing(capacity, 2, history, {"proprio": 2}, "cpu")
    buffer, age = HistoryBuffer(2, history, 2), torch.zeros(2, dtype=torch.int64)
    seen = []
    for step, done in enumerate(torch.tensor(dones)):
        obs = torch.tensor([[step + 1.0, 0.0], [step + 1.0, 1.0]])
        ring.add({"proprio": obs}, age)
        buffer.update(push(buffer.frames, obs))
        seen.append(buffer.frames.clone())
        buffer.reset(done)
        age = torch.where(done, 0, age + 1)
    assert len(ring) == 2 * min(capacity, len(dones))
    for step in range(max(0, len(dones) - capacity), len(dones)):
        sample = ring.at(torch.tensor([step, step]), torch.tensor([0, 1]))
        assert torch.equal(sample["history"], seen[step])


def test_samples_come_from_the_last_rollouts_of_all_robots():
    ring = RolloutRing(4, 3, 2, {"proprio": 1, "robot": 1}, "cpu")
    for step in range(10):
        ring.add(
            {"proprio": torch.full((3, 1), float(step)), "robot": torch.arange(3.0)[:, None]}, torch.full((3,), step)
        )
    samples = ring.sample(400)
    assert set(samples["proprio"].flatten().tolist()) == {6.0, 7.0, 8.0, 9.0}
    assert set(samples["robot"].flatten().tolist()) == {0.0, 1.0, 2.0}
    assert torch.equal(samples["history"][:, 0], samples["proprio"] - 1.0)


def test_the_network_returns_the_history_that_it_acted_on(student):
    obs, history = torch.randn(4, 45), torch.randn(4, 12, 45)
    action, velocity, after = student(obs, history)
    assert torch.equal(after[:, :-1], history[:, 1:])
    assert torch.equal(after[:, -1], obs)
    inferred = student.infer(after)
    assert torch.equal(action, inferred.action)
    assert torch.equal(velocity, inferred.velocity)


@pytest.mark.parametrize("length", [1, 2, 3, 4, 7, 20])
def test_every_frame_of_the_history_reaches_the_action(length):
    torch.manual_seed(length)
    student = Student(5, StudentConfig(history=length))
    history = torch.randn(2, length, 5, requires_grad=True)
    student.infer(history).action.square().sum().backward()
    assert history.grad is not None
    reached = history.grad.abs().sum(dim=(0, 2)) > 0
    assert reached.all()


def test_the_velocity_estimate_is_not_bent_by_the_action_loss(student):
    student.zero_grad()
    student.infer(torch.randn(4, 12, 45)).action.square().mean().backward()
    assert student.velocity.weight.grad is None
    assert student.latent.weight.grad.abs().sum() > 0
    student.zero_grad()


def test_the_policy_forgets_on_done(student):
    policy = StudentPolicy(student, 2)
    obs = {"proprio": torch.randn(1, 45).repeat(2, 1)}
    first = policy.act(obs)
    second = policy.act(obs)
    assert torch.equal(first[0], first[1])
    assert not torch.equal(first, second)
    policy.reset(torch.tensor([True, False]))
    third = policy.act(obs)
    torch.testing.assert_close(third[0], first[0])
    assert not torch.allclose(third[1], first[1])
    assert policy.velocity.shape == (2, 3)
