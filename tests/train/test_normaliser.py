"""Running moments against numpy's, and folding: a policy that says the same of what it sees as it is."""

import numpy as np
import torch

from racerl.control.networks import build_network
from racerl.train.normaliser import Normaliser

CPU = torch.device("cpu")


def filled(parts):
    normaliser = Normaliser(parts[0].shape[1], CPU)
    for part in parts:
        normaliser.update(part.mean(0), part.var(0, unbiased=False), len(part))
    return normaliser


def batches():
    torch.manual_seed(0)
    parts = [
        torch.randn(count, 5) * torch.tensor([1.0, 0.1, 3.0, 0.0, 0.5]) + i for i, count in enumerate((7, 50, 400))
    ]
    for part in parts:
        part[:, 3] = 2.5  # never varies
    return parts


def test_moments_are_those_of_all_that_was_seen():
    parts = batches()
    normaliser, everything = filled(parts), np.concatenate([part.numpy() for part in parts])
    assert np.allclose(normaliser.mean, everything.mean(axis=0), atol=1e-5)
    assert np.allclose(normaliser.variance, everything.var(axis=0), atol=1e-4)
    seen = normaliser(torch.as_tensor(everything))
    varied = [0, 1, 2, 4]
    assert seen[:, varied].mean(0).abs().max() < 1e-4 and (seen[:, varied].var(0) - 1.0).abs().max() < 0.01


def test_what_never_varied_is_left_as_it_is():
    assert (filled(batches())(torch.full((1, 5), 2.5))[0, 3]) == 2.5


def test_before_the_first_observation_it_is_the_identity():
    observations = torch.randn(4, 5)
    assert torch.equal(Normaliser(5, CPU)(observations), observations)


def test_a_folded_network_gives_the_same_answers():
    normaliser, network = filled(batches()), build_network([5, 16, 2])
    observations = batches()[2]
    before = network(normaliser(observations))
    assert (normaliser.fold(network)(observations) - before).abs().max() < 1e-5
    assert torch.equal(network(normaliser(observations)), before)  # the learner's own network is untouched
