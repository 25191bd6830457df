"""Wrong numbers: which few of the configured parameters explain the gap, beside the effects found.

Physical groups of parameters are freed one after another, all else as configured: each time the one that explains most,
while that is clear and enough to tell of; one that others have made needless goes again. What a refit of all parameters
explains beyond that must earn its place: else the vehicle that is written has these few changed only.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.unknowns import Unknown
from racerl.gap.candidates import unfitted
from racerl.gap.comparison import ALL, CLEAR, REAL, WORTH, Judge, total, wild
from racerl.gap.cross_validation import held_out
from racerl.gap.fitted_model import COG, LONGEST, FittedModel, fit_model, unknowns_with
from racerl.gap.groups import GROUPS, NUMBERS
from racerl.gap.investigation import Investigation
from racerl.gap.progress import OnProgress, silent
from racerl.gap.stage_problem import StageProblem
from racerl.gap.uncertainty import intervals
from racerl.vehicle.parameter import replace_values, specifications, values
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
GRIP = "friction"
SPREAD = 0.5  # deviation of a number's prior, as a share of it: no more than a restraint
MOST = 4  # groups; a car that differs in more is another car


@dataclass(frozen=True)
class Gained:
    """By which share a group of numbers lowered the gap as configured when it came in, in the stages it acts in."""

    share: float
    stages: tuple[str, ...]


@dataclass(frozen=True)
class Numbers:
    """The vehicle as configured, with the effects found and some groups of numbers fitted.

    `explained` is the share of the gap as configured that all groups take, over all stages, `rest` what a refit of
    everything takes beyond that, 0 where held-out windows do not ask for it; `cost` per window (W,) of every stage.
    """

    gained: dict[str, Gained]
    found: FittedModel
    cost: Mapping[str, Array]
    explained: float = 0.0
    rest: float = 0.0


def wrong_numbers(investigation: Investigation, named: FittedModel, on_progress: OnProgress = silent) -> Numbers:
    """Return which few numbers explain the gap as configured, beside the effects of a fit."""
    gap = _Gap(investigation, named, unfitted(investigation))
    whole = {**held_out(investigation, investigation.base), **held_out(investigation, named)}
    refitted = Numbers({}, named, whole, rest=1.0)
    if not all(np.isfinite(part).all() for part in gap.configured.cost.values()):  # it blows up: nothing to go on from
        return refitted
    few = first = gap.fitted((), Numbers({}, gap.configured, gap.configured.cost))
    for number in range(MOST):
        on_progress("numbers", number / MOST)
        best = _best(gap, few)
        if best is None:
            break
        few = _pruned(gap, best)
    rest = gap.gain(few, refitted, gap.open()) if any(gap.gains(few, refitted, [each]) for each in gap.open()) else 0.0
    return replace(few, explained=gap.gain(first, few, gap.open()), rest=max(rest, 0.0))


def _best(gap: "_Gap", few: Numbers) -> Numbers | None:
    """Return the numbers with the group more that explains most, of those that earn their place; None without any."""

    def tried(group: str) -> Numbers:
        more = gap.fitted((*few.gained, group), few)
        stages = gap.stages_of(group)
        return replace(more, gained={**few.gained, group: Gained(gap.gain(few, more, stages), tuple(stages))})

    groups = [group for group in gap.possible() if group not in few.gained]
    trials = zip(groups, gap.investigation.workers.each(tried, groups), strict=True)
    earned = [more for group, more in trials if gap.tells(few, more, gap.stages_of(group))]
    return min(earned, key=lambda more: gap.share(more.cost), default=None)


def _pruned(gap: "_Gap", few: Numbers) -> Numbers:
    """Return the numbers without those that the last one has made needless."""
    for group in list(few.gained)[:-1]:
        less = gap.fitted([name for name in few.gained if name != group], few)
        if not gap.tells(less, few, gap.stages_of(group)):
            few = less
    return few


@dataclass(frozen=True)
class _Gap:
    """The gap of the vehicle as configured, and the fit with the effects that it was found to lack."""

    investigation: Investigation
    named: FittedModel
    configured: FittedModel

    @cached_property
    def judge(self) -> Judge:
        """What tells a clear gain."""
        return Judge(self.investigation, self.configured.cost)

    def open(self) -> list[str]:
        """Return the stages in which there is a gap."""
        floor = self.investigation.floor
        return [stage for stage in floor if self._excess(self.configured.cost, stage) > REAL * floor[stage]]

    def share(self, cost: Mapping[str, Array], stages: Sequence[str] | None = None) -> float:
        """Return what windows' costs (W,) leave of the gap as configured, over what noise costs, in some stages."""
        among = [stage for stage in self.open() if stages is None or stage in stages]
        left, had = (total(self._excess(each, stage) for stage in among) for each in (cost, self.configured.cost))
        return left / max(had, 1e-9)

    def _excess(self, cost: Mapping[str, Array], stage: str) -> float:
        most = wild(self.investigation, stage, self.configured.cost[stage])
        return float(np.minimum(cost[stage], most).sum()) - self.investigation.floor[stage]

    def gain(self, few: Numbers, more: Numbers, stages: Sequence[str]) -> float:
        """Return by which share of the gap one fit explains more than another."""
        return self.share(few.cost, stages) - self.share(more.cost, stages)

    def gains(self, few: Numbers, more: Numbers, stages: Sequence[str]) -> bool:
        """Return whether one fit explains more than another in some stages: clearly, and beyond what noise may be."""
        parts = [{stage: each.cost[stage] for stage in stages} for each in (few, more)]
        gain, error = self.judge.gain(*parts)
        fall = sum(self._excess(few.cost, stage) - self._excess(more.cost, stage) for stage in stages)
        return gain > CLEAR * error and fall > REAL * sum(self.investigation.floor[stage] for stage in stages)

    def tells(self, few: Numbers, more: Numbers, stages: Sequence[str]) -> bool:
        """Return whether what one fit explains more is enough to tell of: of the gap, or of what is left of it."""
        share = self.gain(few, more, stages)
        return self.gains(few, more, stages) and (share > WORTH or share > ALL * self.share(few.cost, stages))

    def stages_of(self, group: str) -> list[str]:
        """Return the stages with a gap that a group acts in."""
        return [stage for stage in self._stages(self._unknowns(GROUPS[group])) if stage in self.open()]

    def possible(self) -> list[str]:
        """Return the groups that the log's stages depend on; a displaced centre of gravity is one already."""
        return [
            group
            for group, names in GROUPS.items()
            if self.stages_of(group) and not (COG in self.named.effects and "l_f" in names)
        ]

    def fitted(self, groups: Sequence[str], start: Numbers) -> Numbers:
        """Return the vehicle with its effects and some groups fitted, from where others ended."""
        own = self._free_effects()
        free = [*own, *self._unknowns([name for group in groups for name in GROUPS[group]])]
        stages = self._stages(free)
        if not stages:
            return start
        configured, fitted = values(self.investigation.vehicle), {u.name for u in free}
        back = {name: float(configured[name]) for name in NUMBERS if name in configured and name not in fitted}
        vehicle = replace_values(self._begun(start.found), back)
        found = fit_model(
            self.investigation,
            self.named.effects,
            vehicle,
            start.found,
            LONGEST,
            stages=stages,
            free=free,
            strength=dict.fromkeys(self.investigation.evidence, 1.0),
        )
        gained = {group: start.gained[group] for group in groups if group in start.gained}
        return Numbers(gained, found, {**self.configured.cost, **found.cost})

    def _begun(self, found: FittedModel) -> Vehicle:
        """Return the vehicle of a fit, with the effects found if it lacks them."""
        lacking = {name: self.named.vehicle.effects[name] for name in self.named.effects - set(found.vehicle.effects)}
        return replace(found.vehicle, effects={**found.vehicle.effects, **lacking})

    def _free_effects(self) -> list[Unknown]:
        unknowns = unknowns_with(self.investigation, self.named.effects, self.named.vehicle)
        return [unknown for unknown in unknowns if unknown.effect]

    def _unknowns(self, names: Iterable[str]) -> list[Unknown]:
        """Return parameters with priors that are no more than a restraint; what a refit may not change stays so.

        Grip of the floor is held in a refit, for those of the tyres stand in for it.
        """
        investigation, known = self.investigation, {unknown.name: unknown for unknown in self.investigation.unknowns}
        grip = float(values(investigation.vehicle)[GRIP])
        bounds = specifications(investigation.vehicle)[GRIP]
        known[GRIP] = Unknown(GRIP, grip, 1.0, *investigation.limits.get(GRIP, (bounds.low, bounds.high)))
        free = [known[name] for name in names if name in known and known[name].low < known[name].high]
        return [replace(each, sigma=SPREAD * abs(each.start)) for each in free if each.start]

    def _stages(self, unknowns: Sequence[Unknown]) -> list[str]:
        """Return the stages whose outcome depends on any of the unknowns."""
        vehicle, kernels = self.named.vehicle, self.investigation.kernels
        return [
            name
            for name, evidence in self.investigation.evidence.items()
            if StageProblem.touched(evidence, kernels[name], vehicle, unknowns)
        ]


def as_configured(investigation: Investigation, numbers: Numbers, error: float) -> dict[str, Any]:
    """Return what a verdict says of the numbers as configured; `error` is that of the vehicle as configured."""
    ranges = intervals(investigation, numbers.found) if numbers.gained else {}
    table = values(investigation.vehicle)
    changes = [
        {
            "parameter": name,
            "what": group,
            "from": float(table[name]),
            "to": value,
            "ci95": [low, high],
            "explained": gained.share,
            "stages": list(gained.stages),
        }
        for group, gained in numbers.gained.items()
        for name, (value, low, high) in ranges.items()
        if name in GROUPS[group] and not low <= float(table[name]) <= high
    ]
    return {"error": error, "explained": numbers.explained, "changes": changes, "rest": numbers.rest}
