"""The scores that bodies are searched by, on episodes made by hand."""

from __future__ import annotations

import numpy as np
import pytest
from locorl import EvalConfig, Evaluation

from legged_codesign.config import ScoreConfig
from legged_codesign.objective import CAP, PENALTY, evaluation_config, physical, robot_scores

SCORE = ScoreConfig(vx=(0.5, 0.5), seconds=10.0, robots=4, max_error=0.1)
WEIGHT = 150.0  # N
WAY = 5.0  # m, commanded


def episode(
    energy: list[float],
    distance: list[float],
    error: list[float],
    survived: list[bool] | None = None,
    returns: list[float] | None = None,
) -> Evaluation:
    """One body, a robot per entry; cost of transport as the definition says."""
    work, way = np.array([energy]), np.array([distance])
    with np.errstate(divide="ignore"):
        transport = work / (WEIGHT * way)
    shape = work.shape
    return Evaluation(
        designs=np.ones((1, 4)),
        config=EvalConfig(seconds=SCORE.seconds),
        command=np.full(shape, SCORE.vx[0]),
        weight=np.full(shape, WEIGHT),
        survived=np.ones(shape, bool) if survived is None else np.array([survived]),
        returns=np.zeros(shape) if returns is None else np.array([returns]),
        tracking_error=np.array([error]),
        distance=way,
        energy=work,
        cost_of_transport=transport,
        mean_power=work / SCORE.seconds,
    )


def test_return_is_the_undiscounted_sum() -> None:
    result = episode([1.0, 1.0], [5.0, 0.0], [0.0, 0.5], [True, False], [31.5, 2.25])
    assert robot_scores(result, "return", SCORE).tolist() == [[31.5, 2.25]]


def test_cost_of_transport() -> None:
    # 225 J over 150 N and 5 m
    assert robot_scores(episode([225.0], [5.0], [0.02]), "cost-of-transport", SCORE)[0, 0] == pytest.approx(-0.3)


def test_energy_is_in_joules() -> None:
    # a little short of the commanded way, within the tracking limit: what was spent counts, not per metre
    assert robot_scores(episode([225.0], [4.6], [0.04]), "energy", SCORE)[0, 0] == pytest.approx(-225.0)


@pytest.mark.parametrize(("objective", "cost"), [("cost-of-transport", 0.3), ("energy", 225.0)])
def test_tracking_error_beyond_the_limit_is_penalised(objective, cost: float) -> None:
    scores = robot_scores(episode([225.0] * 3, [5.0] * 3, [0.1, 0.13, 0.2]), objective, SCORE)[0]
    # 0.03 and 0.1 m/s beyond the limit of 0.1 at 3 per m/s: 0.09 and 0.3 on top of 0.3
    assert scores == pytest.approx([-cost, -1.3 * cost, -2.0 * cost])
    assert PENALTY == 3.0


@pytest.mark.parametrize("objective", ["cost-of-transport", "energy"])
def test_a_fallen_robot_counts_the_cap_however_little_it_spent(objective) -> None:
    scores = robot_scores(episode([300.0, 1.0], [5.0, 0.1], [0.05, 0.5], [True, False]), objective, SCORE)[0]
    cap = CAP if objective == "cost-of-transport" else CAP * WEIGHT * WAY
    assert scores[1] == pytest.approx(-cap)
    assert scores[0] > scores[1]


@pytest.mark.parametrize("objective", ["cost-of-transport", "energy"])
def test_standing_still_does_not_pay(objective) -> None:
    """A walker at an ordinary cost beats one that stands and spends next to nothing."""
    walker, idler = robot_scores(episode([225.0, 3.0], [5.0, 0.0], [0.03, 0.5]), objective, SCORE)[0]
    assert np.isfinite(idler)
    assert walker > idler


def test_creeping_does_not_pay() -> None:
    """Half the speed at half the cost per metre is still worse than obeying the command."""
    walker, creeper = robot_scores(episode([225.0, 56.0], [5.0, 2.5], [0.03, 0.25]), "cost-of-transport", SCORE)[0]
    assert walker > creeper


def test_nothing_is_worse_than_the_cap() -> None:
    scores = robot_scores(episode([9000.0], [1.0], [0.4]), "cost-of-transport", SCORE)
    assert scores[0, 0] == -CAP


def test_scores_keep_the_shape_of_bodies_and_robots() -> None:
    assert robot_scores(episode([1.0] * 6, [5.0] * 6, [0.0] * 6), "energy", SCORE).shape == (1, 6)


def test_physical_quantities_are_positive_costs() -> None:
    assert physical(-0.3, "cost-of-transport") == 0.3
    assert physical(-225.0, "energy") == 225.0
    assert physical(31.5, "return") == 31.5


def test_protocol_of_scoring() -> None:
    protocol = evaluation_config(SCORE, seed=9)
    assert protocol.vx == (0.5, 0.5)
    assert (protocol.seconds, protocol.robots_per_body, protocol.seed) == (10.0, 4, 9)
    assert 0.0 < protocol.settle <= 2.0
    assert protocol.reset_joint > 0.0, "without it all robots of a body would do the same"
