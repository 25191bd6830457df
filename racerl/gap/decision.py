"""A decision in the making: the effects kept so far, the fit with them, and what it leaves."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl.gap.candidates import converged
from racerl.gap.comparison import CLEAR, CandidateScore, Judge, Standing, excess
from racerl.gap.cross_validation import held_out
from racerl.gap.fit_data import FitData
from racerl.gap.fitted_model import FittedModel, better_half_way
from racerl.gap.investigation import Investigation
from racerl.gap.noise import noise_cost
from racerl.gap.score import Score

Array = NDArray[np.float64]
CARRIED = 3  # times that the fit of what was chosen is carried on, unless it is at its end before


@dataclass
class Decision(Standing):
    """What naming came to: effects in the order found, every round's candidates, best first.

    `noise` is by the first fit or this one. The effects are beside the vehicle of `investigation`.
    """

    investigation: Investigation
    kept: dict[str, list[CandidateScore]]  # every effect, and its rivals, beside the others
    score: Score  # of the refitted vehicle without effects
    rounds: list[list[CandidateScore]] = field(default_factory=list)
    features: list[dict[str, Any]] = field(default_factory=list)  # of every round
    excess: list[float] = field(default_factory=list)  # of the cost over the noise, before each round and at the end
    doubted: str = ""  # what held-out windows ask for beside these effects, though it is rather of no catalogue

    @property
    def chosen(self) -> list[str]:
        """The effects."""
        return list(self.kept)


def changed(
    investigation: Investigation, decision: Decision, kept: dict[str, list[CandidateScore]], found: FittedModel
) -> Decision:
    """Return the decision with other effects; a vehicle that is far off passes on too much noise: the least counts."""
    cost = {**decision.cost, **held_out(investigation, found)}
    passed = noise_cost(investigation, found, investigation.seed)
    noise = {stage: min(most, passed.get(stage, most)) for stage, most in investigation.floor.items()}
    left = [*decision.excess, excess(investigation, cost, noise)]
    return replace(decision, kept=kept, found=found, cost=cost, noise=noise, excess=left, doubted="")


def carried(data: FitData, found: FittedModel) -> FittedModel:
    """Return a fit carried on, from both its starts: else any effect beside it gains by doing so."""
    for _ in range(CARRIED):
        found = converged(data, found)
    return better_half_way(data, found)


def passes_less_noise(judge: Judge, decision: Decision, best: CandidateScore, errors: float = CLEAR) -> bool:
    """Return whether a candidate gains by passing on less of the measured inputs' noise, not by knowing the car.

    Soft tyres that lag, and a time shift that takes the lag back, smooth what drives a slow car.
    """
    noise = noise_cost(judge.investigation, best.found, judge.investigation.seed)
    passed = (judge.slope(stage, decision.cost[stage]) * (decision.noise[stage] - noise[stage]) for stage in noise)
    return best.gain - sum(passed) < errors * best.error
