"""Networks of Fig. 3: sizes by hand, and who sees what."""

from __future__ import annotations

import pytest
import torch
from locorl import ActorCritic, NetworkConfig
from locorl.learning.layers import run
from torch.distributions import Independent, Normal

FLAT = {"proprio": 3, "explicit": 1, "implicit": 2}
ROUGH = {**FLAT, "scan": 7, "history": 30}
SMALL = NetworkConfig(actor=(16,), critic=(16,), encoder=(8,), latent=3, scan_encoder=(9,), scan_latent=4)


def draw(dims: dict[str, int], rows: int = 5) -> dict[str, torch.Tensor]:
    return {group: torch.randn(rows, size) for group, size in dims.items()}


def layers(network: torch.nn.Module) -> list[tuple[int, int]]:
    return [(x.in_features, x.out_features) for x in network.modules() if isinstance(x, torch.nn.Linear)]


@pytest.fixture
def rough() -> ActorCritic:
    torch.manual_seed(1)
    return ActorCritic(ROUGH, 5, SMALL)


def test_the_papers_sizes():
    """Those of the reference implementation, whose groups have 53, 132, 9 and 29 numbers."""
    dims = {"proprio": 53, "explicit": 9, "implicit": 29, "scan": 132, "history": 530}
    model = ActorCritic(dims, 12, NetworkConfig.paper())
    assert model.scan_encoder is not None
    assert layers(model.scan_encoder) == [(132, 128), (128, 64), (64, 32)]
    assert layers(model.encoder) == [(29, 64), (64, 20)]
    assert layers(model.actor) == [(114, 512), (512, 256), (256, 128), (128, 12)]  # 53 + 32 + 9 + 20
    assert layers(model.critic) == [(223, 512), (512, 256), (256, 128), (128, 1)]  # 53 + 9 + 29 + 132
    assert model.std().tolist() == pytest.approx([1.0] * 12)


def test_activations_are_elu_and_the_scans_last_is_tanh(rough):
    assert rough.scan_encoder is not None
    kinds = [type(x).__name__ for x in rough.scan_encoder]
    assert kinds == ["Linear", "ELU", "Linear", "Tanh"]
    assert [type(x).__name__ for x in rough.actor] == ["Linear", "ELU", "Linear"]
    big = {**draw(ROUGH), "scan": torch.full((5, 7), 1e4)}
    assert rough.scan_latent(big).abs().max() <= 1.0


def test_the_actor_sees_latents_in_place_of_scan_and_implicit_state(rough):
    obs = draw(ROUGH)
    joined = torch.cat((obs["proprio"], rough.scan_latent(obs), obs["explicit"], rough.latent(obs)), dim=1)
    torch.testing.assert_close(rough.act(obs), rough.actor(joined))
    torch.testing.assert_close(rough.actor[-1](rough.features(obs)), rough.act(obs))
    assert rough.latent(obs).shape == (5, 3)
    assert rough.scan_latent(obs).shape == (5, 4)
    assert rough.value(obs).shape == (5,)


@pytest.mark.parametrize("group", ROUGH)
def test_the_critic_sees_all_but_the_history(rough, group):
    obs = draw(ROUGH)
    changed = {**obs, group: obs[group] + 1.0}
    assert torch.equal(rough.value(obs), rough.value(changed)) == (group == "history")
    assert torch.equal(rough.act(obs), rough.act(changed)) == (group == "history")


def test_without_a_scan_the_layout_is_the_one_of_shipped_policies():
    torch.manual_seed(1)
    model = ActorCritic(FLAT, 5, SMALL)
    names = {name.split(".")[0] for name in model.state_dict()}
    assert names == {"encoder", "actor", "critic", "log_std"}
    obs = draw(FLAT)
    joined = torch.cat((obs["proprio"], obs["explicit"], model.latent(obs)), dim=1)
    torch.testing.assert_close(model.act(obs), model.actor(joined))
    complete = torch.cat((obs["proprio"], obs["explicit"], obs["implicit"]), dim=1)
    torch.testing.assert_close(model.value(obs), model.critic(complete).squeeze(1))
    with pytest.raises(ValueError, match="no scan encoder"):
        model.scan_latent(obs)


def test_log_prob_and_entropy_against_torch(rough):
    with torch.no_grad():
        rough.log_std.copy_(torch.tensor([-1.0, 0.0, 0.5, -0.3, -9.0]))  # the last is held at the floor
    mean, action = torch.randn(2, 7, 5)
    truth = Independent(Normal(mean, rough.std()), 1)
    torch.testing.assert_close(rough.log_prob(mean, action), truth.log_prob(action))
    torch.testing.assert_close(rough.entropy(), truth.entropy()[0])
    assert rough.std()[-1].item() == pytest.approx(SMALL.min_std)


def test_the_first_mean_action_is_small(rough):
    assert rough.act(draw(ROUGH, 1000)).std() < 0.1


def test_layers_are_torchs_own_and_their_gradients_too():
    torch.manual_seed(0)
    network = torch.nn.Sequential(
        torch.nn.Linear(6, 40),
        torch.nn.ELU(),
        torch.nn.Linear(40, 30),
        torch.nn.ELU(),
        torch.nn.Linear(30, 3),
        torch.nn.Tanh(),
    ).double()
    x = (3.0 * torch.randn(50, 6, dtype=torch.float64)).requires_grad_()
    found, truth = run(network, x), network(x)
    torch.testing.assert_close(found, truth)
    wanted = (x, *network.parameters())
    weights = torch.randn(50, 3, dtype=torch.float64)
    for a, b in zip(*(torch.autograd.grad((y * weights).sum(), wanted) for y in (found, truth)), strict=True):
        torch.testing.assert_close(a, b)


def test_columns_that_are_data_get_no_gradient_and_change_no_other():
    torch.manual_seed(0)
    network = torch.nn.Sequential(torch.nn.Linear(6, 4), torch.nn.ELU(), torch.nn.Linear(4, 2)).double()
    x = torch.randn(9, 6, dtype=torch.float64, requires_grad=True)
    wanted = (x, *network.parameters())
    found, truth = (torch.autograd.grad(y.square().sum(), wanted) for y in (run(network, x, known=4), network(x)))
    assert not found[0][:, :4].any()
    torch.testing.assert_close(found[0][:, 4:], truth[0][:, 4:])
    torch.testing.assert_close(found[1:], truth[1:])


@pytest.mark.parametrize("leading", [(), (0,), (4,), (2, 3)])
def test_layers_keep_leading_dimensions(leading):
    network = torch.nn.Sequential(torch.nn.Linear(3, 5), torch.nn.ELU(), torch.nn.Linear(5, 2))
    x = torch.randn(*leading, 3)
    torch.testing.assert_close(run(network, x), network(x))


@pytest.mark.parametrize(
    "z", [0.0, 1e-6, -1e-6, 1e-3, -1e-3, -0.5, -30.0, 100.0, -1e4, 1e4, float("inf"), float("-inf")]
)
def test_elu_near_and_far_from_zero(z):
    network = torch.nn.Sequential(torch.nn.Linear(1, 1), torch.nn.ELU())
    torch.nn.init.ones_(network[0].weight)
    torch.nn.init.zeros_(network[0].bias)
    x = torch.tensor([[z]])
    torch.testing.assert_close(run(network, x), torch.nn.functional.elu(x), rtol=1e-6, atol=1e-7)
    assert run(network, x * float("nan")).isnan().all()
