"""Estimator and history encoder: what they read, how they learn in another's rollouts, and how that goes on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest
import torch
from distill import (
    AdaptationConfig,
    AdaptationModule,
    AdaptedTeacher,
    CheckpointError,
    InterfaceError,
    RegularisedAdaptation,
    RoaSchedule,
    VelocityEstimation,
    build_adaptation,
    load_adaptation,
    save_adaptation,
)
from distill.adaptation import FitConfig, linear_probe
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor, nn
from vision_toy import HEADING, PROPRIO, WIDTH, BlindToyTeacher, VisionToy, VisionToyTeacher

BLANK = tuple(range(HEADING.start, HEADING.stop))
SMALL = AdaptationConfig(history=4, frame_features=24, channels=(24,), features=32, estimator=())
FIT = FitConfig(learning_rate=5e-3, epochs=4, minibatches=8)


@dataclass
class Rollout:
    """T steps of N robots."""

    obs: dict[str, Tensor]


def make(config: AdaptationConfig = SMALL, seed: int = 3) -> AdaptationModule:
    torch.manual_seed(seed)
    return build_adaptation(PROPRIO, VisionToyTeacher(), config, BLANK)


def roll(env: VisionToy, hooks, teacher, obs, steps: int = 24):
    """A rollout as PPO makes it: the truth is kept, the actor sees what the hooks show."""
    kept: dict[str, list[Tensor]] = {group: [] for group in env.group_dims}
    with torch.no_grad():
        for _ in range(steps):
            for group, values in kept.items():
                values.append(obs[group])
            seen = obs
            for hook in hooks:
                seen = hook.observe(seen)
            parts = (seen["proprio"], seen["scan"], seen["explicit"], seen.get("latent", teacher.latent(seen)))
            obs = env.step(teacher.actor(torch.cat(parts, dim=1)))[0]
    return Rollout({group: torch.stack(values) for group, values in kept.items()}), obs


# ------------------------------------------------------------------------------------------------- networks


def test_the_window_is_the_past_and_the_present_with_the_headings_blank():
    adaptation = make()
    obs = {"proprio": torch.full((2, PROPRIO), 4.0), "history": torch.arange(1.0, 4.0).repeat_interleave(PROPRIO)}
    obs["history"] = obs["history"].expand(2, -1)
    window = adaptation.window(obs)
    assert window.shape == (2, 4, PROPRIO)
    assert window[0, :, 0].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert not window[:, :, HEADING].any()
    assert window[:, :, : HEADING.start].all()


def test_the_students_own_window_is_the_environments():
    """Both fill the past of a new episode with its first frame, whenever a robot restarts."""
    env, adaptation = VisionToy(8, episode=7, history=3), make()
    obs, history = env.reset(seed=0), torch.zeros(8, 4, PROPRIO)
    restarted = 0
    for _ in range(20):
        history = adaptation.push(history, obs["proprio"])
        torch.testing.assert_close(history, adaptation.window(obs), rtol=0, atol=0)
        obs, _, terminated, truncated, _ = env.step(0.1 * env.randn(WIDTH))
        done = terminated | truncated
        restarted += int(done.sum())
        history = history.masked_fill(done[:, None, None], 0.0)
    assert restarted > 8


def test_neither_reads_the_headings():
    adaptation = make()
    proprio, window = torch.randn(3, PROPRIO), torch.randn(3, 3, PROPRIO).flatten(1)
    other = proprio.clone()
    other[:, HEADING] += 1.0
    one, two, changed = (
        adaptation.window({"proprio": each, "history": window}) for each in (proprio, other, proprio + 1.0)
    )
    assert torch.equal(adaptation.velocity(one), adaptation.velocity(two))
    assert torch.equal(adaptation.latent(one), adaptation.latent(two))
    assert not torch.equal(adaptation.velocity(one), adaptation.velocity(changed))


@pytest.mark.parametrize(("frames", "read"), [(None, 4), (1, 1), (3, 3)])
def test_the_estimator_reads_the_newest_frames(frames, read):
    config = AdaptationConfig(history=4, estimator=(8,), estimator_frames=frames)
    adaptation, window = AdaptationModule(PROPRIO, 3, config), torch.randn(2, 4, PROPRIO)
    estimate = adaptation.velocity(window)
    for age in range(4):
        other = window.clone()
        other[:, 3 - age] += 1.0
        assert torch.equal(estimate, adaptation.velocity(other)) == (age >= read)


def test_an_estimator_cannot_read_more_frames_than_there_are():
    with pytest.raises(ValueError, match="estimator_frames is 5; expected 1 to history, 4"):
        AdaptationConfig(history=4, estimator_frames=5)


def test_latents_of_many_windows_are_those_of_each():
    adaptation = make()
    windows = torch.randn(5, 6, 4, PROPRIO)
    latent = adaptation.latent(windows)
    assert latent.shape == (5, 6, WIDTH)
    torch.testing.assert_close(latent[2, 3], adaptation.latent(windows[2, 3:4])[0])


def test_a_history_of_another_length_is_refused():
    with pytest.raises(InterfaceError, match=r"'history' is 76 wide, expected 3 past frames of 38"):
        make().window({"proprio": torch.zeros(1, PROPRIO), "history": torch.zeros(1, 2 * PROPRIO)})
    with pytest.raises(InterfaceError, match="is 0 wide"):
        make().window({"proprio": torch.zeros(1, PROPRIO)})


def test_a_teacher_without_latent_and_columns_that_do_not_exist_are_refused():
    with pytest.raises(InterfaceError, match=r"no privileged latent.*roa=False"):
        build_adaptation(PROPRIO, BlindToyTeacher())
    with pytest.raises(InterfaceError, match=r"columns \[38\]"):
        build_adaptation(PROPRIO, VisionToyTeacher(), blank=(PROPRIO,))
    with pytest.raises(ValueError, match="history is 0"):
        AdaptationConfig(history=0)


def test_both_are_read_back_from_a_file(tmp_path):
    adaptation = make()
    save_adaptation(tmp_path / "adaptation.pt", adaptation)
    loaded = load_adaptation(tmp_path / "adaptation.pt")
    assert (loaded.config, loaded.blank) == (adaptation.config, BLANK)
    windows = torch.randn(2, 4, PROPRIO)
    assert torch.equal(loaded.latent(windows), adaptation.latent(windows))
    assert torch.equal(loaded.velocity(windows), adaptation.velocity(windows))
    torch.save({"format": 2, "adaptation": {"proprio": 3}}, tmp_path / "half.pt")
    with pytest.raises(CheckpointError, match=r"half\.pt: holds no complete"):
        load_adaptation(tmp_path / "half.pt")


# ------------------------------------------------------------------------------------------------- schedule


def test_the_reference_schedule_rises_from_2000_to_5000():
    schedule = RoaSchedule(weight=0.1, start=2000, ramp=3000, every=20, warmup=0)
    assert [schedule.regularisation(i) for i in (0, 2000, 3500, 5000, 9000)] == pytest.approx([0, 0, 0.05, 0.1, 0.1])
    assert [i for i in range(60) if schedule.acts(i)] == [0, 20, 40]


def test_fine_tuning_regularises_at_once_and_lets_the_encoder_learn_before_it_acts():
    schedule = RoaSchedule()
    assert [schedule.regularisation(i) for i in range(3)] == [0.0, 0.1, 0.1]
    assert [schedule.acts(i) for i in range(8)] == [False, False, True, False, False, False, False, True]
    assert [schedule.learns(i) for i in range(8)] == [True, True, True, False, False, False, False, True]


@given(st.integers(0, 50), st.integers(1, 50), st.floats(0, 2), st.integers(0, 200))
def test_the_weight_never_falls_and_stays_in_range(start, ramp, weight, iteration):
    schedule = RoaSchedule(weight=weight, start=start, ramp=ramp)
    now, then = schedule.regularisation(iteration), schedule.regularisation(iteration + 1)
    assert 0.0 <= now <= then <= weight
    assert then - now <= weight / ramp + 1e-12


# ---------------------------------------------------------------------------------------------------- hooks


def test_the_estimator_learns_the_velocity_and_is_used_after_a_while():
    env, teacher = VisionToy(64, history=3), VisionToyTeacher()
    adaptation = make(replace(SMALL, estimator_frames=1))  # the toy's frame tells all
    hook = VelocityEstimation(adaptation, use_after=30, fit=FitConfig(learning_rate=1e-2))
    obs, errors = env.reset(seed=1), []
    for iteration in range(40):
        hook.begin(iteration)
        if iteration < 30:
            assert hook.observe(obs) is obs
        rollout, obs = roll(env, [hook], teacher, obs)
        metrics = hook.end(rollout)
        assert metrics["used"] == float(iteration >= 30)
        errors.append(metrics["error"])
    shown = hook.observe(obs)
    assert torch.equal(shown["explicit"], adaptation.velocity(adaptation.window(obs)))
    assert (shown["explicit"] - obs["explicit"]).square().mean().sqrt() < 0.05
    assert errors[-1] < 0.05 < errors[0]
    assert hook.loss(rollout) is None


def test_the_history_encoder_learns_the_load_and_the_policy_can_act_on_it():
    """x' - 0.8 x - action = load + terrain + heading: what the history shows is the sum of the three."""
    env, teacher, adaptation = VisionToy(64, history=3), VisionToyTeacher(), make()
    hook = RegularisedAdaptation(adaptation, RoaSchedule(warmup=20, every=2), FIT)
    hook.attach(teacher.latent)
    obs = env.reset(seed=1)
    for iteration in range(30):
        hook.begin(iteration)
        acts = iteration >= 20 and iteration % 2 == 0
        assert ("latent" in hook.observe(obs)) == acts
        rollout, obs = roll(env, [hook], teacher, obs)
        assert hook.end(rollout)["acts"] == float(acts)
    middle = slice(4, 11)  # joints that only the load pushes
    latent = adaptation.latent(adaptation.window(rollout.obs))
    error = (latent - rollout.obs["implicit"][..., :WIDTH])[..., middle].square().mean().sqrt()
    assert error < 0.25  # the load's own deviation is 0.5


@pytest.mark.parametrize(("identification", "known"), [(0.0, False), (1.0, True), (0.3, True)])
def test_the_history_latent_tells_loads_that_the_privileged_one_does_not(identification, known):
    """The privileged latent hides joints 8 to 10; judged on robots whose rollouts were not learnt from."""
    hidden, shown = slice(8, 11), slice(4, 8)
    env, teacher, adaptation = VisionToy(96, history=3), VisionToyTeacher(), make()
    hook = RegularisedAdaptation(adaptation, RoaSchedule(warmup=12, identification=identification), FIT)
    hook.attach(lambda obs: obs["implicit"][:, :WIDTH] * (torch.arange(WIDTH) < hidden.start))
    obs = env.reset(seed=1)
    for iteration in range(12):
        hook.begin(iteration)
        rollout, obs = roll(env, [], teacher, obs)
        hook.end(rollout)
    rollout, _ = roll(env, [], teacher, env.reset(seed=5))
    with torch.no_grad():
        latent = adaptation.latent(adaptation.window(rollout.obs)).flatten(0, 1)
    truth = rollout.obs["implicit"].flatten(0, 1)
    r2 = linear_probe(latent, truth, (torch.arange(96) < 64).repeat(24))
    assert r2[shown].min() > 0.7
    assert (r2[hidden].min() > 0.5) if known else (r2[hidden].max() < 0.3)
    # gravity is the same everywhere, and colour does nothing
    assert r2[WIDTH] < 0.1
    assert latent.isfinite().all()


def test_between_phases_the_encoder_rests():
    env, teacher, adaptation = VisionToy(16, history=3), VisionToyTeacher(), make()
    hook = RegularisedAdaptation(adaptation, RoaSchedule(warmup=1, every=3))
    hook.attach(teacher.latent)
    obs, changed = env.reset(seed=1), []
    for iteration in range(6):
        before = adaptation.encoder[1].weight.clone()
        hook.begin(iteration)
        rollout, obs = roll(env, [hook], teacher, obs, steps=4)
        hook.end(rollout)
        changed.append(not torch.equal(before, adaptation.encoder[1].weight))
    assert changed == [True, True, False, False, True, False]


def test_the_regularisation_is_the_mean_distance_and_moves_the_privileged_encoder_alone():
    adaptation, encoder = make(), nn.Linear(WIDTH + 2, WIDTH)
    hook = RegularisedAdaptation(adaptation, RoaSchedule(weight=0.3))
    hook.attach(lambda obs: encoder(obs["implicit"]))
    batch = Rollout(
        {
            "proprio": torch.randn(6, PROPRIO),
            "history": torch.randn(6, 3 * PROPRIO),
            "implicit": torch.randn(6, WIDTH + 2),
        }
    )
    hook.begin(0)
    assert hook.loss(batch) is None  # its weight is still 0
    hook.begin(1)
    loss = hook.loss(batch)
    with torch.no_grad():
        gap = encoder(batch.obs["implicit"]) - adaptation.latent(adaptation.window(batch.obs))
    torch.testing.assert_close(loss, 0.3 * (gap**2).sum(1).sqrt().mean())
    loss.backward()
    assert encoder.weight.grad.abs().sum() > 0
    assert all(p.grad is None for p in adaptation.parameters())
    assert list(hook.parameters()) == []


def test_a_hook_without_its_encoder_says_what_to_do():
    with pytest.raises(InterfaceError, match=r"attach\(trainer\.model\.latent\)"):
        RegularisedAdaptation(make()).begin(0)


@pytest.mark.parametrize("kind", [VelocityEstimation, RegularisedAdaptation])
def test_a_restored_hook_goes_on_bit_by_bit(kind):
    def fresh(seed: int):
        adaptation = make(seed=seed)
        hook = kind(adaptation, fit=FitConfig(learning_rate=1e-2), seed=seed)
        if isinstance(hook, RegularisedAdaptation):
            hook.attach(VisionToyTeacher().latent)
        return adaptation, hook

    env, teacher = VisionToy(16, history=3), VisionToyTeacher()
    rollouts, obs = [], env.reset(seed=2)
    for _ in range(2):
        rollout, obs = roll(env, [], teacher, obs, steps=6)
        # as PPO hands it over
        rollouts.append(Rollout({g: v.flatten(0, 1).unflatten(0, v.shape[:2]) for g, v in rollout.obs.items()}))

    def train(hook, iterations):
        for iteration in iterations:
            hook.begin(iteration)
            hook.end(rollouts[iteration])

    adaptation, hook = fresh(1)
    train(hook, (0, 1))
    _, first = fresh(1)
    train(first, (0,))
    other, second = fresh(9)  # other weights and stream, which the state overrules
    second.load_state_dict(first.state_dict())
    train(second, (1,))
    part = "estimator" if kind is VelocityEstimation else "encoder"
    for mine, theirs in zip(getattr(adaptation, part).parameters(), getattr(other, part).parameters(), strict=True):
        assert torch.equal(mine, theirs)


def test_gradients_are_averaged_over_processes():
    """Two processes with the same gradient: their average is that gradient, so nothing may change."""
    env, teacher = VisionToy(16, history=3), VisionToyTeacher()
    rollout, _ = roll(env, [], teacher, env.reset(seed=2), steps=6)
    weights = []
    for scale in (None, 1.0, 0.0):
        adaptation = make()
        average = None if scale is None else lambda tensors, scale=scale: [t.mul_(scale) for t in tensors]
        hook = VelocityEstimation(adaptation, average=average)
        hook.begin(0)
        hook.end(rollout)
        weights.append(adaptation.estimator[0].weight.detach())
    assert torch.equal(weights[0], weights[1])
    assert torch.equal(weights[2], make().estimator[0].weight)


def test_the_adapted_teacher_acts_on_what_sensors_give():
    env, teacher, adaptation = VisionToy(4, history=3), VisionToyTeacher(), make()
    obs = env.reset(seed=0)
    action = AdaptedTeacher(teacher, adaptation).act(obs)
    blinded = {**obs, "implicit": torch.full_like(obs["implicit"], 7.0), "explicit": torch.full((4, 3), 7.0)}
    assert torch.equal(action, AdaptedTeacher(teacher, adaptation).act(blinded))
    with torch.no_grad():
        window = adaptation.window(obs)
        velocity, latent = adaptation.velocity(window), adaptation.latent(window)
        expected = teacher.actor(torch.cat((obs["proprio"], obs["scan"], velocity, latent), dim=1))
    assert torch.equal(action, expected)
