"""A teacher for the race: laps of rising pace with feedback, which a policy can be asked to imitate.

A car is driven by the fastest lap that it is near enough to, so that it climbs from a standing start to nearly the
time-optimal lap. "Near" is Σ (e/b)² of the deviations e from a lap at the car's place, with basins b of a few times the
feedback's tolerances.
"""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from racerl.env.race import Race
from racerl.errors import OptimumError
from racerl.optimum.along import LineFrame
from racerl.optimum.collocation import Solution
from racerl.optimum.corridor import Corridor
from racerl.optimum.feedback import PLACES, Feedback, regulate
from racerl.optimum.ladder import find_ladder

HELD, CLIMBED = 1.0, 4.0  # Σ (e/b)² below which a lap is held, and the next one tried
NEAREST = 1.2  # times the least Σ (e/b)² between two laps, up to which the next one is tried where all of it is further
BASIN = 3.0  # of the tolerances of place and heading
BASIN_SPEED = 2.0  # of those of speeds
TRIAL, MOST_LEFT = 15.0, 0.1  # s of driving, and the share of cars that may not have come to the top lap by then
START_SPREAD = 1.0  # standard deviation of starts on the fastest lap, of the tolerances


class Teacher:
    """Actions for all cars of a race, by laps of rising pace on a corridor."""

    def __init__(
        self,
        race: Race,
        corridor: Corridor,
        laps: Sequence[Solution],
        known: dict[tuple[int, float], Feedback] | None = None,
    ) -> None:
        """`known`: feedback that other teachers on some of these laps have worked out, by lap and seconds ahead."""
        width = race.track.min_half_width
        self.laps = laps
        timing = race.timing
        # an action is held for a period, and the top lap's is taken from the middle of it; below, cars are caught
        # better without (of 128 random starts 9 leave the track instead of 38)
        ahead = [0.0] * (len(self.laps) - 1) + [timing.dt / 2]
        known = {} if known is None else known
        for lap, early in zip(laps, ahead, strict=True):
            if (id(lap), early) not in known:
                known[id(lap), early] = regulate(lap, race.action, corridor, width, timing.dt, timing.substeps, early)
        rungs = [known[id(lap), early] for lap, early in zip(laps, ahead, strict=True)]
        self.line = LineFrame(corridor, race)

        def table(values: list[np.ndarray]) -> Tensor:
            return torch.as_tensor(np.stack(values), dtype=race.dtype, device=race.device)

        self.states, self.actions = table([r.states for r in rungs]), table([r.actions for r in rungs])  # (L, M, …)
        self.gains = table([rung.gains for rung in rungs])
        self.tolerances = table([rungs[-1].tolerances])[0]
        self.basin = table([_basin(rungs[-1])])[0]
        apart = (((self.states[1:] - self.states[:-1]) / self.basin) ** 2).sum(dim=2)  # (L - 1, M)
        self.reach = (NEAREST * apart.amin(dim=1)).clamp(min=CLIMBED)

    def __call__(self, race: Race) -> Tensor:
        """Return the actions (N, 2), which may reach beyond ± 1."""
        return self._asked(race)[0]

    def on_top(self, race: Race) -> Tensor:
        """Return whether each car (N,) is driven by the fastest lap."""
        return self._asked(race)[1] == len(self.laps) - 1

    def _asked(self, race: Race) -> tuple[Tensor, Tensor]:
        """Return the actions (N, 2), and which laps (N,) give them."""
        s, z = self.line.locate(race, race.state, race.s)
        position = s / self.line.frame.length * PLACES
        cell = position.floor()
        share, index = (position - cell)[:, None], cell.long() % PLACES
        following = (index + 1) % PLACES
        deviation = z - torch.lerp(self.states[:, index], self.states[:, following], share)  # (L, N, Z)
        action = torch.lerp(self.actions[:, index], self.actions[:, following], share)
        action = action - (self.gains[:, index] @ deviation[..., None])[..., 0]
        rung = self._choose(((deviation / self.basin) ** 2).sum(dim=2))
        return action[rung, torch.arange(len(rung), device=rung.device)], rung

    def _choose(self, distance: Tensor) -> Tensor:
        """Return the lap (N,) for each car from its distances (L, N) to all."""
        order = torch.arange(len(distance), device=distance.device)[:, None]
        held = torch.where(distance < HELD, order, -1).amax(dim=0)
        rung = torch.where(held >= 0, held, distance.argmin(dim=0))
        if len(distance) == 1:
            return rung
        above = (rung + 1).clamp(max=len(distance) - 1)
        reachable = distance.gather(0, above[None])[0] < self.reach[above - 1]
        return torch.where(reachable, above, rung)

    def start(self, race: Race, cars: Tensor, generator: torch.Generator) -> None:
        """Put the cars of these numbers (K,) somewhere near the fastest lap."""
        index = torch.randint(0, PLACES, (len(cars),), generator=generator, device=cars.device)
        spread = torch.nan_to_num(self.tolerances, posinf=0.0) * START_SPREAD
        z = self.states[-1, index] + spread * torch.randn(
            len(cars), len(spread), generator=generator, device=cars.device
        )
        x, y, yaw = self.line.frame.position(index * (self.line.frame.length / PLACES), z[:, 0])
        size = len(race.vehicle.states)
        state = torch.stack([x, y, yaw + z[:, 1], *z[:, 2 : size - 1].T])
        drive = z[:, -1] if race.action.integrated else race.action.initial(z[:, 6])
        steering = z[:, 5].clamp(-race.action.steering_max, race.action.steering_max)
        race.put(cars, state, torch.stack([steering, drive.clamp(race.action.drive_min, race.action.drive_max)]))


def find_teacher(build: Callable[[], Race]) -> Teacher:
    """Return the teacher that brings cars to the fastest lap without losing them, by trials in races of the plain car.

    Raises OptimumError where it leaves too many cars behind, whatever lap is the top.
    """
    race = build()
    corridor = Corridor(race.track)
    laps = find_ladder(race.vehicle, race.track, race.action, corridor)
    failed, known = "", dict[tuple[int, float], Feedback]()
    for height in range(len(laps), 0, -1):
        try:
            teacher = Teacher(race, corridor, laps[:height], known)
        except OptimumError as error:
            failed = str(error)
            continue
        share = left_behind(teacher, build())
        if share <= MOST_LEFT:
            return teacher
        failed = f"{share:.0%} of the cars are left behind, at most {MOST_LEFT:.0%} may be"
    raise OptimumError(f"algo = imitation: no feedback holds a lap of this car here ({failed}); use algo=ppo")


def left_behind(teacher: Teacher, race: Race) -> float:
    """Return the share of cars that leave the track or spin on the way from a new race's starts, or are not on top."""
    gone = torch.zeros(len(race.age), dtype=torch.bool, device=race.device)
    for _ in range(round(TRIAL / race.timing.dt)):
        gone |= race.step(teacher(race)).terminated
    return float((gone | ~teacher.on_top(race)).float().mean())


def _basin(feedback: Feedback) -> np.ndarray:
    factor = np.full(len(feedback.tolerances), BASIN_SPEED)
    factor[:2] = BASIN
    return feedback.tolerances * factor
