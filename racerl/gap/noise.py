"""What the sensors' noise alone would leave of errors, if a fitted vehicle were right: the floor of every gap."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from racerl.gap.checkpoint import Parts
from racerl.gap.fit_data import FitData
from racerl.gap.fitted_model import FittedModel
from racerl.gap.stage_fit import StageFit
from racerl.gap.stage_problem import StageProblem

Array = NDArray[np.float64]
Seed = int | Sequence[int]
DRAWS = 8  # of the noise, whose mean cost is the floor: one alone is a percent or two off
CALM = 10.0  # times the noise's cost in a usual window, beyond which a window's tells of the vehicle


def expected_errors(stage: StageProblem, theta: Mapping[str, float], initial: Array, noise: Array, seed: Seed) -> Array:
    """Return the errors (T + 1, C, W) that a right vehicle would leave: one draw of the sensors' `noise` (C,).

    Noise of measured inputs counts: it drives the car that is simulated, not the one that was measured.
    """
    generator = np.random.default_rng(seed)
    alone = stage.at(theta)
    still = replace(alone.windows({}), initial=initial)
    truth = stage.rollout.predict(alone.parameters({}), still)
    noisy = replace(alone, evidence=stage.evidence.with_noisy_inputs(generator))
    work = StageFit(noisy, {}, None)
    shown = truth + noise[:, None] * generator.standard_normal(truth.shape)
    work.windows = replace(work.windows, measured=np.ascontiguousarray(shown))
    work.initial = initial.copy()
    work.settled()
    return work.errors({})


def expected(data: FitData, found: FittedModel, seed: Seed) -> dict[str, Array]:
    """Return the errors (T + 1, C, W) per stage that sensors' noise alone would leave in a right vehicle."""
    return {
        (name := stage.evidence.stage.name): expected_errors(stage, found.theta, initial, data.noise[name], seed)
        for stage, initial in zip(found.problem.stages, found.fit.initial, strict=True)
    }


def noise_cost(data: FitData, found: FittedModel, seed: int) -> dict[str, float]:
    """Return the cost per stage that noise alone would leave if a fitted vehicle were right: a mean of draws."""
    return {name: float(draws.mean()) for name, draws in noise_draws(data, found, seed).items()}


def noise_draws(data: FitData, found: FittedModel, seed: int) -> dict[str, Array]:
    """Return that cost in every draw of the noise, (DRAWS,) per stage."""

    def drawn(number: int) -> dict[str, float]:
        return squares(data, expected(data, found, [seed, number]))

    def costs() -> Parts:
        draws = data.workers.each(drawn, range(DRAWS))
        return {name: np.array([draw[name] for draw in draws]) for name in found.cost}

    parts = data.checkpoint.recall(data.checkpoint.key("noise", found.key, data.noise, seed, DRAWS), costs)
    return {name: parts[name] for name in found.cost}


def squares(data: FitData, errors: Mapping[str, Array]) -> dict[str, float]:
    """Return the summed cost per stage; a window in which noise makes the vehicle spin counts up to a limit."""
    costs = {name: ((part / data.sigma[name][:, None]) ** 2).sum(axis=(0, 1)) for name, part in errors.items()}
    return {name: float(np.minimum(part, CALM * np.median(part)).sum()) for name, part in costs.items()}
