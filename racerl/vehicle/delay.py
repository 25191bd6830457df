"""Commands that act late: what an actuator sees of commands that are held, one after the other, for equal periods.

A command issued at t acts from t + T on. Over a step that begins a seconds into the current period and lasts h, the
actuator sees the mean of the held commands over [a − T, a − T + h]; T need not be a multiple of anything.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.vehicle import COMMAND, Vehicle


def held(history: Sequence[Scalar], delay: Scalar, begin: float, length: float, period: float, ops: Ops) -> Scalar:
    """Return the mean of a held command over [begin, begin + length] − delay, in s from the start of this period.

    `history` is the newest command first, one per period; the oldest counts as held ever since.
    """
    start = begin - delay
    total: Scalar = 0.0
    for age, command in enumerate(history):
        since, until = -age * period, (1 - age) * period
        low = start if age == len(history) - 1 else ops.maximum(start, since)
        share = ops.maximum(ops.minimum(start + length, until) - low, 0.0)
        total = total + command * (share / length)
    return total


def periods(vehicle: Vehicle, period: float) -> int:
    """Return how many past commands the vehicle's delays need, half as long again for randomized ones; 0 without."""
    longest = max((float(delay) for delay in vehicle.delays().values()), default=0.0)
    return -int(-1.5 * longest // period)


def delayed(
    history: Sequence[Any], delays: Mapping[str, Scalar], begin: float, length: float, period: float, ops: Ops
) -> list[Scalar]:
    """Return both commands that act over a step, from past pairs of them, newest first."""
    return [
        held([past[i] for past in history], delays[name], begin, length, period, ops)
        if name in delays
        else history[0][i]
        for i, name in enumerate(COMMAND)
    ]
