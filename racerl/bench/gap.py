"""The blind test of `racerl gap`: logs that hide something, and keys that the workflow never sees.

`blind` is a folder with logs/*.parquet and keys.json, case → {effects: [{name, size, parameters, units}], set,
programme, noise}; `python -m tests.gap.plant` writes one from the project's independent plant. Every case has a
diagnosis in `work`, where an interrupted benchmark goes on. With `withhold`, what a case hides is left out of the
catalogue: then `unknown` is right, or what the catalogue says the truth is confused with; other cases are left out.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from racerl.bench import Compose, Progress
from racerl.documents import content_hash, read_json, write_json
from racerl.errors import ConfigError
from racerl.gap.calibration import Case, calibrate, checked, compared, truth_of
from racerl.gap.diagnose import NAME, VERDICT, gap
from racerl.gap.hypotheses import Hypothesis, calibrated_least
from racerl.run import MANIFEST, is_complete, provenance
from racerl.vehicle.catalogue import confused_with, names
from racerl.vehicle.load import load_vehicle

NAMED = ("named", "multiple")
ALONG = {("lever_arm", "forward"), ("cog_longitudinal_offset", "offset")}  # places, from the centre of gravity
WITHHELD = "withheld"  # the set of cases whose truth the catalogue lacks
USUAL = {"structure": "single_track", "sensors": "ideal"}


@dataclass(frozen=True)
class Gap:
    """Diagnoses of at most `most` cases of a blind set, every one with `vehicle`."""

    blind: str
    work: str
    vehicle: str
    most: int
    withhold: bool
    calibration: str

    def measure(self, compose: Compose, threads: int, on_progress: Progress) -> dict[str, Any]:
        """Return scores with 95 % intervals, the confusion matrix, and every case's outcome.

        With `calibration` a case has what naming saw in every round as well, from which the rule can be fitted again.
        """
        folder = Path(self.blind)
        if not (folder / "keys.json").is_file():
            raise ConfigError(
                f"benchmark.blind = {self.blind}: holds no keys.json; write one: python -m tests.gap.plant"
            )
        keys = read_json(folder / "keys.json")
        asked = {case for case, key in keys.items() if not self.withhold or _known(key)}
        logs = [path for path in sorted((folder / "logs").glob("*.parquet")) if path.stem in asked][: self.most]
        rows, cases, groups = [], [], []
        for i, log in enumerate(logs):
            on_progress(i / len(logs), f"case {i + 1} of {len(logs)}")
            key, out = keys[log.stem], Path(self.work) / log.stem
            words = [f"logs=['{log}']", f"vehicle={self.vehicle}", f"threads={threads}"]
            if self.withhold:
                key, out = {**key, "set": WITHHELD}, out.with_name(f"{out.name}_{WITHHELD}")
                words.append(f"without={[effect['name'] for effect in key['effects']]}")
            settings = compose("gap", words)
            placed = _from_the_configured_centre(key, float(load_vehicle(settings["vehicle"]).l_f))
            rows.append(outcome(log.stem, placed, *_diagnosis(settings, out)))
            if self.calibration and (out / NAME).is_file():
                rows[-1]["rounds"] = read_json(out / NAME)["rounds"]
                cases.append(_case(rows[-1]["truth"], rows[-1]["rounds"]))
                groups.append(kind_of_car(key))
        if self.calibration:
            source = {
                "keys_sha256": content_hash(folder / "keys.json"),
                "vehicle": self.vehicle,
                "threads": threads,
                **provenance(),
            }
            write_json(Path(self.calibration), {"source": source, **calibration(cases, groups)})
        return {
            "gap": {
                "cases": rows,
                "scores": scores(rows),
                "probabilities": probabilities(rows),
                "detection": detection(rows),
                "by_verdict": by_verdict(rows),
                "confusion": confusion(rows),
            }
        }


def kind_of_car(key: dict[str, Any]) -> str:
    """Return a car's tyre, the speed that its slips are over, and its wheels and sensors where they are unusual."""
    unusual = [key[part] for part, usual in USUAL.items() if key.get(part, usual) != usual]
    return ", ".join([str(key.get("tyre")), str(key.get("slip")), *unusual])


def _case(hidden: Iterable[str], rounds: Sequence[dict[str, Any]]) -> Case:
    known = frozenset(hidden) & set(names())
    return Case(known, not known >= set(hidden), rounds)


def probabilities(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return how far the probabilities told are to be trusted; not of withheld truths, nor of two-track cars."""
    told = [row for row in rows if row["hypotheses"] and row["set"] not in (WITHHELD, "structure")]
    if not told:
        return {}
    sets = [[Hypothesis(tuple(each["names"]), each["probability"]) for each in row["hypotheses"]] for row in told]
    return compared(sets, [truth_of(_case(row["truth"], ())) for row in told], calibrated_least())._asdict()


def calibration(cases: Sequence[Case], groups: Sequence[str]) -> dict[str, Any]:
    """Return the weights of a rule fitted to some cases, and how rules fitted to all but a group fare on that group."""
    least, check = checked(cases, groups)
    return {
        "cases": dict(sorted(Counter(groups).items())),
        "weights": calibrate(cases).weights(),
        "least": least,
        "left_out_groups": check._asdict(),
    }


def _from_the_configured_centre(key: dict[str, Any], l_f: float) -> dict[str, Any]:
    """Return a key whose places along the car are told from where the configured vehicle has its centre of gravity.

    The plant tells them from the hidden car's own, which is elsewhere between the axles.
    """
    ahead = l_f - key.get("car", {}).get("l_f", l_f)
    return {
        **key,
        "effects": [
            {
                **effect,
                "parameters": {
                    name: value + ahead * ((effect["name"], name) in ALONG)
                    for name, value in effect["parameters"].items()
                },
            }
            for effect in key["effects"]
        ],
    }


def _known(key: dict[str, Any]) -> bool:
    """Return whether the catalogue has what a case hides."""
    return bool(key["effects"]) and all(effect["name"] in names() for effect in key["effects"])


def _diagnosis(settings: dict[str, Any], out: Path) -> tuple[dict[str, Any], float | None]:
    """Return a verdict and the seconds that it took, an earlier one where it is there."""
    if not is_complete(out):
        gap(settings, out)
    return read_json(out / VERDICT), read_json(out / MANIFEST).get("seconds")


def outcome(case: str, key: dict[str, Any], verdict: dict[str, Any], seconds: float | None) -> dict[str, Any]:
    """Return what a case hid and what was said of it."""
    truth = [effect["name"] for effect in key["effects"]]
    found = [effect["name"] for effect in verdict["effects"]]
    return {
        "case": case,
        "set": key["set"],
        "programme": key["programme"],
        "noise": key["noise"],
        "structure": key.get("structure", "single_track"),
        "truth": truth,
        "sizes": [effect["size"] for effect in key["effects"]],
        "verdict": verdict["verdict"],
        "found": found,
        "rivals": verdict["ambiguous_with"],
        "hypotheses": verdict.get("hypotheses", []),
        "separable": set(truth) <= set(verdict.get("separable", ())),  # declared before anything is named
        "explained": verdict["gap"]["explained"] if verdict["gap"] else None,
        "errors": {name: abs(p["value"] / value - 1.0) for name, p, value in _shared(key, verdict) if value},
        "inside": {name: p["ci95"][0] <= value <= p["ci95"][1] for name, p, value in _shared(key, verdict)},
        "seconds": seconds,
    }


def _shared(key: dict[str, Any], verdict: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any], float]]:
    """Yield name, what was found and the truth of parameters that plant and catalogue give the same name and unit."""
    for true in key["effects"]:
        for found in verdict["effects"]:
            for name, value in true["parameters"].items():
                p = found["parameters"].get(name) if found["name"] == true["name"] else None
                if p and p["unit"] == true["units"][name]:
                    yield f"{true['name']}.{name}", p, value


def right(row: dict[str, Any]) -> bool:
    """Return whether what is said is what was hidden."""
    if not row["truth"]:
        return row["verdict"] in ("none", "under_excited")
    return row["verdict"] in NAMED and set(row["found"]) == set(row["truth"])


def contained(row: dict[str, Any]) -> bool:
    """Return whether all that was hidden is among what is reported."""
    return set(row["truth"]) <= {*row["found"], *row["rivals"]}


def honest(row: dict[str, Any]) -> bool:
    """Return whether a truth that the catalogue lacks is `unknown`, or called by what it is confused with only."""
    said = {*row["found"], *row["rivals"]}
    known = frozenset().union(*map(confused_with, row["truth"]))
    return row["verdict"] == "unknown" or (bool(said) and said <= known)


def wrong_name(row: dict[str, Any]) -> bool:
    """Return whether a single name is claimed that was not hidden."""
    return row["verdict"] == "named" and row["found"][0] not in row["truth"]


def scores(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return shares with Wilson's 95 % interval, and medians."""
    single = [row for row in rows if row["set"] == "single"]
    strong = [row for row in single if row["programme"] == "excitation" and row["sizes"][0] != "small"]
    shares: dict[str, tuple[Sequence[dict[str, Any]], Callable[[dict[str, Any]], bool]]] = {
        "right name, medium and large effects on excitation logs": (strong, right),
        "right name, all single effects": (single, right),
        "right name, where the data are declared to tell": ([row for row in single if row["separable"]], right),
        "right name, race laps": ([row for row in single if row["programme"] == "race"], right),
        "truth in the reported set": (single, contained),
        "wrong single name": ([row for row in rows if row["set"] != WITHHELD], wrong_name),
        "false alarm on clean logs": ([row for row in rows if row["set"] == "clean"], lambda row: not right(row)),
        "unknown, effects of no catalogue": (_of(rows, "unlisted"), lambda row: row["verdict"] == "unknown"),
        "unknown or what it is confused with, truth withheld": (_of(rows, WITHHELD), honest),
        "both of two effects": (_of(rows, "pairs"), right),
        "no name on poor logs": (_of(rows, "poor"), lambda row: row["verdict"] not in NAMED or right(row)),
        "no single name on two-track cars": (_of(rows, "structure"), lambda row: not wrong_name(row)),
    }
    found: dict[str, Any] = {
        title: share(sum(map(test, part)), len(part)) for title, (part, test) in shares.items() if part
    }
    reported = [len(row["found"]) + len(row["rivals"]) for row in single if row["found"]]
    explained = sorted(row["explained"] for row in single if row["explained"] is not None and right(row))
    errors = [error for row in single if row["sizes"] == ["medium"] for error in row["errors"].values()]
    inside = [truth for row in single for truth in row["inside"].values()]
    if inside:
        found["true value inside the 95 % interval"] = share(sum(inside), len(inside))
    if reported:
        found["mean size of the reported set"] = sum(reported) / len(reported)
    if explained:
        found["gap explained, median"] = median(explained)
        found["gap explained, 10th percentile"] = explained[len(explained) // 10]
    if errors:
        found["parameter error at medium size, median"] = median(errors)
    if seconds := [row["seconds"] for row in rows if row["seconds"]]:
        found["seconds per diagnosis, median"] = median(seconds)
    return found


def _of(rows: Sequence[dict[str, Any]], name: str) -> list[dict[str, Any]]:
    return [row for row in rows if row["set"] == name]


def detection(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the share of single effects called by their names, by programme, size and noise."""
    cells: dict[tuple[str, str, float], list[bool]] = {}
    for row in rows:
        if row["set"] == "single":
            cells.setdefault((row["programme"], row["sizes"][0], row["noise"]), []).append(right(row))
    return [
        {"programme": programme, "size": size, "noise": noise, **share(sum(told), len(told))}
        for (programme, size, noise), told in sorted(cells.items())
    ]


def by_verdict(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return how far each kind of verdict is to be trusted: how often it is what should have been said."""
    told: dict[str, list[bool]] = {}
    for row in rows:
        told.setdefault(row["verdict"], []).append(deserved(row))
    return {verdict: share(sum(cases), len(cases)) for verdict, cases in sorted(told.items())}


def deserved(row: dict[str, Any]) -> bool:
    """Return whether a verdict is true: the right name, the truth among rivals, no name where there is none."""
    if row["set"] == WITHHELD:
        return honest(row)
    if row["verdict"] == "ambiguous":
        return contained(row) and bool(row["truth"])
    if row["verdict"] == "unknown":
        return row["set"] == "unlisted" or row["structure"] != "single_track"
    if row["verdict"] == "under_excited":
        return row["set"] == "poor"
    return right(row)


def share(count: int, total: int) -> dict[str, Any]:
    """Return a share with Wilson's 95 % interval."""
    z, p = 1.96, count / total
    middle, half = p + z * z / (2 * total), z * math.sqrt(p * (1 - p) / total + z * z / (4 * total * total))
    scale = 1 + z * z / total
    return {"count": count, "of": total, "share": p, "ci95": [(middle - half) / scale, (middle + half) / scale]}


def confusion(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """Return how often each hidden effect was called what; a verdict without a name goes by the verdict's own.

    Logs too poor to show anything, those of two-track cars and withheld truths have rows of their own among the scores.
    """
    table: dict[str, Counter[str]] = {}
    for row in rows:
        if len(row["truth"]) <= 1 and row["set"] not in ("poor", "structure", WITHHELD):
            said = " + ".join(sorted(row["found"])) if row["verdict"] in NAMED else row["verdict"]
            table.setdefault(row["truth"][0] if row["truth"] else row["set"], Counter())[said] += 1
    return {name: dict(counts) for name, counts in sorted(table.items())}
