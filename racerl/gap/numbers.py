"""Wrong numbers: which few of the configured ones explain the gap, beside the effects found.

Numbers are freed one after another, all else as configured: each time the one that explains most, while that is clear
and enough to tell of, and as long as it stays in reach of what was configured; one that others have made needless goes
again. A refit of all parameters around these must then earn its place: else the vehicle has these few changed only.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.unknowns import Unknown
from racerl.gap.candidates import unfitted
from racerl.gap.comparison import ALL, CLEAR, FOREIGN, MOST, REAL, WORTH, Judge, total, wild
from racerl.gap.configurable import NUMBERS
from racerl.gap.cross_validation import held_out
from racerl.gap.fit_data import sampled
from racerl.gap.fitted_model import COG, LONGEST, FittedModel, fit_model, settled_fit, stages_with, unknowns_with
from racerl.gap.investigation import Investigation
from racerl.gap.progress import OnProgress, silent
from racerl.gap.uncertainty import intervals
from racerl.identify.tyres import forces
from racerl.vehicle.parameter import replace_values, specifications, values
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
GRIP = "friction"
SPREAD = 0.5  # deviation of a number's prior, as a share of it: no more than a restraint
REACH = 2.5  # times what was configured, or its inverse: what runs further is something else in disguise
ALL_PEAKS = ("front.p_Dx1", "front.p_Dy1", "rear.p_Dx1", "rear.p_Dy1")
BACK = 0.5  # share of its change that a refit may take back of a number that is told
SEVERAL = 4  # numbers at most; a car that differs in more is another car
ALONE = ("yaw_inertia", "l_f", "steering.time_constant", "drive.time_constant")  # numbers that are not the tyres'
SLIGHT = 0.02  # share by which a refit may move such a number without being asked for
STEPS, FULLY = 4, 5  # of a trial on a share of the windows; numbers that are fitted to all of them then


@dataclass(frozen=True)
class Gained:
    """By which share a number lowered the gap as configured when it came in, in the stages it acts in."""

    share: float
    stages: tuple[str, ...]


@dataclass(frozen=True)
class Numbers:
    """The vehicle as configured, with the effects found and some numbers fitted.

    `explained` is the share of the gap as configured that all numbers take, over all stages; `cost` per window (W,) of
    every stage. `refitted` is a refit of all parameters around them, where held-out windows ask for it, and `rest` the
    share that it takes beyond them; else None and 0.
    """

    gained: dict[str, Gained]
    found: FittedModel
    cost: Mapping[str, Array]
    explained: float = 0.0
    rest: float = 0.0
    refitted: FittedModel | None = None

    @property
    def vehicle(self) -> FittedModel:
        """The fit to go on with: no more changed than the log asks for."""
        return self.refitted or self.found


def wrong_numbers(investigation: Investigation, named: FittedModel, on_progress: OnProgress = silent) -> Numbers:
    """Return which few numbers explain the gap as configured, beside the effects of a fit."""
    gap = _Gap(investigation, named, unfitted(investigation))
    few = gap.unchanged
    if not all(np.isfinite(part).all() for part in few.cost.values()):  # it blows up: nothing to go on from
        return replace(few, rest=1.0, refitted=named)
    few = first = gap.fitted((), few)
    for number in range(SEVERAL):
        on_progress("numbers", number / (SEVERAL + 1))
        best = _best(gap, few)
        if best is None:
            break
        few = _pruned(gap, best)
    on_progress("numbers", SEVERAL / (SEVERAL + 1))
    few, around = _confirmed(gap, few)
    few = replace(few, explained=gap.gain(first, few, gap.open))
    if around is None:
        return few
    rest = sum(max(gap.fall(few, around, stage), 0.0) for stage in gap.open) / gap.excess
    rest = min(max(rest, gap.gain(few, around, gap.open)), gap.share(few.cost))
    return replace(few, rest=rest, refitted=around.found)


def _confirmed(gap: "_Gap", few: Numbers) -> tuple[Numbers, Numbers | None]:
    """Return the numbers that a refit of everything leaves near where they are told, and that refit if it is asked for.

    What a refit takes back was something else in disguise: a yaw inertia in place of a tyre's shape.
    """
    named = gap.held_out(gap.named)
    while True:
        around = gap.held_out(_refitted(gap, few)) if few.gained else named
        if any(gap.gains(around, named, [stage]) for stage in gap.open):
            around = named
        if not any(gap.gains(few, around, [stage]) for stage in gap.open):
            return few, None
        kept = [name for name in few.gained if gap.stays(name, few, around)]
        if len(kept) == len(few.gained):
            return few, _left_alone(gap, few, around)
        few = gap.fitted(kept, few) if kept or gap.named.effects else gap.unchanged


def _left_alone(gap: "_Gap", few: Numbers, around: Numbers) -> Numbers:
    """Return a refit that leaves the numbers of body and actuators where they were, at least those it does not know.

    On circles yaw inertia takes up what the tyres' formula leaves: what moving it explains must be worth telling of.
    """
    was, ranges = few.found.theta, intervals(gap.investigation, around.found)
    moved = [name for name in ALONE if name in ranges and abs(ranges[name][0] / was[name] - 1.0) > SLIGHT]
    unknown = [name for name in moved if ranges[name][1] <= was[name] <= ranges[name][2]]
    for names in dict.fromkeys((tuple(moved), tuple(unknown))):
        still = gap.held_out(_refitted(gap, few, names)) if names else around
        if gap.slight(still, around):
            return still
    return around


def _best(gap: "_Gap", few: Numbers) -> Numbers | None:
    """Return the numbers with the one more that explains most, of those that are to be told; None without any."""

    def tried(name: str) -> Numbers:
        more, stages = gap.fitted((*few.gained, name), few), gap.stages_of(name)
        return replace(more, gained={**few.gained, name: Gained(gap.gain(few, more, stages), tuple(stages))})

    names = _promising(gap, few)
    trials = zip(names, gap.investigation.workers.each(tried, names), strict=True)
    told = [more for name, more in trials if gap.tells(few, more, gap.stages_of(name)) and gap.in_reach(more)]
    return min(told, key=lambda more: gap.share(more.cost), default=None)


def _promising(gap: "_Gap", few: Numbers) -> list[str]:
    """Return the few numbers that a few steps on a share of the windows put first, of those not yet freed."""
    names = [name for name in gap.possible() if name not in few.gained]
    falls = gap.investigation.workers.each(lambda name: gap.fall_in_a_few_steps([*few.gained, name], few), names)
    order = sorted(zip(falls, names, strict=True), key=lambda each: -each[0])
    return [name for _, name in order[:FULLY]]


def _pruned(gap: "_Gap", few: Numbers) -> Numbers:
    """Return the numbers without those that the last one has made needless."""
    for name in list(few.gained)[:-1]:
        less = gap.fitted([other for other in few.gained if other != name], few)
        if not gap.tells(less, few, gap.stages_of(name)):
            few = less
    return few


def _refitted(gap: "_Gap", few: Numbers, held: Collection[str] = ()) -> FittedModel:
    """Return a fit of all parameters but those held, all expected where a few numbers changed have them.

    It starts from the refit that named, with the floor's grip as told: the same forces, for the tyres' take it back.
    """
    theta = few.found.theta
    around = [
        replace(unknown, start=min(max(theta[unknown.name], unknown.low), unknown.high))
        for unknown in gap.investigation.unknowns
        if unknown.name not in held
    ]
    data, table = replace(gap.investigation, unknowns=around), gap.named.theta
    grip = theta[GRIP]
    same = {
        **{name: theta[name] for name in held},
        GRIP: grip,
        **{peak: table[peak] * table[GRIP] / grip for peak in ALL_PEAKS},
    }
    vehicle = replace_values(gap.named.vehicle, same)
    return settled_fit(data, gap.named.effects, vehicle, gap.named, stages=list(gap.investigation.evidence))


def _size(name: str, vehicle: Vehicle) -> float:
    """Return a number; of grip, the largest force over the load: a refit may give it to a curve's other coefficients.

    Grip of the floor is that of both axles sideways, a tyre's own is over the floor's.
    """
    largest = {key: float(np.abs(curve).max()) for key, curve in forces(vehicle).items()}
    if name == GRIP:
        return 0.5 * (largest["front", "y"] + largest["rear", "y"])
    if name in ALL_PEAKS:
        axle, _, key = name.rpartition(".")
        return largest[axle, key[len("p_D")]] / float(vehicle.friction)
    return float(values(vehicle)[name])


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

    @cached_property
    def open(self) -> list[str]:
        """The stages in which there is a gap."""
        floor = self.investigation.floor
        return [stage for stage in floor if self._excess(self.configured.cost, stage) > REAL * floor[stage]]

    def share(self, cost: Mapping[str, Array], stages: Sequence[str] | None = None) -> float:
        """Return what windows' costs (W,) leave of the gap as configured, over what noise costs, in some stages."""
        among = [stage for stage in self.open if stages is None or stage in stages]
        left, had = (total(self._excess(each, stage) for stage in among) for each in (cost, self.configured.cost))
        return left / max(had, 1e-9)

    @cached_property
    def excess(self) -> float:
        """The cost of the vehicle as configured beyond that of noise, over the stages with a gap."""
        return total(self._excess(self.configured.cost, stage) for stage in self.open)

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
        fall = sum(self.fall(few, more, stage) for stage in stages)
        return gain > CLEAR * error and fall > REAL * sum(self.investigation.floor[stage] for stage in stages)

    def fall(self, few: Numbers, more: Numbers, stage: str) -> float:
        """Return by how much less one fit costs than another in a stage, a window that no fit foresaw no matter."""
        gain, _ = self.judge.gain({stage: few.cost[stage]}, {stage: more.cost[stage]})
        return gain / self.judge.slope(stage, few.cost[stage])

    def tells(self, few: Numbers, more: Numbers, stages: Sequence[str]) -> bool:
        """Return whether what one fit explains more is enough to tell of: of the gap, or of what is left of it."""
        share = self.gain(few, more, stages)
        return self.gains(few, more, stages) and (share > WORTH or share > ALL * self.share(few.cost, stages))

    def slight(self, few: Numbers, more: Numbers) -> bool:
        """Return whether what one fit explains more than another is too little for a number to move.

        Enough is what is worth telling of; or in a stage half of what stays unexplained all the same, if that is more
        than other formulas leave.
        """
        if not any(self.gains(few, more, [stage]) for stage in self.open):
            return True
        floor = self.investigation.floor
        enough = any(
            self.fall(few, more, stage) > max(FOREIGN * floor[stage], MOST * self._excess(more.cost, stage))
            for stage in self.open
        )
        return not enough and self.gain(few, more, self.open) <= WORTH

    @property
    def unchanged(self) -> Numbers:
        """No numbers: the vehicle as configured."""
        return Numbers({}, self.configured, self.configured.cost)

    def held_out(self, found: FittedModel) -> Numbers:
        """Return a fit of everything, by its cost on held-out windows."""
        cost = {**held_out(self.investigation, self.investigation.base), **held_out(self.investigation, found)}
        return Numbers({}, found, cost)

    def stays(self, name: str, told: Numbers, refit: Numbers) -> bool:
        """Return whether a refit takes back less than half of what a number was changed by."""
        vehicles = self.investigation.vehicle, told.found.vehicle, refit.found.vehicle
        was, there, now = (_size(name, vehicle) for vehicle in vehicles)
        return abs(now - there) < BACK * abs(there - was)

    def in_reach(self, numbers: Numbers) -> bool:
        """Return whether every number stayed inside its bounds."""
        return all(u.low < numbers.found.theta[u.name] < u.high for u in self._unknowns(numbers.gained))

    def stages_of(self, name: str) -> list[str]:
        """Return the stages with a gap that a number acts in."""
        return [
            stage
            for stage in stages_with(self.investigation, self.named.vehicle, self._unknowns([name]))
            if stage in self.open
        ]

    def possible(self) -> list[str]:
        """Return the numbers that the log's stages depend on; a displaced centre of gravity is one already."""
        displaced = COG in self.named.effects
        return [name for name in NUMBERS if self.stages_of(name) and not (displaced and name == "l_f")]

    def fitted(self, names: Sequence[str], start: Numbers) -> Numbers:
        """Return the vehicle with its effects and some numbers fitted, from where others ended."""
        stages = self._stages(names)
        if not stages:
            return start
        found = self._fit(names, start, stages, LONGEST, None)
        gained = {name: start.gained[name] for name in names if name in start.gained}
        return Numbers(gained, found, {**self.configured.cost, **found.cost})

    def fall_in_a_few_steps(self, names: Sequence[str], start: Numbers) -> float:
        """Return by how much the loss of a share of the windows falls in a few steps of such a fit."""
        stages = self._stages(names)
        some = sampled({stage: self.investigation.evidence[stage] for stage in stages})
        found = self._fit(names, start, stages, STEPS, some)
        return sum(self.fall_of(stage, start.cost[stage][some[stage]], found.cost[stage]) for stage in stages)

    def fall_of(self, stage: str, before: Array, after: Array) -> float:
        """Return the fall of the loss of some windows of a stage."""
        return float((self.judge.loss(stage, before) - self.judge.loss(stage, after)).sum())

    def _stages(self, names: Sequence[str]) -> list[str]:
        return stages_with(self.investigation, self.named.vehicle, self._free(names))

    def _free(self, names: Sequence[str]) -> list[Unknown]:
        """Return the effects' parameters and the numbers."""
        own = unknowns_with(self.investigation, self.named.effects, self.named.vehicle)
        return [*(unknown for unknown in own if unknown.effect), *self._unknowns(names)]

    def _fit(
        self,
        names: Sequence[str],
        start: Numbers,
        stages: Sequence[str],
        iterations: int,
        some: Mapping[str, NDArray[np.int64]] | None,
    ) -> FittedModel:
        configured = values(self.investigation.vehicle)
        back = {name: float(configured[name]) for name in NUMBERS if name in configured and name not in names}
        return fit_model(
            self.investigation,
            self.named.effects,
            replace_values(self._begun(start.found), back),
            start.found,
            iterations,
            stages=stages,
            index=some,
            free=self._free(names),
            strength=dict.fromkeys(self.investigation.evidence, 1.0),
        )

    def _begun(self, found: FittedModel) -> Vehicle:
        """Return the vehicle of a fit, with the effects found if it lacks them."""
        lacking = {name: self.named.vehicle.effects[name] for name in self.named.effects - set(found.vehicle.effects)}
        return replace(found.vehicle, effects={**found.vehicle.effects, **lacking})

    def _unknowns(self, names: Iterable[str]) -> list[Unknown]:
        """Return numbers with priors that are no more than a restraint; what a refit may not change stays so.

        Grip of the floor is held in a refit, for those of the tyres stand in for it.
        """
        investigation, known = self.investigation, {unknown.name: unknown for unknown in self.investigation.unknowns}
        grip = float(values(investigation.vehicle)[GRIP])
        bounds = specifications(investigation.vehicle)[GRIP]
        known[GRIP] = Unknown(GRIP, grip, 1.0, *investigation.limits.get(GRIP, (bounds.low, bounds.high)))
        free = [known[name] for name in names if name in known and known[name].low < known[name].high]
        return [
            replace(
                each,
                sigma=SPREAD * each.start,
                low=max(each.low, each.start / REACH),
                high=min(each.high, each.start * REACH),
            )
            for each in free
            if each.start > 0.0
        ]


def as_configured(investigation: Investigation, numbers: Numbers, error: float) -> dict[str, Any]:
    """Return what a verdict says of the numbers as configured; `error` is that of the vehicle as configured.

    A number whose interval holds the configured one is not told.
    """
    ranges = intervals(investigation, numbers.found) if numbers.gained else {}
    table = {name: float(value) for name, value in values(investigation.vehicle).items()}
    changes = [
        {
            "parameter": name,
            "what": NUMBERS[name],
            "from": table[name],
            "to": value,
            "ci95": [low, high],
            "explained": gained.share,
            "stages": list(gained.stages),
        }
        for name, gained in numbers.gained.items()
        for value, low, high in [ranges[name]]
        if not low <= table[name] <= high
    ]
    return {"error": error, "explained": numbers.explained, "changes": changes, "rest": numbers.rest}
