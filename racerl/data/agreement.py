"""Whether a log's velocities are those of its poses: in time, of the same point, with the same signs and units.

Motion capture gives poses; the velocities beside them are often filtered, and sometimes belong to another point of the
car. Then no car could show both, and what a fit makes of it is the filter.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from racerl.data.differentiate import smoothed, velocities
from racerl.data.lag import ENOUGH, Lag, correlated, reach, smoothing
from racerl.data.log import POSE, VELOCITY, Log

Array = NDArray[np.float64]

MAX_POSE_LAG = 0.025  # s between velocities and differentiated poses
MAX_OFFSET = 0.04  # m between the point of the velocities and the tracked one
SURE = 0.8  # correlation of yaw rate and differentiated yaw above which their lag is believed
GAIN = 1e-3  # by which the shift must raise that correlation
DIFFERENTIATED = "velocities differentiated from poses"


class Comparison(NamedTuple):
    """Velocities as given and as the poses have them, each (3, rows), lined up by the lag; that lag."""

    given: Array
    derived: Array
    lag: Lag | None

    @property
    def late(self) -> float:
        """Time in s by which the given velocities lag the poses; zero where the difference is small or unsure."""
        lag = self.lag
        if lag is None or lag.best <= SURE or lag.best - lag.unshifted <= GAIN or abs(lag.seconds) < MAX_POSE_LAG:
            return 0.0
        return lag.seconds

    @property
    def offset(self) -> float:
        """Distance in m by which the velocities' point lies ahead of the poses'; zero where it is small or unsure.

        v_y of a point a metres ahead is v_y + a r.
        """
        (v_x, v_y, yaw_rate), given = self.derived, self.given[1]
        moves = min(given.std(), v_y.std()) > 1e-9 and yaw_rate.std() > 0.2
        if not moves or np.corrcoef(given, v_y)[0, 1] <= 0.5:
            return 0.0
        features = np.column_stack([yaw_rate - yaw_rate.mean(), v_x, v_y, np.ones(len(yaw_rate))])
        weights, *_ = np.linalg.lstsq(features, given, rcond=None)
        return float(weights[0]) if abs(weights[0]) > MAX_OFFSET and abs(weights[2] - 1.0) < 0.25 else 0.0


def compare_with_poses(log: Log) -> Comparison | None:
    """Compare a log's velocities with its poses; None where there is nothing to compare."""
    if not {*POSE, *VELOCITY} <= set(log.channels) or any(DIFFERENTIATED in remark for remark in log.remarks):
        return None
    runs = [run for run in log.runs() if len(run) > 4 * reach(log)]
    if sum(len(run) for run in runs) < ENOUGH:
        return None
    window = smoothing(log)
    given = [np.stack([smoothed(run[name].to_numpy(), window) for name in VELOCITY]) for run in runs]
    poses = [[run[name].to_numpy() for name in POSE] for run in runs]
    derived = [np.stack(velocities(x, y, yaw, log.dt, window, 2)) for x, y, yaw in poses]
    pairs = [(made[2], told[2]) for made, told in zip(derived, given, strict=True)]
    lag = correlated(pairs, reach(log), log.dt)
    shift = 0 if lag is None else round(lag.seconds / log.dt)
    early, late = max(0, shift), max(0, -shift)
    return Comparison(
        np.hstack([told[:, early : told.shape[1] - late] for told in given]),
        np.hstack([made[:, late : made.shape[1] - early] for made in derived]),
        lag,
    )


def differences(found: Comparison) -> Iterator[tuple[str, float, float]]:
    """Yield channel, correlation with the differentiated pose and size beside it, of each velocity that moves."""
    for name, is_, should in zip(VELOCITY, found.given, found.derived, strict=True):
        if should.std() >= 0.05 and is_.std() >= 1e-9:
            yield name, float(np.corrcoef(is_, should)[0, 1]), float(is_.std() / should.std())


def contradiction(log: Log) -> str:
    """Say how velocities contradict the poses beside them: late, or of another point; "" where they don't."""
    found = compare_with_poses(log)
    if found is None:
        return ""
    said = []
    if found.late > 0.0:
        said.append(f"come {found.late:.3f} s after the poses")
    if found.offset:
        side = "ahead of" if found.offset > 0 else "behind"
        said.append(f"belong to a point {abs(found.offset):.2f} m {side} theirs")
    return " and ".join(said)
