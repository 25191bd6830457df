"""The sweep stage: trains and races every arm of every ablation over several seeds, and weighs the paper's claims.

Writes `jobs/` (a run folder per training and race), `laps.csv` (one row per lap driven), `learning.csv` (reward over
steps), `trainings.csv`, `steering.csv` (median steering along the track, where a sweep asks for turn-in) and
`results.json` (metrics with intervals, claims with verdicts).
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd

from racerl import bounds
from racerl.documents import read_json, write_json, write_text
from racerl.errors import ConfigError, RunError
from racerl.run import MANIFEST, Compose, RunFolder
from racerl.sweep.definition import TWIN, Sweep, read_sweeps
from racerl.sweep.elsewhere import NOTHING, Elsewhere, Key, raced
from racerl.sweep.engine import LOGS, Engine, Status, alone
from racerl.sweep.jobs import Job, Plan, plan, policies
from racerl.sweep.measures import LAP, arrivals, final_reward, learning, measure, usual_steering
from racerl.sweep.statistics import Samples, judge, resample
from racerl.sweep.tables import KEY, LAPS, LEARNING, RESULTS, STEERING, TRAININGS

POINTS = 200  # of a learning curve
USUAL_LAPS, TRIAL_LAPS = 20, 2  # flying laps of each start, where none are asked for


def sweep(
    settings: Mapping[str, Any],
    out: Path,
    compose: Compose,
    on_status: Callable[[Sequence[Status]], None] = lambda rows: None,
) -> dict[str, Any]:
    """Run the sweep of `settings["name"]` into `out`; return what was written to results.json.

    Raises ConfigError for what cannot be composed, RunError when another sweep is at work in `out` or all jobs failed;
    `failed` among the results holds the last words of single jobs that did.
    """
    sweeps = read_sweeps(str(settings["name"]))
    check(settings)
    trial = _trial(sweeps, settings, compose)
    settings = {**settings, "laps": flying_laps(settings, trial), "cars": _cars(sweeps, settings)}
    settings |= {"twins": _twins(sweeps, settings, trial)}
    planned = plan(sweeps, {**settings, "cars": [*settings["cars"], *settings["twins"]]}, out, compose)
    elsewhere = Elsewhere.read(settings.get("also", []), planned, settings)
    there = elsewhere.has(planned)
    engine = Engine(settings["engine"], settings["threads"], out)
    decisive = {key: value for key, value in settings.items() if key not in ("engine", "also")}
    folder = RunFolder.start(out, "sweep", decisive, again=True, threads=settings["threads"])
    with alone(out):
        missing = [job for job in planned.jobs if job.name not in there]
        failed = {job.name: engine.last_words(job) for job in engine.run(missing, on_status)}
        if len(failed) == len(planned.jobs):
            name, words = next(iter(failed.items()))
            raise RunError(f"all {len(failed)} jobs failed, {name}: {words}; what they printed stands in {out / LOGS}")
        facts = summarise(planned, settings, out, failed, elsewhere)
        if not failed and folder.manifest["status"] != "complete":
            trained = [job.trained for job in missing if job.train is not None]
            seconds = sum(read_json(path / MANIFEST)["seconds"] for path in trained)
            folder.finish(jobs=len(planned.jobs), training_seconds=round(seconds, 1))
    return facts


def _trial(sweeps: Sequence[Sweep], settings: Mapping[str, Any], compose: Compose) -> bool:
    """Return whether every training is only a trial."""
    words = [*map(str, settings["words"])]
    return all(compose("train", [*sweep.base, *words])["budget"].get("trial") for sweep in sweeps)


def flying_laps(settings: Mapping[str, Any], trial: bool) -> int:
    """Return the flying laps of each start: those asked for, else a few in a trial."""
    if settings["laps"] is not None:
        return int(settings["laps"])
    return TRIAL_LAPS if trial else USUAL_LAPS


def _cars(sweeps: Sequence[Sweep], settings: Mapping[str, Any]) -> list[str]:
    """Return the cars that every policy is raced in: those asked for, else those of the sweeps."""
    return list(settings["cars"] or dict.fromkeys(car for sweep in sweeps for car in sweep.cars))


def _twins(sweeps: Sequence[Sweep], settings: Mapping[str, Any], trial: bool) -> list[str]:
    """Return the cars in whose place of the twin claims are judged, too: those asked for, else none in a trial."""
    if settings["twins"] is not None:
        return list(settings["twins"])
    if trial or TWIN not in settings["cars"]:
        return []
    return list(dict.fromkeys(twin for sweep in sweeps for twin in sweep.twins))


def check(settings: Mapping[str, Any]) -> None:
    """Raise ConfigError for settings of the wrong kind or out of range."""
    bounds.whole("threads", settings["threads"], 1, 256)
    if settings["laps"] is not None:
        bounds.whole("laps", settings["laps"], 1, 10_000)
    for key in ("seeds", "starts"):
        bounds.wholes(key, settings[key], 0, 2**31 - 1)
    if not settings["starts"]:
        raise ConfigError("starts = []: one at least is needed")
    also = settings.get("also", [])
    if not isinstance(also, list) or not all(isinstance(folder, str) for folder in also):
        raise ConfigError(f"also = {also}: a list of sweeps' folders is expected")
    for key in ("cars", "twins"):
        names = settings[key]
        listed = isinstance(names, list) and all(isinstance(name, str) for name in names)
        if (names is not None and not listed) or (key == "cars" and names == []):
            raise ConfigError(f"{key} = {names}: a list of names from conf/car is expected")


def summarise(
    planned: Plan,
    settings: Mapping[str, Any],
    out: Path,
    failed: Mapping[str, str],
    elsewhere: Elsewhere = NOTHING,
) -> dict[str, Any]:
    """Write what the finished jobs came to; return results.json."""
    there = elsewhere.has(planned)
    tables = gather(planned, settings["laps"], elsewhere.tables)
    for name, table in tables.items():
        if name in (LAPS, TRAININGS) or not table.empty:
            write_text(out / name, table.to_csv(index=False, float_format="%.6g"))
    facts = {
        **results(
            planned.sweeps,
            settings["cars"],
            tables[LAPS],
            tables[TRAININGS],
            planned.trial_steps is not None,
            settings["twins"],
        ),
        "trial_steps": planned.trial_steps,
        "jobs": {"planned": len(planned.jobs), "done": sum(job.done or job.name in there for job in planned.jobs)},
        "cars": raced(planned),
        "also": list(elsewhere.origins),
        "failed": dict(failed),
    }
    write_json(out / RESULTS, facts)
    return facts


def gather(
    planned: Plan, laps: int, elsewhere: Mapping[Key, Mapping[str, pd.DataFrame]] = MappingProxyType({})
) -> dict[str, pd.DataFrame]:
    """Return the tables of what the finished jobs measured, here or in another sweep, by file."""
    turning = {sweep.name for sweep in planned.sweeps if "turn_in" in sweep.metrics}
    measured = {
        job.name: (measure(job, laps), learning(job), {policy: arrivals(job, policy) for policy in job.policies})
        for job in planned.jobs
        if job.done
    }
    parts: dict[str, list[pd.DataFrame]] = {LAPS: [], TRAININGS: [], LEARNING: [], STEERING: []}
    for key, job in planned.of.items():
        here = job.name in measured
        found = _of_arm(key, job, *measured[job.name], turning=key[0] in turning) if here else elsewhere.get(key, {})
        for name, table in found.items():
            parts[name].append(table)
    tables = {name: pd.concat(each, ignore_index=True) if each else pd.DataFrame() for name, each in parts.items()}
    return tables | {
        LAPS: tables[LAPS].reindex(columns=[*KEY, *LAP]),
        TRAININGS: tables[TRAININGS].astype({"reward": float}),  # of what is not trained, none
    }


def _of_arm(
    key: Key,
    job: Job,
    driven: Sequence[Mapping[str, Any]],
    curve: pd.DataFrame,
    arrived: Mapping[str, Mapping[str, float]],
    *,
    turning: bool,
) -> dict[str, pd.DataFrame]:
    """Return what a job measured as the tables of one of its arms."""
    where = dict(zip(KEY, key, strict=True))
    learned = {"reward": final_reward(curve), "job": job.path.name}
    trainings = [{**where, "policy": policy, **learned, **seconds} for policy, seconds in arrived.items()]
    found = {
        LAPS: pd.DataFrame([{**where, **row} for row in driven]),
        TRAININGS: pd.DataFrame(trainings),
        LEARNING: _thinned(curve).assign(**where),
    }
    if turning:
        steering = [
            usual_steering(job, policy, car).assign(**where, policy=policy, car=car) for policy, car in job.races
        ]
        found[STEERING] = pd.concat(steering)
    return found


def results(
    sweeps: Sequence[Sweep],
    cars: Sequence[str],
    laps: pd.DataFrame,
    trainings: pd.DataFrame,
    trial: bool = False,
    twins: Sequence[str] = (),
) -> dict[str, Any]:
    """Return every arm's metrics with intervals and every claim's verdict; a fixed generator, so that it repeats.

    Where trainings end with a refinement, their policies as they were learned and refined have rows and verdicts of
    their own. Claims about the twin are judged in each of `twins` in its place, too. A `trial` has no verdicts.
    """
    rows, claims, elsewhere = [], [], []
    for sweep in sweeps:
        mine, trained = laps[laps["sweep"] == sweep.name], trainings[trainings["sweep"] == sweep.name]
        for number, policy in enumerate(policies(trained["policy"])):
            driven, learned = of_policy(mine, trained, policy), of_policy(trained, trained, policy)
            own = set(trained[trained["policy"] == policy]["arm"])
            samples = _samples(driven, learned, cars)
            rows += [
                row
                for row in _rows(sweep, samples, learned)
                if row["arm"] in own or not number  # what is not trained stands there once
            ]
            claims += [{"policy": policy, **judge(claim, sweep, samples, trial)} for claim in sweep.claims]
            about = [claim for claim in sweep.claims if any(test.car == TWIN for test in claim.tests)]
            needed = {arm for claim in about for test in claim.tests for arm in test.arms}
            for twin in twins if about else ():
                raced = _samples(driven[driven["arm"].isin(needed)], learned, [twin])
                there = samples | ({TWIN: raced[twin]} if raced else {})
                elsewhere += [{"policy": policy, "car": twin, **judge(claim, sweep, there, trial)} for claim in about]
    questions = [{"sweep": s.name, "question": s.question, "metrics": list(s.metrics)} for s in sweeps]
    claims, elsewhere = (sorted(each, key=lambda claim: claim["claim"]) for each in (claims, elsewhere))
    return {"sweeps": questions, "arms": rows, "claims": claims, "in_other_twins": elsewhere}


def _rows(sweep: Sweep, samples: Mapping[str, Samples], trained: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Yield the metrics of every arm in every car."""
    for car, part in samples.items():
        for arm in sweep.arms:
            if arm in part.per_seed:
                mine = trained[trained["arm"] == arm]
                facts = {"policy": mine["policy"].iloc[0], "trainings": int(mine["reward"].notna().sum())}
                yield {"sweep": sweep.name, "arm": arm, "car": car, **facts, **_metrics(part, arm)}


def of_policy(table: pd.DataFrame, trainings: pd.DataFrame, policy: str) -> pd.DataFrame:
    """Return the rows of all arms' policies of a kind; of arms whose trainings were raced with none of it, all rows."""
    raced = trainings[trainings["policy"] == policy]
    has = pd.MultiIndex.from_frame(raced[["sweep", "arm"]])
    return table[(table["policy"] == policy) | ~pd.MultiIndex.from_frame(table[["sweep", "arm"]]).isin(has)]


def _samples(laps: pd.DataFrame, trained: pd.DataFrame, cars: Sequence[str]) -> dict[str, Samples]:
    """Return the samples in every car; none without laps."""
    return {car: resample(laps[laps["car"] == car], trained, np.random.default_rng(0)) for car in cars if len(laps)}


def _metrics(samples: Samples, arm: str) -> dict[str, Any]:
    return {
        name: {"value": value if math.isfinite(value) else None, "ci95": samples.interval(arm, name)}
        for name in samples.per_seed[arm]
        for value in [samples.value(arm, name)]
    }


def _thinned(curve: pd.DataFrame) -> pd.DataFrame:
    """Return a learning curve as means of at most POINTS neighbourhoods."""
    if len(curve) <= POINTS:
        return curve
    return curve.groupby(np.arange(len(curve)) * POINTS // len(curve)).mean()
