"""The drive log: named channels with units at one uniform rate, cut into runs that nothing may cross.

Columns: `t` in s, `run` (id of one unbroken stretch), and any of `CHANNELS`. Axes and signs are the vehicle's: pose of
the centre of gravity in the world, velocities in the body frame, x forward, y left, angles counter-clockwise.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from racerl.errors import LogError


class Channel(NamedTuple):
    """Unit, meaning and the largest magnitude that a small car can plausibly show."""

    unit: str
    meaning: str
    largest: float


CHANNELS = {
    "x": Channel("m", "position of the centre of gravity in the world", 1e5),
    "y": Channel("m", "position of the centre of gravity in the world", 1e5),
    "yaw": Channel("rad", "heading, counter-clockwise", 1e5),
    "v_x": Channel("m/s", "forward speed of the centre of gravity", 60.0),
    "v_y": Channel("m/s", "leftward speed of the centre of gravity", 40.0),
    "yaw_rate": Channel("rad/s", "yaw rate, counter-clockwise", 60.0),
    "delta": Channel("rad", "measured steering angle, left positive", 1.2),
    "omega": Channel("m/s", "measured wheel surface speed", 100.0),
    "delta_ref": Channel("rad", "commanded steering angle", 1.2),
    "omega_ref": Channel("m/s", "commanded wheel surface speed", 100.0),
    "current": Channel("A", "motor current", 1000.0),
}
UNITS = {name: channel.unit for name, channel in CHANNELS.items()}
POSE, VELOCITY = ("x", "y", "yaw"), ("v_x", "v_y", "yaw_rate")
LABEL = "manoeuvre"  # column of a recorded log: what was driven
OURS = (LABEL, "seed", "lap", "travelled", "s", "n", "heading", "offset", "margin")  # columns that racerl adds
JITTER = 0.2  # of the sample time by which a step may differ within a run
UNITS_OF_TIME = {1e-3: "ms", 1e-6: "µs", 1e-9: "ns"}
MOST_CUTS = 0.2  # of the steps at which runs may be split; beyond it the log has another fault


@dataclass(frozen=True)
class Log:
    """A checked drive log; build it with `Log.from_table`.

    `table` has the columns t, run and the channels that were measured, sorted by run in order of appearance and by
    time. `dt` is the sample time in s. `remarks` says, a line each, what was done to the file's content on the way in.
    `reckoned` says that the poses are no measurement: somebody has made them of the wheel's speed and a heading. Of the
    mapping that it was read by it keeps the wheelbase in m, and by how many s the stamps of channels were moved.
    """

    name: str
    table: pd.DataFrame
    dt: float
    remarks: tuple[str, ...] = ()
    reckoned: bool = False
    wheelbase: float = 0.33
    shift: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def from_table(cls, name: str, table: pd.DataFrame, remarks: tuple[str, ...] = ()) -> "Log":
        """Check a table of channels and return it as a log; raise LogError, one line, for what can't be a drive.

        A missing `run` is made from the gaps in time. Rows with a missing value split the run they lie in.
        """
        if "t" not in table:
            raise LogError(f"{name}: has no column 't'; give a mapping with data=… (conf/data)")
        columns = [column for column in table if column in CHANNELS]
        if not columns:
            raise LogError(f"{name}: has none of the channels {', '.join(CHANNELS)}; give a mapping with data=…")
        table = table[["t", *(["run"] if "run" in table else []), *columns]].reset_index(drop=True)
        for column in ("t", *columns):
            if not pd.api.types.is_numeric_dtype(table[column]) or pd.api.types.is_bool_dtype(table[column]):
                raise LogError(f"{name}: column '{column}' is not numeric; is it another file or a broken line?")
            table[column] = table[column].astype(np.float64)
        complete, more = complete_rows(name, table)
        remarks = (*remarks, *more)
        dt = sample_time(name, table[complete])
        table = table[complete].assign(run=_runs(name, table, complete, dt)).reset_index(drop=True)
        for column in columns:
            peak = float(table[column].abs().max())
            if peak > CHANNELS[column].largest:
                channel = CHANNELS[column]
                raise LogError(
                    f"{name}: |{column}| reaches {peak:.4g}, allowed is {channel.largest:g} {channel.unit}; "
                    "is its unit another one, or the file damaged?"
                )
        return cls(name, table[["t", "run", *columns]], dt, remarks)

    @property
    def channels(self) -> list[str]:
        """Names of the measured channels."""
        return [column for column in self.table if column in CHANNELS]

    @property
    def seconds(self) -> float:
        """Time driven, in s."""
        return len(self.table) * self.dt

    def facts(self) -> dict[str, Any]:
        """Return what a result says of the log that it came from."""
        return {
            "name": self.name,
            "seconds": round(self.seconds, 3),
            "runs": int(self.table["run"].nunique()),
            "dt": self.dt,
            "channels": self.channels,
            "remarks": list(self.remarks),
        }

    def runs(self) -> Iterator[pd.DataFrame]:
        """Yield the rows of each run."""
        for _, rows in self.table.groupby("run", sort=False):
            yield rows

    def array(self, channel: str) -> NDArray[np.float64]:
        """Return one channel, shape (rows,)."""
        return self.table[channel].to_numpy()


def sample_time(name: str, table: pd.DataFrame) -> float:
    """Return the time between samples in s; raise LogError when time does not advance."""
    t = table["t"].to_numpy()
    steps, rows = np.diff(t), np.arange(1, len(t))
    if "run" in table:
        same = table["run"].to_numpy()[1:] == table["run"].to_numpy()[:-1]
        steps, rows = steps[same], rows[same]
    if len(steps) == 0:
        raise LogError(f"{name}: holds {len(table)} usable rows; at least two of one run are needed")
    back = int((steps <= 0).sum())
    if back > 0.01 * len(steps) or ("run" in table and back):
        first = rows[int(np.argmax(steps <= 0))]
        where = f"first from {t[first - 1]:.10g} to {t[first]:.10g} s in row {first}"
        raise LogError(f"{name}: time does not increase at {back} of {len(steps)} rows, {where}; {_in_order(steps)}")
    dt = round(float(np.median(steps[steps > 0])), 9)
    if not 1e-4 <= dt <= 0.5:
        scale = next((scale for scale in (1e-3, 1e-6, 1e-9) if 1e-3 <= scale * dt <= 0.1), None)
        cure = f" data.time.scale={scale:g} for {UNITS_OF_TIME[scale]}" if scale else ""
        raise LogError(
            f"{name}: {dt:.4g} s between samples; allowed is 0.0001 … 0.5 s; is the time in another unit?{cure}"
        )
    return dt


def _in_order(steps: NDArray[np.float64]) -> str:
    """Return what to do about steps of time (s), of which many are none or lead back."""
    if (steps < 0).mean() > MOST_CUTS:
        return "sort its rows by t, or give the column that has the time: data.time.column="
    if (steps == 0).mean() > MOST_CUTS:
        return "its stamps are too coarse to tell samples apart; write them with all their digits"
    return "drop doubled rows; several drives in one file need a column run with a number for each"


def complete_rows(name: str, table: pd.DataFrame) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """Return which rows have a time, a run and all channels, (rows,), and a remark where some don't.

    Infinities are read as missing: both are gaps in what was measured. Raises LogError where a channel has so many that
    no runs are left.
    """
    known = {name: np.isfinite(table[name].to_numpy()) for name in table if name == "t" or name in CHANNELS}
    known |= {name: table[name].notna().to_numpy() for name in table if name == "run"}
    complete = np.all([*known.values()], axis=0)
    if complete.all():
        return complete, ()
    apart = np.diff(np.flatnonzero(complete)) > 1
    if complete.mean() < 0.5 or (apart.any() and apart.mean() > MOST_CUTS):
        worst = min(known, key=lambda name: known[name].mean())
        raise LogError(
            f"{name}: {1 - complete.mean():.0%} of the rows miss a value, most of them {worst}, and runs are split at "
            f"each; take {worst} out of the file, or where channels have clocks of their own fill commands forward, "
            "interpolate the others and give a rate, as data.resample=100"
        )
    return complete, (f"{(~complete).sum()} rows with a missing value left out; runs are split there",)


def run_changes(name: str, rows: pd.DataFrame) -> NDArray[np.bool_]:
    """Return where the id of the run changes, (rows − 1,); raise LogError where a run comes back later."""
    code, _ = pd.factorize(rows["run"])
    change = np.diff(code) != 0
    entered = code[np.flatnonzero(np.concatenate([[True], change]))]
    if len(np.unique(entered)) < len(entered):
        raise LogError(f"{name}: the rows of its runs are mixed up; sort the file by run, then by t")
    return np.asarray(change)


def _runs(name: str, table: pd.DataFrame, complete: NDArray[np.bool_], dt: float) -> NDArray[np.int64]:
    """Return a run id per complete row: the file's runs, split at missing rows and at jumps in time."""
    rows = table[complete]
    t = rows["t"].to_numpy()
    jump = np.abs(np.diff(t) - dt) > JITTER * dt
    missing = np.diff(np.flatnonzero(complete)) > 1
    fresh = jump | missing
    if "run" in rows:
        change = run_changes(name, rows)
        fresh |= change
        if not (jump | missing)[~change].any():
            runs = rows["run"].to_numpy()
            if pd.api.types.is_integer_dtype(runs.dtype):
                return runs.astype(np.int64)
    if fresh.mean() > MOST_CUTS:
        raise LogError(f"{name}: {fresh.mean():.0%} of its steps jump in time; resample it to a uniform rate")
    return np.concatenate([[0], np.cumsum(fresh)]).astype(np.int64)


def common_sample_time(logs: Sequence[Log]) -> float:
    """Return the time between samples of some logs in s; raise LogError where they differ in it."""
    dt = logs[0].dt
    for other in logs:
        if abs(other.dt - dt) > 1e-3 * dt:
            raise LogError(
                f"{logs[0].name}: samples {dt:g} s apart, {other.name}: {other.dt:g} s; give data.resample=…"
            )
    return dt


def separate(logs: Sequence[Log]) -> tuple[list[Log], list[str]]:
    """Return the logs without runs that were there before, and a line for each that was left out.

    A run that stands twice would count twice, and could be fitted in one place and held out in another.
    """
    seen: set[bytes] = set()
    kept, lines = [], []
    for log in logs:
        doubled = []
        for run, rows in log.table.groupby("run", sort=False):
            content = rows[log.channels].round(6).to_numpy().tobytes()
            if content in seen:
                doubled.append(run)
            seen.add(content)
        if doubled:
            lines.append(f"{log.name}: {len(doubled)} runs are copies of others and were left out")
            log = replace(log, table=log.table[~log.table["run"].isin(doubled)])
        if len(log.table):
            kept.append(log)
    return kept, lines


def runs_told(number: int) -> str:
    """Return how many runs there are, as a sentence has it."""
    return "1 run" if number == 1 else f"{number} runs"
