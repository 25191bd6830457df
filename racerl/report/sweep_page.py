"""The page about a sweep: claims, arms and the paper's own figures, drawn from the sweep's files alone."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from racerl.documents import read_json
from racerl.errors import DocumentError, RunError
from racerl.paper import NAMES, table_1
from racerl.report.figures import duel, learning_bands, randomization, transfer, turn_in
from racerl.report.flying_lap import fastest_lap
from racerl.report.page import figure, provenance, write_page
from racerl.report.subjects import Evaluation, find_subjects
from racerl.run import RunFolder
from racerl.sweep.definition import METRICS
from racerl.sweep.sweep import LAPS, LEARNING, RESULTS, STEERING, TRAININGS

CURVE = ["sweep", "arm", "seed", "steps", "reward"]  # columns of a learning curve; a sweep of rivals has none
CURVES = ("track_representation", "action_space")  # sweeps whose arms the paper's Fig. 4 shows
DRIVERS, DUELS = "controllers", (("rl_geometric", "human"), ("rl_geometric", "mpc"))
PERCENT = ("crash_share", "valid_share")


@dataclass(frozen=True)
class Findings:
    """What a sweep wrote."""

    folder: Path
    facts: dict[str, Any]
    laps: pd.DataFrame
    trainings: pd.DataFrame
    learning: pd.DataFrame
    steering: pd.DataFrame

    @classmethod
    def read(cls, folder: Path) -> "Findings":
        """Read the files of a sweep's folder."""
        steering = folder / STEERING
        return cls(
            folder,
            read_json(folder / RESULTS),
            pd.read_csv(folder / LAPS),
            pd.read_csv(folder / TRAININGS),
            pd.read_csv(folder / LEARNING) if (folder / LEARNING).is_file() else pd.DataFrame(columns=CURVE),
            pd.read_csv(steering) if steering.is_file() else pd.DataFrame(),
        )

    def arms(self, sweep: str) -> list[dict[str, Any]]:
        """Return the rows of one sweep's arms, car by car."""
        return [row for row in self.facts["arms"] if row["sweep"] == sweep]

    @property
    def cars(self) -> list[str]:
        """Cars that were raced in."""
        return list(dict.fromkeys(row["car"] for row in self.facts["arms"]))


def draw_sweep(run: Path) -> Path:
    """Write the figures and the page of a sweep into its folder; return the page's path."""
    return write_page(run, "sweep_page.html.j2", sweep=section(run, run))


def section(run: Path, out: Path) -> dict[str, Any]:
    """Write a sweep's figures into a folder; return what a page says of it. Raises RunError for a damaged one."""
    folder = RunFolder.open(run, "sweep")
    try:
        found = Findings.read(folder.path)
        origin = provenance(folder.manifest)
        return {
            "name": folder.path.name,
            "facts": found.facts,
            "claims": [_claim(claim) for claim in found.facts["claims"]],
            "tables": [_table(found, sweep) for sweep in found.facts["sweeps"]],
            "table_1": _table_1(found),
            "figures": [
                figure(out / f"{name}.svg", title, caption, svg) for name, title, caption, svg in drawn(found) if svg
            ],
            "provenance": {key: origin[key] for key in ("git_sha", "cpu", "threads")},  # what repeats
        }
    except (DocumentError, OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(f"{run}: is damaged ({' '.join(str(error).split())}); sweep again") from error


def drawn(found: Findings) -> Iterator[tuple[str, str, str, str | None]]:
    """Yield name, title, caption and SVG of every figure that the sweep has the arms for."""
    names = {sweep["sweep"] for sweep in found.facts["sweeps"]}
    if "domain_randomization" in names:
        laps = found.laps[found.laps["sweep"] == "domain_randomization"]
        yield (
            "randomization",
            "Domain randomization (the paper's Fig. 3)",
            "Lap times, E_off and crashes over what was randomized in training and its σ.",
            randomization.draw(laps, found.arms("domain_randomization"), found.cars),
        )
    curves = found.learning[found.learning["sweep"].isin(CURVES)] if names & set(CURVES) else found.learning
    yield (
        "learning",
        "Learning (the paper's Fig. 4)",
        "Reward per control step of the noisy training policy. The paper's levels are about twice what its lap times "
        "allow: compare shapes.",
        learning_bands.draw(curves),
    )
    yield (
        "turn_in",
        "Steering with and without an actuator model (the paper's Fig. 5)",
        "Measured steering angle along the track; what starts further left turns in earlier.",
        turn_in.draw(found.steering, found.cars),
    )
    yield (
        "transfer",
        "From the model to the other cars",
        "The same policies in every car, means over seeds with 95 % intervals.",
        transfer.draw(list(_distinct(found.facts["arms"]))),
    )

    for a, b in DUELS:
        yield (
            f"{a}_and_{b}",
            f"{_words(a)} and {_words(b)} (the paper's Fig. 6)",
            f"Their fastest laps ({found.cars[-1]}, recorded drives as they are). Marks stand where they are at equal "
            "times since the line; where delta time falls, the first is gaining.",
            _duel(found, a, b),
        )


def _duel(found: Findings, a: str, b: str) -> str | None:
    """Return the figure of two arms' fastest laps; None where one has none, or the drives are not there any more."""
    evaluations = [_fastest(found, arm) for arm in (a, b)]
    named = zip((f"A: {_words(a)}", f"B: {_words(b)}"), evaluations, strict=True)
    laps = [lap for name, raced in named if raced and (lap := fastest_lap(name, raced))]
    return duel.draw(laps[0], laps[1], evaluations[0].track, []) if len(laps) == 2 and evaluations[0] else None


def _fastest(found: Findings, arm: str) -> Evaluation | None:
    """Return the race with an arm's fastest lap in the last of the cars, a valid one if there is any."""
    laps = found.laps
    mine = laps[(laps["sweep"] == DRIVERS) & (laps["arm"] == arm) & (laps["car"] == found.cars[-1])]
    timed = mine.dropna(subset="time_s").sort_values(["valid", "time_s"], ascending=[False, True])
    if timed.empty:
        return None
    trained = found.trainings
    rows = trained[(trained["sweep"] == DRIVERS) & (trained["arm"] == arm) & (trained["seed"] == timed["seed"].iloc[0])]
    run = found.folder / "jobs" / rows["job"].iloc[0] / found.cars[-1]
    return find_subjects([run], found.folder)[0].evaluation if run.is_dir() else None


def _words(arm: str) -> str:
    return arm.replace("_", " ")


def _distinct(arms: Iterable[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the arms without those that are another sweep's under a second name."""
    seen = set()
    for row in arms:
        same = (row["car"], *(row[metric]["value"] for metric in METRICS))
        if same not in seen:
            yield row
        seen.add(same)


def _number(metric: str, value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.0%}" if metric in PERCENT else f"{value:.5f}" if metric == "e_off" else f"{value:.3f}"


def _cell(metric: str, found: dict[str, Any]) -> str:
    low_high = found["ci95"]
    told = low_high and low_high[0] < low_high[1]  # a single lap has no interval
    between = f" ({_number(metric, low_high[0])} … {_number(metric, low_high[1])})" if told else ""
    return _number(metric, found["value"]) + between


def _table(found: Findings, sweep: dict[str, Any]) -> dict[str, Any]:
    """Return one sweep's arms as rows of text, the metrics that it names in every car."""
    metrics = list(sweep["metrics"])
    rows = [
        [_words(row["arm"]), row["car"], str(row["trainings"] or "–"), *(_cell(m, row[m]) for m in metrics)]
        for row in found.arms(sweep["sweep"])
    ]
    heads = ["arm", "car", "seeds", *(METRICS[metric] for metric in metrics)]
    return {"name": _words(sweep["sweep"]), "question": sweep["question"], "heads": heads, "rows": rows}


def _claim(claim: dict[str, Any]) -> dict[str, Any]:
    return {**claim, "tests": [_test(test) for test in claim["tests"]]}


def _test(test: dict[str, Any]) -> dict[str, str]:
    """Return a test as text: what is compared, the limit, the effect with its interval."""
    if test["slope"]:
        compared = "slope over " + ", ".join(f"{_words(arm)} at {x:g}" for arm, x in test["slope"].items())
    else:
        compared = " ".join(f"{weight:+.3g} {_words(arm)}" for arm, weight in test["weights"].items())
    over = f", over {_words(test['relative_to'])}'s" if test["relative_to"] else ""
    (side, limit), metric = next(iter(test["limit"].items())), test["metric"]
    share = bool(test["relative_to"])
    wanted = f"{side} {limit:.3g}" if side != "within" else f"within ± {limit:.3g}"
    if test["effect"] is None:
        said = test["why"]
    else:
        low, high = test["ci95"]
        values = [f"{value:+.1%}" if share else f"{value:+.4g}" for value in (test["effect"], low, high)]
        said = f"{values[0]} ({values[1]} … {values[2]}), {test['agreeing']} of {test['seeds']} seeds agree"
        if one := test.get("one_lap"):
            said += f"; {', '.join(map(_words, one))}: one lap, taken as exact"
    return {
        "what": f"{METRICS[metric]}{'' if metric == 'reward' else ' in the ' + test['car']}: {compared}{over}",
        "wanted": wanted,
        "said": said,
        "outcome": {True: "holds", False: "does not hold", None: "open"}[test["holds"]],
    }


def _table_1(found: Findings) -> list[dict[str, str]]:
    """Return the paper's Table I with our rows beside its own; empty without the sweep of controllers."""
    rows = []
    for row in found.arms(DRIVERS):
        recorded = _recorded(found, row["arm"])
        if recorded and row["car"] != found.cars[0]:
            continue
        laps = found.laps[
            (found.laps["sweep"] == DRIVERS) & (found.laps["arm"] == row["arm"]) & (found.laps["car"] == row["car"])
        ]
        deviation = laps["time_s"].std()
        rows.append(
            {
                "driver": f"{_words(row['arm'])}, {'recorded' if recorded else row['car']}",
                "fastest": _cell("fastest", row["fastest"]),
                "mean": _cell("lap_time", row["lap_time"]),
                "std": "–" if pd.isna(deviation) else f"{deviation:.3f}",
                "e_off": _cell("e_off", row["e_off"]),
                "crashes": _cell("crash_share", row["crash_share"]),
            }
        )
    theirs = [
        {
            "driver": f"{NAMES[row.name]}, real car",
            "fastest": f"{row.fastest_valid_lap_s:.3f}",
            "mean": f"{row.mean_lap_s:.3f}",
            "std": f"{row.std_lap_s:.2f}",
            "e_off": f"{row.e_off:.5f}",
            "crashes": "–",
        }
        for row in table_1().itertuples(index=False)
    ]
    return [*rows, *theirs] if rows else []


def _recorded(found: Findings, arm: str) -> bool:
    """Return whether an arm drove the same laps in every car, as a recorded drive does."""
    mine = [row for row in found.arms(DRIVERS) if row["arm"] == arm]
    same = all(row["lap_time"]["value"] == mine[0]["lap_time"]["value"] for row in mine)
    return same and len(mine) > 1 and mine[0]["trainings"] == 0 and mine[0]["lap_time"]["value"] is not None
