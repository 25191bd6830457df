"""Cases to logs: those that share a programme are simulated side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

import pandas as pd

from tests.gap.plant import cars, effects, sensors
from tests.gap.plant.car import Plant
from tests.gap.plant.cases import Case
from tests.gap.plant.programmes import PROGRAMMES
from tests.gap.plant.simulate import drive
from tests.gap.plant.tyre import Array

Logs = list[tuple[Array, dict[str, Array]]]


def batches(cases: Sequence[Case], size: int) -> Iterator[list[Case]]:
    """Cases alike but for car, effects and noise, at most `size` at a time, like effects together."""
    for _, group in groupby(sorted(cases, key=lambda case: (_kind(case), case.effects, case.name)), key=_kind):
        alike = list(group)
        yield from (alike[i : i + size] for i in range(0, len(alike), size))


def simulate(batch: Sequence[Case]) -> list[pd.DataFrame]:
    """The logs of a batch, in its order."""
    first, programme = batch[0], PROGRAMMES[batch[0].programme]
    parameters = cars.stack([case.car() for case in batch])
    hidden = effects.build([case.values() for case in batch])
    plant = Plant(parameters, hidden, first.structure, programme.lean, first.step, first.family, first.slip)
    runs = programme.runs(parameters, [case.generator(2) for case in batch], first.length, first.direction)
    logs = drive(plant, runs)
    return [_logged(case, logs, i) for i, case in enumerate(batch)]


def key(case: Case) -> dict[str, object]:
    """What the log of a case hides."""
    sizes = dict(case.effects)
    return {
        "set": case.set,
        "effects": [{"name": n, "size": sizes[n], "parameters": v, "units": effects.ALL[n].units}
                    for n, v in case.values().items()],
        "programme": case.programme,
        "noise": case.noise,
        "structure": case.structure,
        "minutes": case.length,
        "direction": case.direction,
        "velocities": case.velocities,
        "seed": case.seed,
        "tyre": case.family,
        "slip": case.slip,
        "floor": case.floor,
        "sensors": case.sensors,
        "step": case.step,
        "car": case.car(),
    }  # fmt: skip


def _kind(case: Case) -> tuple[str, str, float, str, str, str, float]:
    """What the cases of a batch have in common."""
    return case.programme, case.structure, case.length, case.direction, case.family, case.slip, case.step


def _logged(case: Case, logs: Logs, car: int) -> pd.DataFrame:
    """One car's log, with its noise."""
    rng, frames = case.generator(3), []
    for run, (t, channels) in enumerate(logs):
        own = {"t": t} | {name: values[:, car] for name, values in channels.items()}
        noisy = sensors.SENSORS[case.sensors](sensors.add_noise(own, case.noise, rng), case.generator(4))
        if case.velocities == "differentiated":
            noisy = sensors.differentiate(noisy, noisy["t"][1] - noisy["t"][0])
        frames.append(sensors.frame(run, noisy))
    return pd.concat(frames, ignore_index=True)
