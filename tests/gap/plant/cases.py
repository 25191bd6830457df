"""The design of the blind test: which car hides what, how it is driven and how noisy its log is.

Everything follows from the case itself: its name is a hash that tells nothing, and the name seeds its car, its effects'
values, its driving and its noise.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations, product

import numpy as np

from tests.gap.plant import cars, effects
from tests.gap.plant.effects import CATALOGUE, SIZES, UNLISTED
from tests.gap.plant.effects.base import STEP
from tests.gap.plant.families import MAGIC_FORMULA
from tests.gap.plant.programmes import PROGRAMMES

Hidden = tuple[tuple[str, str], ...]  # (effect, size)

NOISES = (0.5, 1.0, 3.0)
DRIVES = ("excitation", "race")
CLEAN_CARS = 12
TWO_TRACK_CARS = 4
PAIRS = 40
POOR_EFFECTS = ("friction_fade", "back_emf", "lateral_load_sensitivity", "steering_saturation", "aero_drag")
CANCELLING = {
    frozenset({"pose_latency", "command_timestamp_offset"}),
    frozenset({"steering_offset", "steering_sensor_offset"}),
}


@dataclass(frozen=True)
class Case:
    """One log of the blind test."""

    set: str
    effects: Hidden
    programme: str = "excitation"
    noise: float = 1.0
    structure: str = "single_track"
    minutes: float | None = None  # the programme's own where None
    direction: str = "both"  # of the race: both, or one
    velocities: str = "measured"  # or differentiated from the pose
    number: int = 0  # tells repetitions apart
    seed: int = 1
    family: str = field(default=MAGIC_FORMULA, repr=False)  # of the tyres
    slip: str = field(default="centre", repr=False)  # the speed that slips are over
    floor: float = field(default=1.0, repr=False)  # grip of the floor, times the car's own
    sensors: str = field(default="ideal", repr=False)
    step: float = field(default=STEP, repr=False)  # s, of the integration

    @property
    def origin(self) -> str:
        """An opaque name, whatever the floor, the sensors and the step: car, effects, driving and noise are its."""
        own = "" if (self.family, self.slip) == (MAGIC_FORMULA, "centre") else f" on {self.family}, {self.slip}"
        return hashlib.sha256(f"{self}{own}".encode()).hexdigest()[:12]

    @property
    def name(self) -> str:
        """An opaque name."""
        if (self.floor, self.sensors, self.step) == (1.0, "ideal", STEP):
            return self.origin
        own = "" if self.sensors == "ideal" else f" {self.sensors}"
        own += "" if self.step == STEP else f" {self.step}"
        return hashlib.sha256(f"{self.origin} {self.floor}{own}".encode()).hexdigest()[:12]

    @property
    def length(self) -> float:
        """Minutes of driving."""
        return PROGRAMMES[self.programme].minutes if self.minutes is None else self.minutes

    def generator(self, purpose: int) -> np.random.Generator:
        """A generator of its own for each purpose."""
        return np.random.default_rng([int(self.origin, 16), purpose])

    def car(self) -> dict[str, float]:
        """The hidden car."""
        car = cars.draw(self.generator(0))
        return car | {"friction": self.floor * car["friction"]}

    def values(self) -> dict[str, dict[str, float]]:
        """The hidden effects' parameters."""
        rng, place = self.generator(1), PROGRAMMES[self.programme].landmark
        return {name: effects.draw(name, size, rng, place) for name, size in self.effects}


@dataclass(frozen=True)
class Choice:
    """What of a set is wanted; None leaves the set's own choice."""

    seed: int = 1
    sizes: Sequence[str] | None = None
    noises: Sequence[float] | None = None
    programmes: Sequence[str] | None = None
    effects: Sequence[str] | None = None
    minutes: float | None = None
    direction: str = "both"
    velocities: str = "measured"
    family: str = MAGIC_FORMULA
    slip: str = "centre"
    floor: float = 1.0
    structure: str = "single_track"
    sensors: str = "ideal"
    step: float = STEP

    def case(
        self, name: str, hidden: Hidden, programme: str, noise: float, number: int = 0, structure: str = ""
    ) -> Case:
        """A case with the options that hold for all."""
        return Case(
            set=name,
            effects=hidden,
            programme=programme,
            noise=noise,
            structure=structure or self.structure,
            minutes=self.minutes,
            direction=self.direction,
            velocities=self.velocities,
            number=number,
            seed=self.seed,
            family=self.family,
            slip=self.slip,
            floor=self.floor,
            sensors=self.sensors,
            step=self.step,
        )


def single(choice: Choice) -> list[Case]:
    """Every effect of the catalogue alone: sizes × noises × excitation and race."""
    return _alone("single", choice, choice.effects or tuple(CATALOGUE))


def unlisted(choice: Choice) -> list[Case]:
    """Every effect that no catalogue lists, alone."""
    return _alone("unlisted", choice, choice.effects or tuple(UNLISTED))


def clean(choice: Choice) -> list[Case]:
    """No effect: many cars × noises × excitation and race."""
    grid = product(range(CLEAN_CARS), choice.noises or NOISES, choice.programmes or DRIVES)
    return [choice.case("clean", (), programme, noise, number=i) for i, noise, programme in grid]


def structure(choice: Choice) -> list[Case]:
    """Two-track cars without any effect."""
    grid = product(range(TWO_TRACK_CARS), choice.noises or (1.0,), choice.programmes or DRIVES)
    return [choice.case("structure", (), p, noise, number=i, structure="two_track") for i, noise, p in grid]


def poor(choice: Choice) -> list[Case]:
    """Logs that can't tell: with no effect, and with one that would show in a better log."""
    sizes = choice.sizes or ("medium",)
    hidden: list[Hidden] = [(), *(((e, s),) for e, s in product(choice.effects or POOR_EFFECTS, sizes))]
    grid = product(hidden, choice.noises or (1.0,), choice.programmes or ("slow", "still", "short"))
    return [choice.case("poor", h, programme, noise) for h, noise, programme in grid]


def pairs(choice: Choice) -> list[Case]:
    """Two effects at once, medium or large: every effect about as often, partners and sizes drawn."""
    rng = np.random.default_rng([choice.seed, 2])
    sizes = choice.sizes or ("medium", "large")
    couples = _couples(choice.effects or tuple(CATALOGUE), rng)
    drawn = [((a, str(rng.choice(sizes))), (b, str(rng.choice(sizes)))) for a, b in couples]
    grid = product(drawn, choice.noises or (1.0,), choice.programmes or ("excitation",))
    return [choice.case("pairs", hidden, programme, noise) for hidden, noise, programme in grid]


SETS = {"single": single, "clean": clean, "pairs": pairs, "unlisted": unlisted, "structure": structure, "poor": poor}


def _alone(name: str, choice: Choice, hidden: Sequence[str]) -> list[Case]:
    """Each effect × sizes × noises × programmes."""
    grid = product(hidden, choice.sizes or SIZES, choice.noises or NOISES, choice.programmes or DRIVES)
    return [choice.case(name, ((effect, size),), programme, noise) for effect, size, noise, programme in grid]


def _couples(names: Sequence[str], rng: np.random.Generator) -> list[tuple[str, str]]:
    """Up to `PAIRS` different couples, dealt from shuffled decks of all names; none whose effects may cancel out."""
    possible = {frozenset(couple) for couple in combinations(names, 2)} - CANCELLING
    wanted = min(PAIRS, len(possible))
    couples: list[tuple[str, str]] = []
    while len(couples) < wanted:
        deck = [str(name) for name in rng.permutation(names)]
        for couple in zip(deck[::2], deck[1::2], strict=False):
            if frozenset(couple) in possible:
                possible.remove(frozenset(couple))
                couples.append(couple)
    return couples[:wanted]
