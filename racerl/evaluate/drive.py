"""Driving a controller for a number of laps, and recording the drive as a log."""

import logging
from collections.abc import Callable

import numpy as np
import pandas as pd
from torch import Tensor

from racerl.control import Controller
from racerl.env.race import Race
from racerl.evaluate.laps import Lap, LapTimer
from racerl.vehicle.vehicle import STATE

log = logging.getLogger(__name__)

SLOWEST = 0.25  # m/s along the centreline; a drive that takes longer is given up


class Recorder:
    """Collects one row per control step and car: time, state, commands and place on the track."""

    def __init__(self, race: Race, seeds: list[int]) -> None:
        self.race, self.seeds = race, seeds
        self.run = np.arange(race.count) * 10_000  # run ids: a new one for every start of a car
        self.time = np.zeros(race.count)
        self.steps: list[dict[str, np.ndarray]] = []
        self.drive_name = "current" if race.action.drive_mode == "motor_current" else "omega_ref"

    def before(self) -> dict[str, np.ndarray]:
        """Return the state of all cars at the beginning of a step."""
        race = self.race
        row = {"t": self.time.copy(), "run": self.run.copy(), "seed": np.array(self.seeds)}
        row |= dict(zip(STATE, race.state.cpu().numpy().copy(), strict=False))
        place = {"s": race.s, "n": race.n, "heading": race.heading, "margin": race.margin, "travelled": race.travelled}
        return row | {name: value.cpu().numpy().copy() for name, value in place.items()}

    def after(self, row: dict[str, np.ndarray], command: Tensor, restarted: np.ndarray) -> None:
        """Keep the row with the command that was held from it on."""
        row["delta_ref"], row[self.drive_name] = command.cpu().numpy()
        self.steps.append(row)
        self.time = self.time + self.race.timing.dt
        self.cut(restarted)

    def cut(self, cars: np.ndarray) -> None:
        """Begin a new run of the masked cars (N,)."""
        self.time = np.where(cars, 0.0, self.time)
        self.run = self.run + cars

    def log(self) -> pd.DataFrame:
        """Return the drive as one table, run after run."""
        columns = {name: np.concatenate([step[name] for step in self.steps]) for name in self.steps[0]}
        return pd.DataFrame(columns).sort_values(["run", "t"], kind="stable", ignore_index=True)


def drive(
    race: Race,
    controller: Controller,
    laps: int,
    recorder: Recorder | None = None,
    on_step: Callable[[int], None] = lambda fewest: None,
) -> list[Lap]:
    """Drive all cars until each has driven `laps` laps; return those, car after car.

    `on_step` hears the fewest laps that any car has driven. A car that creeps is given up after a time, with a warning.
    """
    timer = LapTimer(race.track.length, race.timing.dt, race.travelled.cpu().numpy())
    limit = round((laps + 1) * race.track.length / SLOWEST / race.timing.dt)
    for _ in range(limit):
        row = {**recorder.before(), "lap": timer.current()} if recorder else None
        before = race.travelled.cpu().numpy()
        step = race.step(controller.act(race))
        crashed = step.terminated.cpu().numpy()
        after = before + step.progress.double().cpu().numpy()
        timer.update(before, after, step.margin.double().cpu().numpy(), crashed, race.travelled.cpu().numpy())
        if recorder and row is not None:
            recorder.after(row, step.command, crashed)
        on_step(timer.fewest())
        if timer.fewest() >= laps:
            break
    else:
        log.warning(
            "given up after %.0f s of driving: a car moves at less than %.2f m/s", limit * race.timing.dt, SLOWEST
        )
    return [lap for car in timer.laps for lap in car[:laps]]
