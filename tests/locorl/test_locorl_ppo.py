"""PPO by hand, against torch.distributions, and on a problem that it has to solve."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import pytest
import torch
from locorl import PPO, ActorCritic, DivergedError, PPOConfig
from locorl.learning.losses import clipped_surrogate, clipped_value_loss, gaussian_kl
from locorl.learning.parallel import Backward, threads_for
from locorl.learning.storage import Minibatch, Rollout
from locorl_target import DIMS, NETWORK, TargetEnv, make_ppo
from torch.distributions import Independent, Normal, kl_divergence


def gaussian(model: ActorCritic, mean: torch.Tensor) -> Independent:
    return Independent(Normal(mean, model.std()), 1)


@pytest.mark.parametrize("shape", [(9, 2), (1, 2)])
def test_kl_against_torch(shape):
    mean, old_mean = torch.randn(2, *shape)
    std, old_std = torch.tensor([0.4, 2.0]), torch.tensor([0.7, 1.3])
    old, new = (Independent(Normal(m, s), 1) for m, s in ((old_mean, old_std), (mean, std)))
    truth = kl_divergence(old, new).mean()
    assert gaussian_kl(mean, std, old_mean, old_std).item() == pytest.approx(truth.item(), rel=1e-5)


@pytest.mark.parametrize(
    ("kl", "factor"), [(0.021, 1 / 1.5), (0.0199, 1.0), (0.01, 1.0), (0.0051, 1.0), (0.0049, 1.5), (0.0, 1.0)]
)
def test_the_learning_rate_follows_the_divergence(kl, factor):
    ppo = make_ppo(PPOConfig(desired_kl=0.01, learning_rate=1e-3))
    ppo._adapt(kl)
    assert ppo.learning_rate == pytest.approx(1e-3 * factor)
    assert ppo.optimizer.param_groups[0]["lr"] == ppo.learning_rate


def test_the_learning_rate_stays_in_its_bounds():
    ppo = make_ppo(PPOConfig(min_learning_rate=9e-4, max_learning_rate=1.1e-3, learning_rate=1e-3))
    ppo._adapt(1.0)
    assert ppo.learning_rate == 9e-4
    for _ in range(3):
        ppo._adapt(1e-4)
    assert ppo.learning_rate == 1.1e-3


@pytest.mark.parametrize(
    ("ratio", "advantage", "surrogate"),
    [(1.1, 2.0, -2.2), (1.5, 2.0, -2.4), (1.5, -2.0, 3.0), (0.5, 2.0, -1.0), (0.5, -2.0, 1.6)],
)
def test_the_clipped_surrogate_by_hand(ratio, advantage, surrogate):
    log_prob = torch.tensor([-1.7])
    loss = clipped_surrogate(log_prob, batch(log_prob=-1.7 - math.log(ratio), advantage=advantage), clip=0.2)
    assert loss.item() == pytest.approx(surrogate, rel=1e-5)


@pytest.mark.parametrize(
    ("old", "target", "expected"),  # the critic now says 0; a step of at most 0.2 from the old value is trusted
    [(0.1, 1.0, 1.0), (-0.5, 1.0, 1.3**2), (0.5, 1.0, 1.0), (1.0, -1.0, 1.8**2)],
)
def test_the_clipped_value_loss_by_hand(old, target, expected):
    loss = clipped_value_loss(torch.zeros(1), batch(value=old, target=target), clip=0.2)
    assert loss.item() == pytest.approx(expected, rel=1e-5)


def batch(log_prob=0.0, advantage=0.0, value=0.0, target=0.0) -> Minibatch:
    """One transition, of which a loss sees these numbers alone."""
    numbers = (torch.tensor([x]) for x in (log_prob, value, advantage, target))
    return Minibatch({}, ({},), torch.zeros(1, 2), torch.zeros(1, 2), *numbers)


def numbered_rollout(steps: int, num_envs: int) -> Rollout:
    rollout = Rollout(steps, num_envs, {"proprio": 2}, 1)
    numbers = torch.arange(float(steps * num_envs)).view(steps, num_envs)
    rollout.value[:], rollout.advantage[:], rollout.target[:] = numbers, numbers + 0.25, numbers + 0.5
    rollout.log_prob[:], rollout.action[:], rollout.mean[:] = -numbers, numbers[..., None], numbers[..., None] * 2
    rollout.obs["proprio"][:] = torch.stack((numbers, -numbers), dim=-1)
    return rollout


def check_columns(each: Minibatch) -> None:
    """All columns of a row belong together."""
    v = each.value
    assert torch.equal(each.advantage, v + 0.25)
    assert torch.equal(each.target, v + 0.5)
    assert torch.equal(each.log_prob, -v)
    assert torch.equal(each.action[:, 0], v)
    assert torch.equal(each.mean[:, 0], 2 * v)
    assert torch.equal(each.obs["proprio"], torch.stack((v, -v), dim=1))


def test_minibatches_visit_each_transition_once():
    rollout = numbered_rollout(5, 3)
    generator = torch.Generator().manual_seed(0)
    batches = [rollout.pick(rows) for rows in rollout.shuffle(4, generator)]
    assert sorted(len(batch.value) for batch in batches) == [3, 4, 4, 4]
    visited = torch.cat([batch.value for batch in batches])
    assert sorted(visited.tolist()) == list(range(15))
    assert visited.tolist() != list(range(15))  # shuffled
    for each in batches:
        check_columns(each)
    again = torch.cat([batch.value for batch in map(rollout.pick, rollout.shuffle(4, generator))])
    assert not torch.equal(again, visited)


@pytest.mark.parametrize(("rows", "used"), [(1, 1), (4095, 1), (4096, 2), (1_000_000, 2)])
def test_little_work_gets_few_threads(rows, used):
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        with threads_for(rows):
            inside = torch.get_num_threads()
        after = torch.get_num_threads()
    finally:
        torch.set_num_threads(before)
    assert (inside, after) == (used, 2)


@pytest.mark.parametrize("parts", [2, 3])
@pytest.mark.parametrize("mirrored", [False, True])
def test_parts_of_a_minibatch_give_its_gradient(parts, mirrored):
    ppo, env = make_ppo(mirror=Swap() if mirrored else None), TargetEnv()
    ppo.collect(env, env.observe())
    ppo.rollout.advantage = ppo.rollout.advantage + torch.randn(4, 32)
    (rows,) = ppo.rollout.shuffle(1, torch.Generator())  # 128 rows: in three parts 43, 43 and 42
    old_std, threads = torch.ones(2), torch.get_num_threads()
    parameters = [*ppo.model.parameters(), torch.nn.Parameter(torch.ones(1))]  # the last one has no gradient

    def gradient(count: int) -> tuple[list[torch.Tensor | None], dict[str, torch.Tensor]]:
        with Backward(parameters, count) as backward:
            numbers = backward(lambda part: ppo._loss(ppo.rollout.pick(part), old_std), rows)
        return [parameter.grad for parameter in parameters], numbers

    (whole, numbers), (split, same), (again, _) = gradient(1), gradient(parts), gradient(parts)
    assert whole[-1] is None
    assert split[-1] is None
    for a, b, c in zip(whole[:-1], split[:-1], again[:-1], strict=True):
        torch.testing.assert_close(b, a, rtol=1e-4, atol=1e-6)
        assert torch.equal(b, c)
    for name, number in numbers.items():
        torch.testing.assert_close(same[name], number.detach(), rtol=1e-4, atol=1e-6)
    assert torch.get_num_threads() == threads


def test_a_rollout_bootstraps_with_the_state_it_was_cut_in():
    ppo, env = make_ppo(num_envs=4), TargetEnv(4)
    obs, stats = ppo.collect(env, env.observe())
    rollout = ppo.rollout
    assert rollout.terminated.nonzero().tolist() == [[1, 0]]
    assert rollout.done.nonzero().tolist() == [[1, 0], [2, 1]]
    with torch.no_grad():
        expected = torch.cat((rollout.value[1:], ppo.model.value(obs)[None]))
        expected[2, 1] = ppo.model.value(env.last)[0]
        torch.testing.assert_close(rollout.value, ppo.model.value(rollout.obs))
    torch.testing.assert_close(rollout.next_value, expected)
    truth = gaussian(ppo.model, rollout.mean).log_prob(rollout.action)
    torch.testing.assert_close(rollout.log_prob, truth.detach())
    torch.testing.assert_close(rollout.mean, ppo.model.act(rollout.obs).detach())
    assert stats["reward"] == pytest.approx(rollout.reward.mean().item() / env.dt, rel=1e-5)
    assert stats["term/target"] == pytest.approx(stats["reward"], rel=1e-5)
    assert stats["fall_rate"] == stats["success_rate"] == pytest.approx(1 / 16 / env.dt)
    assert stats["terrain_level"] == 1.5  # of robots on levels 0 to 3


def test_a_rollout_may_end_in_falls_alone():
    ppo, env = make_ppo(PPOConfig(steps=2), num_envs=4), TargetEnv(4)
    ppo.collect(env, env.observe())
    assert ppo.rollout.done.nonzero().tolist() == ppo.rollout.terminated.nonzero().tolist() == [[1, 0]]
    assert ppo.rollout.target.isfinite().all()


def test_exploration_is_the_policys_gaussian():
    ppo, env = make_ppo(PPOConfig(steps=50), num_envs=64), TargetEnv(64)
    with torch.no_grad():
        ppo.model.log_std.copy_(torch.tensor([-1.0, 0.5]))
    ppo.collect(env, env.observe())
    noise = ((ppo.rollout.action - ppo.rollout.mean) / torch.tensor([-1.0, 0.5]).exp()).view(-1, 2)
    assert noise.mean(dim=0).abs().max() < 4 / math.sqrt(3200)  # standard errors
    torch.testing.assert_close(noise.T.cov(), torch.eye(2), atol=4 * math.sqrt(2 / 3200), rtol=0.0)


@pytest.mark.parametrize(
    ("regulariser", "discount"), [("discount", 0.7), ("none", 0.9), ("activation", 0.9), ("ppg", 0.9)]
)
def test_the_discount_in_force_reaches_the_targets(regulariser, discount):
    env = TargetEnv(4)
    ppo = make_ppo(PPOConfig(steps=3, gamma_reg=0.7, gamma=0.9, lam=0.0, regulariser=regulariser), num_envs=4)
    assert ppo.config.discount == discount
    ppo.collect(env, env.observe())
    rollout = ppo.rollout
    assert (rollout.done & ~rollout.terminated).any()  # the bootstrap at a time-out among them
    expected = rollout.reward + discount * rollout.next_value * ~rollout.terminated
    torch.testing.assert_close(rollout.target, expected)


def test_learning_reaches_the_target():
    env, ppo = TargetEnv(64), make_ppo(PPOConfig(steps=12, learning_rate=3e-3, entropy=0.0), num_envs=64)
    obs = env.observe()
    test = {group: values.clone() for group, values in obs.items()}

    def error() -> float:
        with torch.no_grad():
            return (ppo.model.act(test) - env.target(test)).square().sum(dim=1).mean().item()

    before = error()
    first = None
    for _ in range(30):
        obs, stats = ppo.collect(env, obs)
        first = stats["reward"] if first is None else first
        losses = ppo.update()
    assert ppo.iteration == 30
    assert before > 0.8
    assert error() < 0.2 * before
    assert stats["reward"] > 0.5 * first  # rewards are negative: at most half the loss, noise included
    assert losses["action_std"] < 0.9  # nothing rewards noise


# ------------------------------------------------------------------------------------------ divergence


@pytest.mark.parametrize(
    ("poison", "what", "robots", "step"),
    [
        ("reward", "reward", (1,), 2),
        ("proprio", "observation", (3,), 2),
        ("implicit", "observation", (3,), 2),
        ("explicit", "observation", (3,), 2),  # -inf, which an ELU would hide
    ],
)
def test_what_is_not_finite_in_a_rollout_stops_training(poison, what, robots, step):
    ppo, env = make_ppo(num_envs=4), TargetEnv(4, poison=poison)
    with pytest.raises(DivergedError, match=rf"{poison}.* not finite for 1 of 4 robots \(\d\)") as caught:
        ppo.collect(env, env.observe())
    assert (caught.value.what, caught.value.robots, caught.value.step) == (what, robots, step)


def test_a_broken_policy_stops_before_the_robots_move():
    ppo, env = make_ppo(num_envs=4), TargetEnv(4)
    with torch.no_grad():
        ppo.model.actor[0].weight[0, 0] = float("nan")
    with pytest.raises(DivergedError, match="the action is not finite for 4 of 4") as caught:
        ppo.collect(env, env.observe())
    assert (caught.value.what, caught.value.step, env.t) == ("action", 0, 0)


@pytest.mark.parametrize(
    ("column", "value", "bad"),
    [
        ("target", float("nan"), {"value_loss", "gradient_norm"}),
        ("advantage", float("nan"), {"surrogate_loss", "gradient_norm"}),
    ],
)
def test_a_bad_update_stops_before_it_harms_anything(column, value, bad):
    ppo, env = make_ppo(num_envs=4), TargetEnv(4)
    obs = env.observe()
    obs, _ = ppo.collect(env, obs)
    ppo.update()
    ppo.collect(env, obs)
    getattr(ppo.rollout, column)[2, 1] = value
    check_that_nothing_changes(ppo, bad)


def test_a_bad_gradient_of_a_good_loss_stops_too():
    class Root:
        """The square root of 0: its gradient is 0 times infinity."""

        name = "root"

        def begin(self, iteration):
            pass

        def observe(self, obs):
            return obs

        def end(self, rollout):
            return {}

        def loss(self, batch):
            return (0.0 * ppo.model.log_std.square().sum()).sqrt()

        def parameters(self):
            return ()

        def state_dict(self):
            return {}

        def load_state_dict(self, state):
            pass

    ppo, env = make_ppo(num_envs=4, hooks=(Root(),)), TargetEnv(4)
    ppo.collect(env, env.observe())
    numbers = check_that_nothing_changes(ppo, {"gradient_norm"})
    assert math.isfinite(numbers["surrogate_loss"])
    assert math.isfinite(numbers["value_loss"])


def check_that_nothing_changes(ppo: PPO, bad: set[str]) -> dict[str, float]:
    """An update is refused for what is `bad`, and leaves model and moments as they are."""
    model, state = copy.deepcopy((ppo.model.state_dict(), ppo.optimizer.state_dict()))
    ppo.config = replace(ppo.config, minibatches=1)
    with pytest.raises(DivergedError, match="not finite") as caught:
        ppo.update()
    numbers = caught.value.numbers
    assert {name for name, number in numbers.items() if not math.isfinite(number)} >= bad
    assert caught.value.what == "update"
    assert all(torch.equal(model[name], values) for name, values in ppo.model.state_dict().items())
    moments = ppo.optimizer.state_dict()["state"]
    assert all(torch.equal(state["state"][i]["exp_avg"], moments[i]["exp_avg"]) for i in moments)
    return numbers


# ------------------------------------------------------------------------------------------ symmetry


class Swap:
    """Mirroring swaps the first two numbers of what has two, and turns the sign of the third."""

    def observation(self, obs):
        flipped = dict(obs)
        flipped["proprio"] = obs["proprio"][:, [1, 0, 2]] * torch.tensor([1.0, 1.0, -1.0])
        flipped["implicit"] = obs["implicit"][:, [1, 0]]
        return flipped

    def action(self, action):
        return action[:, [1, 0]]


def test_a_mirror_image_keeps_what_its_original_was_worth():
    ppo, env = make_ppo(num_envs=4), TargetEnv(4)
    ppo.collect(env, env.observe())
    whole = ppo.rollout.pick(*ppo.rollout.shuffle(1, torch.Generator()))
    both = whole.with_mirror_image(Swap())
    n = len(whole.value)
    assert torch.equal(both.obs["proprio"][:n], whole.obs["proprio"])
    assert both.obs["proprio"][n].tolist() == (whole.obs["proprio"][0, [1, 0, 2]] * torch.tensor([1, 1, -1])).tolist()
    assert torch.equal(both.obs["explicit"][n:], whole.obs["explicit"])
    assert torch.equal(both.action[n:], whole.action[:, [1, 0]])
    assert torch.equal(both.mean[n:], whole.mean[:, [1, 0]])
    for name in ("log_prob", "value", "advantage", "target"):
        assert torch.equal(getattr(both, name), torch.cat((getattr(whole, name),) * 2))


def test_likelihood_ratios_of_mirror_images_are_importance_weights():
    """E over the old policy of the mirror image's ratio is 1, however asymmetric that policy is."""
    torch.manual_seed(0)
    model, obs = ActorCritic(DIMS, 2, NETWORK), {group: torch.randn(1, size) for group, size in DIMS.items()}
    with torch.no_grad():
        model.log_std.copy_(torch.tensor([0.1, -0.2]))
        model.actor[-1].weight.mul_(5.0)
        mean = model.act(obs)
        action = mean + model.std() * torch.randn(200_000, 2)
        image = model.act(Swap().observation(obs))
        assert (image - Swap().action(mean)).norm() > 0.05
        ratio = (model.log_prob(image, Swap().action(action)) - model.log_prob(mean, action)).exp()
    assert ratio.mean().item() == pytest.approx(1.0, abs=4 * ratio.std().item() / math.sqrt(len(ratio)))
    assert ratio.std() > 0.05


def test_mirroring_makes_the_policy_symmetric():
    def asymmetry(mirror: Swap | None) -> float:
        env = TargetEnv(64)
        ppo = make_ppo(PPOConfig(steps=12, learning_rate=3e-3, entropy=0.0), num_envs=64, mirror=mirror)
        # swapping columns and rows of the target's matrix leaves it as it is
        env.matrix = torch.tensor([[0.8, -0.5], [-0.5, 0.8], [-0.4, 0.4]])
        obs = env.observe()
        test = {group: values.clone() for group, values in obs.items()}
        for _ in range(8):
            obs, _ = ppo.collect(env, obs)
            ppo.update()
        with torch.no_grad():
            error = (ppo.model.act(test) - env.target(test)).square().sum(dim=1).mean().item()
            assert error < 0.7 * env.target(test).square().sum(dim=1).mean()
            image = Swap().action(ppo.model.act(Swap().observation(test)))
            return (ppo.model.act(test) - image).square().mean().item()

    assert asymmetry(Swap()) < 0.5 * asymmetry(None)


def test_mirroring_needs_a_mirror():
    with pytest.raises(ValueError, match="is set, so PPO needs `mirror`"):
        make_ppo(PPOConfig(mirror=True))


# ------------------------------------------------------------------------------------------ state


@pytest.mark.parametrize("regulariser", ["discount", "ppg"])
def test_a_saved_update_goes_on_bit_identically(regulariser, tmp_path):
    config = PPOConfig(steps=4, regulariser=regulariser)
    config = replace(config, ppg=replace(config.ppg, policy_iterations=3, epochs=2))

    def trained(split: bool) -> dict[str, torch.Tensor]:
        ppo, env = make_ppo(config, num_envs=4), TargetEnv(4)
        obs = env.observe()
        for i in range(4):
            if split and i == 2:
                torch.save((ppo.model.state_dict(), ppo.state_dict()), tmp_path / "state.pt")
                ppo = make_ppo(config, num_envs=4, seed=9)
                model, state = torch.load(tmp_path / "state.pt", weights_only=True)
                ppo.model.load_state_dict(model)
                ppo.load_state_dict(state)
                assert ppo.iteration == 2
            obs, _ = ppo.collect(env, obs)
            ppo.update()
        return ppo.model.state_dict()

    whole, split = trained(False), trained(True)
    assert all(torch.equal(whole[name], split[name]) for name in whole)


@pytest.mark.parametrize(
    "wrong",
    [{"gamma_reg": 1.0}, {"gamma": 0.0}, {"lam": 1.5}, {"steps": 0}, {"minibatches": 0}, {"activation_weight": -1.0}],
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ValueError, match="PPOConfig"):
        PPOConfig(**wrong)
