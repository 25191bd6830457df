"""Eliminating initial states window by window solves the whole system."""

import numpy as np
import pytest

from racerl.estimation.schur import WindowEquations


def test_elimination_solves_the_whole_system():
    W, N, A = 4, 3, 2
    J = np.random.default_rng(0).standard_normal((W, 9, N + A))
    r = np.random.default_rng(1).standard_normal((W, 9))
    H, g = J.transpose(0, 2, 1) @ J, np.einsum("wki,wk->wi", J, r)
    parts = WindowEquations(H[:, :N, :N], H[:, :N, N:], H[:, N:, N:], g[:, :N], g[:, N:])
    whole, right = np.zeros((N + W * A, N + W * A)), np.zeros(N + W * A)
    for w in range(W):
        place = [*range(N), *range(N + w * A, N + (w + 1) * A)]
        whole[np.ix_(place, place)] += H[w]
        right[place] += g[w]
    step = -np.linalg.solve(whole, right)
    reduced, slope = (part.sum(axis=0) for part in parts.reduced())
    moved = -np.linalg.solve(reduced, slope)
    assert moved == pytest.approx(step[:N], rel=1e-6)
    assert parts.follow(moved).T.ravel() == pytest.approx(step[N:], rel=1e-6)


def test_what_a_window_does_not_tell_stays():
    none = np.zeros((1, 1, 1))
    parts = WindowEquations(np.ones((1, 1, 1)), none, none, np.ones((1, 1)), np.zeros((1, 1)))
    assert parts.follow(np.array([2.0])) == pytest.approx(0.0)
    assert parts.reduced()[0] == pytest.approx(1.0)
