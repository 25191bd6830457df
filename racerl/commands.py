"""racerl from Python: what the commands do, as functions; typed results in place of lines on a terminal.

    from racerl.commands import evaluate, gap, record, train

    log = record(vehicle="published", seconds=120).log
    found = gap(log, vehicle="published")
    policy = train("+dr=friction_0.02", vehicle=found.model)
    print(evaluate(policy.folder, car="twin").mean_lap)

`words` are those of the command line, `settings` its keys and groups by name (`vehicle="published"`, `seed=1`); both
are checked as there, and what is wrong is raised as a `racerl.errors.RacerlError`, one line. Results lie in the folder
`out` (the command's own dated one by default). Trainings and diagnoses that were interrupted go on by the same call
with the same `out`, and `of(folder)` of a result reads a finished run.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral, Real
from pathlib import Path
from typing import Any, NamedTuple, Self

import pandas as pd

from racerl.choices import default_groups
from racerl.config import PAPER, Settings, compose_settings, quote
from racerl.control.policy import AnyPolicy, load_policy
from racerl.documents import read_json
from racerl.errors import ConfigError, RunError
from racerl.gap.hypotheses import Hypothesis
from racerl.run import RunFolder

Setting = str | float | Path | None | Sequence[str | float | Path | None]
Places = str | Path | Sequence[str | Path]
OnProgress = Callable[[float, str], None]  # the share of the work behind it, and what is being done


class Estimate(NamedTuple):
    """A parameter that was identified, in `unit`, with its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str


class Change(NamedTuple):
    """A configured number that is wrong: as configured, and as the log has it, with its 95 % interval."""

    configured: float
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Result:
    """A finished run: its folder, and all that its command found, as in the folder's JSON."""

    folder: Path
    facts: Mapping[str, Any]

    @classmethod
    def of(cls, folder: str | Path) -> Self:
        """Read a finished run; raise RunError where it is none, or another command's."""
        stage, file = FINISHED[cls]
        run = RunFolder.open_complete(Path(folder), stage)
        return cls(run.path, read_json(run.path / file) if file else run.manifest)


class Recording(Result):
    """A simulated drive."""

    @property
    def log(self) -> Path:
        """The log's file."""
        return self.folder / str(self.facts["log"])


@dataclass(frozen=True)
class Picture:
    """A figure in an SVG file; notebooks show it in place of its path."""

    path: Path

    def _repr_svg_(self) -> str:
        return self.path.read_text(encoding="utf-8")


class Reported(Result):
    """A finished run that has drawn its report."""

    @property
    def page(self) -> Path:
        """The report."""
        return self.folder / "report.html"

    @property
    def figures(self) -> dict[str, Picture]:
        """The report's figures by name, as far as there was something to draw."""
        return {path.stem: Picture(path) for path in sorted(self.folder.glob("*.svg"))}


class Survey(Reported):
    """What logs hold, and what is wrong with them."""

    @property
    def warnings(self) -> list[str]:
        """The traps of each log, then what concerns several."""
        return [*(warning for log in self.facts["logs"] for warning in log["warnings"]), *self.facts["warnings"]]


class Report(Reported):
    """A page about drivers."""


class Identification(Reported):
    """A vehicle found from logs; `usable` says whether it foretells runs that it was not fitted to."""

    @property
    def model(self) -> Path:
        """The vehicle, as `vehicle=` takes it; RunError where none was fitted."""
        if not self.facts["fitted"]:
            raise RunError(f"{self.folder}: nothing was fitted there")
        return self.folder / "model.yaml"

    @property
    def usable(self) -> bool:
        """Whether a policy may be trained in it."""
        return bool(self.facts["verdict"]["usable"])

    @property
    def parameters(self) -> dict[str, Estimate]:
        """The parameters that were fitted, by name."""
        return {name: _estimate(row) for name, row in self.facts.get("parameters", {}).items()}


class Diagnosis(Reported):
    """What a car does and its model does not."""

    @property
    def model(self) -> Path:
        """The vehicle with what was found, as `vehicle=` takes it."""
        return self.folder / "model.yaml"

    @property
    def verdict(self) -> str:
        """One of none, named, multiple, ambiguous, under_excited, unknown."""
        return str(self.facts["verdict"])

    @property
    def reason(self) -> str:
        """Why, in one sentence."""
        return str(self.facts["reason"])

    @property
    def effects(self) -> dict[str, dict[str, Estimate]]:
        """The effects named, with their parameters."""
        return {
            effect["name"]: {name: _estimate(row) for name, row in effect["parameters"].items()}
            for effect in self.facts["effects"]
        }

    @property
    def rivals(self) -> tuple[str, ...]:
        """Effects that the log cannot tell from those named."""
        return tuple(self.facts["ambiguous_with"])

    @property
    def hypotheses(self) -> list[Hypothesis]:
        """What may be hidden, most probable first; "?" is something not in the catalogue."""
        return [Hypothesis(tuple(row["names"]), row["probability"]) for row in self.facts["hypotheses"]]

    @property
    def numbers(self) -> dict[str, Change]:
        """The configured numbers that are wrong."""
        rows = self.facts["configured"]["changes"]
        return {row["parameter"]: Change(row["from"], row["to"], *row["ci95"]) for row in rows}


class Training(Result):
    """A trained policy."""

    @cached_property
    def policy(self) -> AnyPolicy:
        """The policy, on torch: `decide` takes scaled observations (N, O) and a memory, gives actions (N, 2) in ±1."""
        return load_policy(self.folder)


class Laps(Result):
    """Laps driven by a policy, a controller, or in a recorded drive. Times in s; None where no lap counts."""

    @property
    def mean_lap(self) -> float | None:
        """The mean of all laps driven to their end."""
        return self._number("mean_lap_s")

    @property
    def settled_lap(self) -> float | None:
        """The mean of laps that follow another one: the first after a start is slow."""
        return self._number("settled_lap_s")

    @property
    def optimum(self) -> float | None:
        """The time-optimal lap of that car."""
        return self._number("optimum_s")

    @property
    def laps(self) -> pd.DataFrame:
        """One row per lap."""
        return pd.DataFrame(self.facts["rows"])

    @property
    def trajectories(self) -> pd.DataFrame:
        """The drive, as a log with the place on the track."""
        return pd.read_parquet(self.folder / "trajectories.parquet")

    def _number(self, name: str) -> float | None:
        value = self.facts.get(name)
        return None if value is None else float(value)


class Optimum(Result):
    """The time-optimal lap."""

    @property
    def lap(self) -> float:
        """Its time in s, with commands that may change at any time."""
        return float(self.facts["time_s"])


FINISHED: dict[type[Result], tuple[str, str]] = {  # stage, and the file of its facts; "": the manifest
    Recording: ("record", ""),
    Survey: ("data", "data.json"),
    Identification: ("identify", "identification.json"),
    Diagnosis: ("gap", "verdict.json"),
    Training: ("train", ""),
    Laps: ("evaluate", "metrics.json"),
    Optimum: ("optimum", "optimum.json"),
    Report: ("report", ""),
}


def silent(share: float, what: str) -> None:
    """Say nothing."""


def record(
    *words: str, out: str | Path | None = None, on_progress: OnProgress = silent, **settings: Setting
) -> Recording:
    """Drive a simulated car and write its log: `racerl record`."""
    from racerl.record.record import record as stage

    composed = _composed("record", words, settings, out)
    stage(composed, Path(composed["out"]), lambda share: on_progress(share, "driving"))
    return Recording.of(composed["out"])


def data(logs: Places, *words: str, out: str | Path | None = None, **settings: Setting) -> Survey:
    """Look into logs: `racerl data`."""
    from racerl.data.survey import survey
    from racerl.report.log_page import draw_logs

    composed = _composed("data", words, settings, out, logs=logs)
    survey(composed, Path(composed["out"]))
    draw_logs(Path(composed["out"]))
    return Survey.of(composed["out"])


def identify(
    logs: Places, *words: str, out: str | Path | None = None, on_progress: OnProgress = silent, **settings: Setting
) -> Identification:
    """Find a car's parameters from its logs: `racerl identify`."""
    from racerl.identify.identify import identify as stage
    from racerl.report.identification_page import draw_identification

    composed = _composed("identify", words, settings, out, logs=logs)
    stage(composed, Path(composed["out"]), on_progress)
    draw_identification(Path(composed["out"]))
    return Identification.of(composed["out"])


def gap(
    logs: Places, *words: str, out: str | Path | None = None, on_progress: OnProgress = silent, **settings: Setting
) -> Diagnosis:
    """Find what a car does and its model does not: `racerl gap`."""
    from racerl.gap.diagnose import gap as stage
    from racerl.report.gap_page import draw_gap

    composed = _composed("gap", words, settings, out, logs=logs)
    stage(composed, Path(composed["out"]), lambda what, share: on_progress(share, what))
    draw_gap(Path(composed["out"]))
    return Diagnosis.of(composed["out"])


def train(
    *words: str, out: str | Path | None = None, on_progress: OnProgress = silent, **settings: Setting
) -> Training:
    """Train a policy: `racerl train`; with "from=RUN" among the words that run's is refined in a changed world."""
    from racerl.train.onward import train_onward
    from racerl.train.session import Progress
    from racerl.train.train import train as anew

    onward = any(word.lstrip("+").startswith("from=") for word in words)
    composed = _composed("refine" if onward else "train", words, settings, out)

    def show(progress: Progress) -> None:
        on_progress(min(1.0, progress.steps / progress.total_steps), progress.stage)

    (train_onward if onward else anew)(composed, Path(composed["out"]), show)
    return Training.of(composed["out"])


def evaluate(
    run: str | Path, *words: str, out: str | Path | None = None, on_progress: OnProgress = silent, **settings: Setting
) -> Laps:
    """Race a trained policy, or score a recorded drive: `racerl evaluate RUN`."""
    from racerl.evaluate.evaluate import evaluate as stage

    composed = _composed("evaluate", words, settings, out, run=run)
    stage(composed, Path(composed["out"]), on_progress)
    return Laps.of(composed["out"])


def race(*words: str, out: str | Path | None = None, on_progress: OnProgress = silent, **settings: Setting) -> Laps:
    """Race a rival of the policies: `racerl evaluate controller=mpc`."""
    from racerl.evaluate.rivals import race as stage

    composed = _composed("race", words, settings, out)
    stage(composed, Path(composed["out"]), on_progress)
    return Laps.of(composed["out"])


def optimum(
    *words: str, out: str | Path | None = None, on_progress: OnProgress = silent, **settings: Setting
) -> Optimum:
    """Find the time-optimal lap: `racerl optimum`."""
    from racerl.optimum.optimum import optimum as stage

    composed = _composed("optimum", words, settings, out)
    stage(composed, Path(composed["out"]), on_progress)
    return Optimum.of(composed["out"])


def report(runs: Places, *words: str, out: str | Path | None = None, **settings: Setting) -> Report:
    """Draw runs of `train`, `evaluate` or a sweep on one page: `racerl report`."""
    from racerl.report.report import report as stage

    composed = _composed("report", words, settings, out, runs=runs)
    stage(composed, Path(composed["out"]))
    return Report.of(composed["out"])


def _composed(
    command: str,
    words: Sequence[str],
    settings: Mapping[str, Setting],
    out: str | Path | None,
    **places: Places,
) -> Settings:
    """Return a command's settings, from what was given by its place, in words and by name."""
    groups = default_groups(command)
    given = [f"{name}={value if name in groups else _written(name, value)}" for name, value in settings.items()]
    given += [] if out is None else [f"out={quote(_place(out))}"]
    listed = {key: [each] if isinstance(each, str | Path) else each for key, each in places.items()}
    composed = compose_settings(
        command, [*words, *given], {key: list(map(_place, each)) for key, each in listed.items()}
    )
    return composed if out is not None or any(word.startswith("out=") for word in words) else _fresh(composed)


def _place(path: str | Path) -> str:
    return str(path) if str(path).startswith(PAPER) else str(Path(path).expanduser())


def _fresh(settings: Settings) -> Settings:
    """Return the settings with a folder of their own: those that are named by the second may be there already."""
    dated = Path(settings["out"])
    free = (dated if n == 1 else dated.with_name(f"{dated.name}_{n}") for n in itertools.count(1))
    return {**settings, "out": str(next(path for path in free if not path.exists()))}


def _written(name: str, value: Setting) -> str:
    """Return a value as the command line has it."""
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    if isinstance(value, Integral | Real):
        return repr(int(value)) if isinstance(value, Integral) else repr(float(value))
    if isinstance(value, str | Path):
        return quote(str(value))
    if not isinstance(value, Sequence):
        raise ConfigError(f"{name} = {value!r}: a number, a text, a path, or a list of these is expected")
    return f"[{','.join(_written(name, each) for each in value)}]"


def _estimate(row: Mapping[str, Any]) -> Estimate:
    low, high = row["ci95"]
    return Estimate(row["value"], low, high, row["unit"])
