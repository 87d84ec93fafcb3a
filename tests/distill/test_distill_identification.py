"""Linear probes: their coefficient of determination, and that they judge robots they have not seen."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from distill import AdaptationConfig, AdaptationModule, InterfaceError, identify
from distill.adaptation import linear_probe
from vision_toy import BODY, HEADING, PROPRIO, WIDTH, VisionToy, VisionToyTeacher


def test_a_probe_is_least_squares_judged_on_the_rest():
    """Against numpy's own least squares."""
    rng = np.random.default_rng(0)
    x = rng.normal(3.0, [0.1, 2.0, 30.0], (200, 3))
    y = np.stack((x @ [4.0, -1.0, 0.02] + rng.normal(0, 0.5, 200), rng.normal(5, 1, 200)), axis=1)
    train = np.arange(200) < 120
    design = np.column_stack((x, np.ones(200)))
    weights = np.linalg.lstsq(design[train], y[train], rcond=None)[0]
    residual = y[~train] - design[~train] @ weights
    expected = 1 - (residual**2).sum(0) / ((y[~train] - y[~train].mean(0)) ** 2).sum(0)
    found = linear_probe(*(torch.from_numpy(each) for each in (x, y, train)), ridge=0.0)
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-9)
    assert expected[0] > 0.9 > 0.1 > expected[1]


def test_a_constant_has_no_coefficient_and_a_dead_input_does_no_harm():
    latent = torch.cat((torch.randn(40, 2), torch.full((40, 1), 0.3)), dim=1)
    truth = torch.stack((2.0 * latent[:, 0], torch.full((40,), 9.81)), dim=1)
    r2 = linear_probe(latent, truth, torch.arange(40) % 2 == 0)
    assert r2[0] > 0.999
    assert torch.isnan(r2[1])


def test_nothing_to_fit_or_to_judge_is_refused():
    for train in (torch.zeros(4, dtype=torch.bool), torch.ones(4, dtype=torch.bool)):
        with pytest.raises(ValueError, match="to be judged on"):
            linear_probe(torch.randn(4, 1), torch.randn(4, 1), train)


class Reader(AdaptationModule):
    """Reads the push of a step from the last two frames: exactly the load, where nothing else pushes."""

    def latent(self, window):
        now, before = window[..., -1, :], window[..., -2, :]
        return now[..., :WIDTH] - 0.8 * before[..., :WIDTH] - now[..., 2 * WIDTH : 3 * WIDTH]


def test_the_load_is_identified_and_colour_is_not():
    env = VisionToy(96, bodies=True)
    adaptation = Reader(PROPRIO, WIDTH, AdaptationConfig(history=3), range(HEADING.start, HEADING.stop))
    found = identify(env, VisionToyTeacher(), adaptation, BODY, steps=60, settle=20, seed=4)
    assert found.robots == 24
    assert found.samples == 24 * 40
    loads = [found.r2[f"load[{joint}]"] for joint in range(4, 11)]  # which terrain and heading do not push
    assert min(loads) > 0.9
    assert found.r2["load[0]"] < 0.9
    assert found.r2["colour"] < 0.2
    assert np.isnan(found.r2["gravity"])


def test_too_few_robots_are_refused():
    adaptation = AdaptationModule(PROPRIO, WIDTH, AdaptationConfig(history=3))
    with pytest.raises(InterfaceError, match="8 robots are too few"):
        identify(VisionToy(8), VisionToyTeacher(), adaptation, BODY)
    env = VisionToy(64)
    del env.group_dims["implicit"]
    with pytest.raises(InterfaceError, match="needs the observation group 'implicit'"):
        identify(env, VisionToyTeacher(), adaptation, BODY)
