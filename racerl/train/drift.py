"""What a policy is paid for drifting while it learns: bonus · w(|β|) Δt beside its progress, fading to none.

β is the car's side slip; w = max(0, best − ||β| − best|) rises to the best slip and falls beyond it. A car may have two
ways round a bend, one with little slip and a faster one with much, and no gain in between: progress alone then teaches
the one that it comes upon first. A policy that learned to drift keeps what is faster of it once only progress counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from racerl import bounds
from racerl.env.race import V_X, V_Y, Race, Step
from racerl.env.races import Races
from racerl.errors import ConfigError

SLOWEST = 0.3  # m/s, as which any car counts, so that one that stands does not drift


@dataclass(frozen=True)
class Drift:
    """How much drifting is worth; `conf/algo/ppo_drift.yaml` says what each number is."""

    bonus: float
    best: float
    fades: Sequence[float]

    def __post_init__(self) -> None:
        bounds.number("algo.drift.bonus", self.bonus, 0.0, 1e3)
        bounds.number("algo.drift.best", self.best, 0.0, 1.5)
        expected = "two shares of the training are expected, as [0.2,0.6]"
        begins, ends = bounds.pair("algo.drift.fades", self.fades, 0.0, 1.0, expected)
        if begins >= ends:
            raise ConfigError(f"algo.drift.fades = {list(self.fades)}: the first is to be less than the second")

    def worth(self, done: float) -> float:
        """Return the bonus in m of progress per rad s after so great a share of the training."""
        begins, ends = self.fades
        return self.bonus * min(1.0, max(0.0, (ends - done) / (ends - begins)))

    def pay(self, race: Race | Races, step: Step, done: float) -> Tensor:
        """Return what the cars (N,) get for their slip after a step, in m; those that start over get nothing."""
        worth = self.worth(done)
        if worth == 0.0:
            return torch.zeros_like(step.reward)
        slip = torch.atan2(race.state[V_Y].abs(), race.state[V_X].clamp(min=SLOWEST))
        weight = (self.best - (slip - self.best).abs()).clamp(min=0.0)
        paid: Tensor = worth * race.timing.dt * weight
        return paid.masked_fill(step.terminated | step.truncated, 0.0)
