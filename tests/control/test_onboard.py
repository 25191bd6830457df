"""The policy on board gives the same actions as the batch policy."""

import numpy as np
import torch

from racerl.control.networks import build_network
from racerl.control.onboard import OnboardPolicy
from racerl.control.policy import Policy


def test_it_gives_the_same_actions():
    torch.manual_seed(0)
    policy = Policy(build_network([50, 64, 32, 2]), {}, {})
    onboard = OnboardPolicy(policy)
    observations = 5.0 * torch.randn(200, 50)
    expected = policy(observations).numpy()
    answers = np.array([onboard(observation).copy() for observation in observations.numpy()])
    assert np.abs(answers - expected).max() < 1e-5
    assert (np.abs(expected) == 1.0).any() and (np.abs(expected) < 1.0).any()  # both sides of the limit were seen


def test_weights_are_its_own():
    policy = Policy(build_network([4, 2]), {}, {})
    onboard = OnboardPolicy(policy)
    before = onboard(np.ones(4, np.float32)).copy()
    with torch.no_grad():
        policy.network[0].bias += 0.5
    assert np.array_equal(onboard(np.ones(4, np.float32)), before)
