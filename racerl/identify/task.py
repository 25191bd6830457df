"""What a fit is made of, and how it is carried out: several starts, then the prior's strength set by what is left.

At last what the log does not tell is put back to where it was configured, and the others are fitted once more.

An actuator that was logged with its command answers to nothing else. It is fitted first, from its command to its
measured state, and held when the car is fitted, so that what the car's model lacks cannot move it.
"""

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl import registry
from racerl.data.log import CHANNELS, Log
from racerl.errors import ConfigError, suggest
from racerl.estimation.independence import independent_residuals
from racerl.estimation.unknowns import Unknowns
from racerl.identify import methods as methods_package
from racerl.identify.methods import Fit, Method
from racerl.identify.objective import Objective
from racerl.identify.told import NOTHING, posterior
from racerl.identify.uncertainty import Uncertainty, estimate
from racerl.identify.windows import Cut, Wiring, channel_scale, cut
from racerl.identify.work import Work
from racerl.vehicle.rollout import Equations, Rollout
from racerl.vehicle.vehicle import STATE, Vehicle

Array = NDArray[np.float64]
ENOUGH = 400  # windows for the starts
ROUNDS = 2  # fits between which the prior's strength is set by the residuals that are left
MOST_WINDOWS = 3000  # of a fit: long logs are cut with less overlap, very long ones with gaps
START_SPREAD = 0.7  # of the priors' deviations, of the further starts


@dataclass(frozen=True)
class Task:
    """What a fit is made of: the rollout, its unknowns, the windows and how their errors count.

    `actuators` are fitted first, in the same windows; what they settle of the unknowns is held.
    """

    rollout: Rollout
    unknowns: Unknowns
    cut: Cut
    scale: Array
    weight: Array
    overlap: float
    method: Method
    still: tuple[str, ...] = ()  # states whose initial values are known
    actuators: tuple["Task", ...] = ()

    def objective(self, index: NDArray[np.int64], independent: float, data: float) -> Objective:
        """Return F over some windows, with the prior as strong as `independent` residuals of mean square `data` ask."""
        windows = self.cut.windows.take(index)
        penalty = data / independent
        return Objective(self.rollout, self.unknowns, windows, self.scale, self.weight, penalty, self.still)


@dataclass(frozen=True)
class Solution:
    """A fit with its objective, how many independent residuals it was made from, and those of the actuators.

    `free` is the fit before what the log does not tell was held: it says how sure every number is.
    """

    fit: Fit
    free: Fit
    objective: Objective
    independent: float
    actuators: tuple["Solution", ...] = ()

    @property
    def converged(self) -> bool:
        """Whether all fits have."""
        return self.fit.converged and all(part.converged for part in self.actuators)

    @property
    def values(self) -> dict[str, float]:
        """The parameters found, by name."""
        return dict(zip(self.objective.unknowns.names, self.fit.point.theta.tolist(), strict=True))

    def uncertainty(self, task: Task, seed: int) -> Uncertainty:
        """Return what the windows of the task that was solved say about each parameter."""
        earlier = [
            part.uncertainty(alone, seed + number)
            for number, (part, alone) in enumerate(zip(self.actuators, task.actuators, strict=True), 1)
        ]
        found = estimate(self.free, self.objective, task.cut, self.independent, seed, earlier)
        back = self.fit.point.theta - self.free.point.theta
        draws = found.draws + back
        return replace(found, draws=np.where(back, self.objective.unknowns.clip(draws), draws))

    @property
    def posterior(self) -> tuple[Array, Array]:
        """Return the share of each prior's deviation that is left (P,), and correlations (P, P); actuators' are own."""
        share, correlation = posterior(self.free, self.objective)
        names = self.objective.unknowns.names
        for part in self.actuators:
            for name, own in zip(part.objective.unknowns.names, part.posterior[0].tolist(), strict=True):
                i = names.index(name)
                share[i], correlation[i], correlation[:, i] = own, 0.0, 0.0
        return share, correlation


def make_task(
    settings: Mapping[str, Any], rollout: Rollout, unknowns: Unknowns, wiring: Wiring, logs: Sequence[Log]
) -> Task:
    """Cut the logs and choose scale, weights and method; raise LogError or ConfigError where that fails."""
    length = settings["window"]
    stride = max(sum(len(log.table) for log in logs) // MOST_WINDOWS, 1, length // 5)
    parts = cut(logs, wiring, rollout.vehicle, length, stride, settings["slowest"])
    whole = Task(
        rollout,
        unknowns,
        parts,
        channel_scale(logs, wiring.observed),
        _weights(settings["weights"], wiring),
        max(1.0, (length + 1) / stride),
        registry.create(methods_package, settings["method"]),
        parts.still(wiring),
    )
    return replace(whole, actuators=tuple(_actuators(whole)))


def _actuators(whole: Task) -> Iterator[Task]:
    """Yield a fit of each actuator that was measured beside its command and that nothing but the command moves."""
    vehicle, observed = whole.rollout.vehicle, whole.rollout.observed
    for channel, state in enumerate(observed):
        if whole.weight[channel] and (names := own_parameters(vehicle, whole.unknowns.names, state)):
            seen = slice(channel, channel + 1)
            yield replace(
                whole,
                rollout=Rollout(vehicle, names, (state,), whole.rollout.step),
                unknowns=whole.unknowns.only(names),
                cut=whole.cut.observing(seen),
                scale=whole.scale[seen],
                weight=whole.weight[seen],
            )


def own_parameters(vehicle: Vehicle, names: Sequence[str], state: str) -> list[str]:
    """Return those of `names` that a measured state answers to; none where other states of the car move it, too."""
    alone = Equations(vehicle, names, (state,))
    return [] if set(alone.active) & (set(STATE) - {state}) else alone.effective


def _weights(given: Mapping[str, Any], wiring: Wiring) -> Array:
    for channel, weight in given.items():
        if channel not in CHANNELS:
            raise ConfigError(f"weights: no channel '{channel}'{suggest(channel, CHANNELS)}")
        if isinstance(weight, bool) or not isinstance(weight, (int, float)) or not 0 <= weight < np.inf:
            raise ConfigError(f"weights.{channel} = {weight}: allowed is a number ≥ 0")
    weights = np.array([float(given.get(channel, 1.0)) for channel in wiring.observed])
    if not weights.any():
        raise ConfigError(f"weights: all of {', '.join(wiring.observed)} are 0; leave one to fit")
    return weights


def plan(windows: int, starts: int) -> list[tuple[int, int]]:
    """Return (place, windows) of the fits that `solve` carries out, as `Work` counts them."""
    return [(0, min(windows, ENOUGH))] * starts + [(number, windows) for number in range(1, ROUNDS + 2)]


def solve(task: Task, index: NDArray[np.int64], seed: int, starts: int, work: Work) -> Solution:
    """Fit from several starts, then once more with the prior's strength set by what is left; actuators first."""
    actuators = tuple(solve(alone, index, seed, 1, Work([])) for alone in task.actuators)
    known = {name: value for part in actuators for name, value in part.values.items()}
    task = replace(task, unknowns=task.unknowns.settled(known))
    return replace(_solve(task, index, seed, starts, work), actuators=actuators)


def _solve(task: Task, index: NDArray[np.int64], seed: int, count: int, work: Work) -> Solution:
    generator = np.random.default_rng(seed)
    starts = [task.unknowns.clip(task.unknowns.start)]
    starts += [task.unknowns.draw(generator, START_SPREAD) for _ in range(count - 1)]

    # the starts see a share of the windows, with one independent residual for each window and channel
    some = index[:: max(1, len(index) // ENOUGH)]
    alone = len(some) * int((task.weight > 0).sum())
    objective = task.objective(some, alone, 0.0)
    objective = task.objective(some, alone, objective.linearise(objective.start(starts[0])).data)
    fits = []
    for theta in starts:
        fits.append(task.method.fit(objective, objective.start(theta), work.step))
        work.finish()
    best = min(fits, key=lambda fit: fit.linearised.cost)
    for number in range(ROUNDS):
        shown = objective.residuals(best.point)[:, task.weight > 0]
        independent = independent_residuals(shown) / task.overlap * len(index) / shown.shape[2]
        objective = task.objective(index, independent, best.linearised.data)
        point = best.point if number else objective.start(best.point.theta)
        best = task.method.fit(objective, point, work.step)
        work.finish()
    return Solution(_held(task, objective, best, work), best, objective, independent)


def _held(task: Task, objective: Objective, fit: Fit, work: Work) -> Fit:
    """Return the fit with what the log does not tell as configured, the others fitted once more."""
    unknowns = objective.unknowns
    untold = (posterior(fit, objective)[0] > NOTHING) & (unknowns.low < unknowns.high)
    if untold.any():
        theta = np.where(untold, unknowns.start, fit.point.theta)
        names = [name for name, idle in zip(unknowns.names, untold.tolist(), strict=True) if idle]
        held = copy.copy(objective)
        held.unknowns = unknowns.settled({name: float(theta[unknowns.names.index(name)]) for name in names})
        fit = task.method.fit(held, replace(fit.point, theta=theta), work.step)
    work.finish()
    return fit
