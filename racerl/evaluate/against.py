"""A drive set against the least lap time that its car and track allow."""

from collections.abc import Callable

from racerl.control import Controller
from racerl.env.race import Race
from racerl.evaluate.drive import Recorder, drive
from racerl.evaluate.laps import Lap
from racerl.optimum import kept
from racerl.vehicle.vehicle import Vehicle

DRIVING = 0.5  # share of the work, where the time-optimal lap has to be found as well
FINDING = "time-optimal lap, once for this car and track"


def drive_against_floor(
    race: Race,
    vehicle: Vehicle,
    controller: Controller,
    laps: int,
    recorder: Recorder,
    on_progress: Callable[[float, str], None],
) -> tuple[list[Lap], float | None]:
    """Drive all cars for so many laps; return those, and the time-optimal lap in s of the `vehicle` that they drove.

    It is only looked for where nobody did before and a lap was finished, which there is something to compare with.
    """
    floor = kept.known(vehicle, race.track, race.action)
    driving = 1.0 if floor else DRIVING
    driven = drive(
        race,
        controller,
        laps,
        recorder,
        lambda fewest: on_progress(driving * min(fewest, laps) / laps, f"lap {min(fewest, laps)} of {laps}"),
    )
    if floor is None and any(lap.time_s for lap in driven):
        on_progress(DRIVING, FINDING)
        floor = kept.found(
            vehicle, race.track, race.action, lambda share: on_progress(DRIVING + (1.0 - DRIVING) * share, FINDING)
        )
    return driven, floor
