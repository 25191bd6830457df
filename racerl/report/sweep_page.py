"""The page about a sweep: claims, arms and the paper's own figures, drawn from the sweep's files alone."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup

from racerl.documents import read_json
from racerl.errors import DocumentError, RunError
from racerl.paper import NAMES, table_1
from racerl.report.figures import duel, learning_bands, randomization, transfer, turn_in
from racerl.report.figures.style import assign
from racerl.report.flying_lap import fastest_lap
from racerl.report.interval import draw as draw_interval
from racerl.report.page import figure, interval, number, provenance, write_page
from racerl.report.subjects import Evaluation, find_subjects
from racerl.run import RunFolder
from racerl.sweep.conclusions import POLICIES, banner, grouped, headline, of
from racerl.sweep.definition import METRICS, OF_TRAINING, TWIN
from racerl.sweep.jobs import identity, policies
from racerl.sweep.statistics import power, told, was_tested
from racerl.sweep.sweep import of_policy
from racerl.sweep.tables import LAPS, LEARNING, RESULTS, STEERING, TRAININGS, read_table

CURVE = ["sweep", "arm", "seed", "steps", "reward"]  # columns of a learning curve; a sweep of rivals has none
TURNING = ["sweep", "arm", "policy"]  # of steering along the track, where no sweep asks for it
CURVES = ("track_representation", "action_space")  # sweeps whose arms the paper's Fig. 4 shows
DRIVERS, DUELS = "controllers", (("rl_geometric", "human"), ("rl_geometric", "mpc"))


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
        return cls(
            folder,
            read_json(folder / RESULTS),
            read_table(folder / LAPS),
            read_table(folder / TRAININGS),
            read_table(folder / LEARNING) if (folder / LEARNING).is_file() else pd.DataFrame(columns=CURVE),
            read_table(folder / STEERING) if (folder / STEERING).is_file() else pd.DataFrame(columns=TURNING),
        )

    def arms(self, sweep: str) -> list[dict[str, Any]]:
        """Return the rows of one sweep's arms, policy by policy and car by car."""
        return [row for row in self.facts["arms"] if row["sweep"] == sweep]

    def rows(self, policy: str) -> list[dict[str, Any]]:
        """Return the arms' rows for a policy, and all rows of arms that were raced with no such policy."""
        rows: list[dict[str, Any]] = self.facts["arms"]
        table = pd.DataFrame([{"sweep": row["sweep"], "arm": row["arm"], "policy": of(row)} for row in rows])
        return [rows[i] for i in of_policy(table, self.trainings, policy).index] if rows else []

    def words(self, policy: str) -> str:
        """Return a policy in words, where there are several to tell apart."""
        return POLICIES[policy] if len(self.policies) > 1 else ""

    @property
    def colours(self) -> dict[tuple[str, str], str]:
        """Colour of every arm, by sweep and name, for all figures; arms that were trained alike share one."""
        first = self.trainings.drop_duplicates(["sweep", "arm"])
        return assign({(row.sweep, row.arm): identity(row.job) for row in first.itertuples()})

    @property
    def policies(self) -> list[str]:
        """Policies of a training that were raced, as learned first."""
        return policies(map(of, self.facts["arms"]))

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
            "headline": headline(found.facts),
            "banner": banner(found.facts),
            "policies": list(map(found.words, found.policies)),
            "claims": [_claim(same) for same in grouped(found.facts["claims"])],
            "sensitivity": _sensitivity(found.facts),
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
    curves = found.learning[found.learning["sweep"].isin(CURVES)] if names & set(CURVES) else found.learning
    yield (
        "learning",
        "Learning (the paper's Fig. 4)",
        "Reward per control step of the noisy training policy. The paper's levels are about twice what its lap times "
        "allow: compare shapes.",
        learning_bands.draw(curves, found.colours),
    )
    for policy in found.policies:
        for name, title, caption, svg in _of_policy(found, policy):
            words = found.words(policy)
            yield f"{name}_{policy}" if words else name, f"{title}, {words}" if words else title, caption, svg
    for a, b in DUELS if found.cars else ():
        yield (
            f"{a}_and_{b}",
            f"{_words(a)} and {_words(b)} (the paper's Fig. 6)",
            f"Their fastest laps ({found.cars[-1]}, recorded drives as they are). Marks stand where they are at equal "
            "times since the line; where delta time falls, the first is gaining.",
            _duel(found, a, b),
        )


def _of_policy(found: Findings, policy: str) -> Iterator[tuple[str, str, str, str | None]]:
    """Yield name, title, caption and SVG of the figures that there is one of for every policy of a training."""
    arms, laps = found.rows(policy), of_policy(found.laps, found.trainings, policy)
    yield (
        "randomization",
        "Domain randomization (the paper's Fig. 3)",
        "Lap times, E_off and crashes over what was randomized in training and its σ.",
        randomization.draw(
            laps[laps["sweep"] == randomization.SWEEP],
            [row for row in arms if row["sweep"] == randomization.SWEEP],
            found.cars,
            found.colours,
        ),
    )
    yield (
        "turn_in",
        "Steering with and without an actuator model (the paper's Fig. 5)",
        "Measured steering angle along the track; what starts further left turns in earlier.",
        turn_in.draw(of_policy(found.steering, found.trainings, policy), found.cars, found.colours),
    )
    yield (
        "transfer",
        "From the model to the other cars",
        "The same policies in every car, means over seeds with 95 % intervals.",
        transfer.draw(list(_distinct(arms)), found.colours),
    )


def _duel(found: Findings, a: str, b: str) -> str | None:
    """Return the figure of two arms' fastest laps; None where one has none, or the drives are not there any more."""
    evaluations = [_fastest(found, arm) for arm in (a, b)]
    named = zip((f"A: {_words(a)}", f"B: {_words(b)}"), evaluations, strict=True)
    laps = [lap for name, raced in named if raced and (lap := fastest_lap(name, raced))]
    colours = [found.colours[DRIVERS, arm] for arm in (a, b) if (DRIVERS, arm) in found.colours]
    return duel.draw(laps[0], laps[1], evaluations[0].track, (), colours) if len(laps) == 2 and evaluations[0] else None


def _fastest(found: Findings, arm: str) -> Evaluation | None:
    """Return the race with an arm's fastest lap in the last of the cars, a valid one if there is any."""
    laps = found.laps
    mine = laps[(laps["sweep"] == DRIVERS) & (laps["arm"] == arm) & (laps["car"] == found.cars[-1])]
    timed = mine.dropna(subset="time_s").sort_values(["valid", "time_s"], ascending=[False, True])
    if timed.empty:
        return None
    trained = found.trainings
    rows = trained[(trained["sweep"] == DRIVERS) & (trained["arm"] == arm) & (trained["seed"] == timed["seed"].iloc[0])]
    run = found.folder / "jobs" / rows["job"].iloc[0] / timed["policy"].iloc[0] / found.cars[-1]
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


def _cell(metric: str, found: dict[str, Any]) -> str:
    known, value = METRICS[metric], found["value"]
    between = interval(found["ci95"] and [known.scale * bound for bound in found["ci95"]], known.digits)
    shown = number(None if value is None else known.scale * value, known.digits)
    return f"{shown}\n({between})" if between else shown  # a single lap has no interval


def _table(found: Findings, sweep: dict[str, Any]) -> dict[str, Any]:
    """Return one sweep's arms as rows of text, the metrics that it names in every car."""
    metrics, several = list(sweep["metrics"]), len(found.policies) > 1
    rows = [
        [
            _words(row["arm"]),
            *([POLICIES[of(row)]] if several else []),
            row["car"],
            str(row["trainings"] or "–"),
            *(_cell(m, row[m]) for m in metrics),
        ]
        for row in found.arms(sweep["sweep"])
    ]
    heads = ["arm", *(["policy"] if several else []), "car", "trainings", *(METRICS[m].head for m in metrics)]
    return {"name": _words(sweep["sweep"]), "question": sweep["question"], "heads": heads, "rows": rows}


def _claim(same: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return a claim with its verdict and tests for every policy."""
    judged = [
        {
            "policy": POLICIES[of(claim)] if len(same) > 1 else "",
            "verdict": claim["verdict"],
            "told": told(claim),
            "tests": [_test(test) for test in claim["tests"]],
        }
        for claim in same
    ]
    return {"claim": same[0]["claim"], "says": same[0]["says"], "judged": judged}


def _sensitivity(facts: dict[str, Any]) -> dict[str, Any]:
    """Return the claims' verdicts with the twin and with other cars in its place; a verdict that turns is marked."""
    others = facts.get("in_other_twins", [])
    cars = list(dict.fromkeys(row["car"] for row in others))
    judged = {(row["sweep"], row["claim"], of(row), row["car"]): row["verdict"] or "no verdict" for row in others}
    rows = []
    for claim in facts["claims"]:
        which, several = (claim.get("sweep", ""), claim["claim"], of(claim)), len(policies(map(of, others))) > 1
        if not cars or (*which, cars[0]) not in judged:
            continue
        own = claim["verdict"] or "no verdict"
        there = [judged[*which, car] for car in cars]
        rows.append(
            {
                "claim": ", ".join(filter(None, (str(claim["claim"]), POLICIES[of(claim)] if several else ""))),
                "own": own,
                "cells": [{"verdict": each, "turns": each != own} for each in there],
            }
        )
    return {"cars": [_words(car).removeprefix(f"{TWIN} ") for car in cars], "rows": rows}


def _test(test: dict[str, Any]) -> dict[str, Any]:
    """Return a test as a sentence, a picture of its interval, its outcome and its formula."""
    known = METRICS[test["metric"]]
    scale, unit = (100.0, "%") if test["relative_to"] else (known.scale, known.unit)
    (side, bound), effect, ci95 = next(iter(test["limit"].items())), test["effect"], test["ci95"]
    limit = {side: scale * bound}
    wanted = f"{side} {scale * bound:.3g} {unit}" if side != "within" else f"within ± {scale * bound:.3g} {unit}"
    told_power = f"; {power(test['needed'])}" if test.get("needed") else ""
    outcome = {
        True: "as claimed",
        False: "not as claimed",
        None: f"open, {test['why'] or 'the interval holds the threshold'}{told_power}",
    }
    shown = None if effect is None else scale * effect
    between = None if ci95 is None else [scale * each for each in ci95]
    return {
        "sentence": _sentence(test, shown, between, unit),
        "wanted": wanted,
        "outcome": outcome[test["holds"]] if was_tested(test) else f"not tested, {test['why']}",
        "plot": Markup("") if shown is None else draw_interval(shown, between, limit, unit),
        "formula": _formula(test),
        "seeds": f"{test['agreeing']} of {test['seeds']}" if was_tested(test) and test["seeds"] else "",
        "one_lap": ", ".join(map(_words, test["one_lap"])),
    }


def _sentence(test: dict[str, Any], effect: float | None, ci95: Sequence[float] | None, unit: str) -> str:
    """Return what a test found, numbers in `unit`; what it compares where it found nothing."""
    where = "" if test["metric"] in OF_TRAINING else f"In the {test['car']}, "
    name = METRICS[test["metric"]].name
    ours, theirs = (
        _together({arm: abs(weight) for arm, weight in test["weights"].items() if (weight > 0) == first})
        for first in (True, False)
    )
    sure = f" ({_signed(ci95[0])} … {_signed(ci95[1])} {unit})" if ci95 and ci95[0] < ci95[1] else ""
    if test["slope"]:
        places = ", ".join(f"{_quoted(arm)} at {x:g}" for arm, x in test["slope"].items())
        said = f"the slope of the {name} over {places}" + (
            "" if effect is None else f" is {_signed(effect)} {unit} per 1"
        )
    elif not theirs:
        said = f"the {name} {ours}" + ("" if effect is None else f" is {effect:.3g} {unit}")
    elif not effect:
        said = f"the {name} {ours} {'against' if effect is None else 'equals'} that {theirs}"
    else:
        said = f"the {name} {ours} is {abs(effect):.3g} {unit} {'above' if effect > 0 else 'below'} that {theirs}"
    slow = "".join(f"; not every training of {_quoted(arm)} has such a lap" for arm in test.get("lapless", ()))
    sentence = f"{where}{said}{sure}{slow}"
    return sentence[0].upper() + sentence[1:]


def _signed(value: float) -> str:
    return f"{value:+.3g}".replace("-", "−") if value else "0"


def _quoted(arm: str) -> str:
    return f"“{_words(arm)}”"


def _together(weights: Mapping[str, float]) -> str:
    """Return "of" and the arms, with what their weights add up to where that is not 1; empty for none."""
    names = [_quoted(arm) for arm in weights]
    if not names:
        return ""
    listed = f"{', '.join(names[:-1])} and {names[-1]} on average" if len(names) > 1 else names[0]
    total = sum(weights.values())
    return f"of {listed}" if abs(total - 1.0) < 1e-9 else f"of {listed} times {total:.3g}"


def _formula(test: dict[str, Any]) -> str:
    weighed = " ".join(f"{weight:+.3g} × {_words(arm)}" for arm, weight in test["weights"].items())
    over = f", divided by {_words(test['relative_to'])}" if test["relative_to"] else ""
    return f"{METRICS[test['metric']].head}: {weighed}{over}"


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
        laps = laps[laps["policy"] == of(row)]
        name = ", ".join(filter(None, (_words(row["arm"]), found.words(of(row)))))
        deviation = laps["time_s"].std()
        rows.append(
            {
                "driver": f"{name}, {'recorded' if recorded else row['car']}",
                "fastest": _cell("fastest", row["fastest"]),
                "mean": _cell("lap_time", row["lap_time"]),
                "std": number(None if pd.isna(deviation) else deviation, 3),
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
            "e_off": number(row.e_off, 5),
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
