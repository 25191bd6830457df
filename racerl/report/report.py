"""The report stage: one self-contained HTML page about finished runs, and its figures as SVG files."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from racerl import bounds
from racerl.errors import RunError
from racerl.optimum.floor import gap
from racerl.paper import NAMES, table_1
from racerl.report.figures import channels, lap_times, learning_curve, racing_line
from racerl.report.page import figure, interval, number, write_page
from racerl.report.subjects import RACED, Subject, find_subjects
from racerl.report.sweep_page import section
from racerl.run import RunFolder, find_runs

FIGURES = (
    ("racing_line", racing_line.draw, "Racing line", "Fastest lap over the track, coloured by speed."),
    (
        "channels",
        channels.draw,
        "Speed, steering and offset",
        "Fastest lap over the track coordinate; n is positive to the left, the outer lines are the boundaries.",
    ),
    ("lap_times", lap_times.draw, "Lap times", "Every finished lap; the box spans the quartiles."),
    (
        "learning_curve",
        learning_curve.draw,
        "Learning",
        "Reward per control step of the noisy training policy, and laps "
        "of the noise-free policy in cars of the training's randomization.",
    ),
)


SHOWN = ("train", "sweep", *RACED)  # stages whose runs a page can be about


def report(settings: Mapping[str, Any], out: Path, outputs: Path = Path("outputs")) -> Path:
    """Write the page about `settings["runs"]`, or about all that was raced or swept under `outputs`; return its path.

    Raises RunError when there is none, or one is damaged.
    """
    runs = bounds.words("runs", settings["runs"], "a list of run folders is expected")
    given = [RunFolder.open(Path(run)) for run in runs]
    for run, folder in zip(runs, given, strict=True):
        if (stage := folder.manifest["stage"]) not in SHOWN:
            raise RunError(f"{run}: is a run of racerl {stage}, which holds no laps; allowed are {', '.join(SHOWN)}")
    around = find_runs(outputs)
    swept = [run.path for run in given or around if run.manifest["stage"] == "sweep"]
    others = [run.path for run in given if run.path not in swept]
    found = find_subjects(others, outputs) if others or not given else []
    subjects = found if given else [subject for subject in found if subject.evaluation is not None]
    if not subjects and not swept:
        raise RunError(nothing([run.path for run in around if run.manifest["stage"] == "train"], outputs))
    folder = RunFolder.start(out, "report", settings)
    figures = [
        figure(folder.path / f"{name}.svg", title, caption, svg)
        for name, draw, title, caption in FIGURES
        if (svg := draw(subjects)) is not None
    ]
    sweeps = [section(path, folder.path / path.name) for path in swept]
    page = write_page(
        folder.path,
        "page.html.j2",
        headline=headline(subjects) if subjects else sweeps[0]["headline"],
        rows=[*map(table_row, subjects), *paper_rows()] if subjects else [],
        figures=figures,
        sweeps=sweeps,
        left_out="" if given else left_out(around, outputs, found),
        remarks=_remarks(subjects),
        provenance=[run for subject in subjects for run in origins(subject)],
    )
    folder.finish()
    return page


def headline(subjects: Sequence[Subject]) -> str:
    """Return what the cleanest of the drivers did, of equally clean ones the fastest: mean lap and clean laps."""
    raced = [(s, s.evaluation.metrics) for s in subjects if s.evaluation is not None]
    if not raced:
        return f"{', '.join(subject.name for subject in subjects)}: not raced yet"
    best, m = min(raced, key=lambda pair: _rank(pair[1]))
    lap = "no lap finished" if m["mean_lap_s"] is None else f"{m['mean_lap_s']:.2f} s"
    others = f" ({best.title}, the cleanest of {len(raced)})" if len(raced) > 1 else ""
    return f"{lap}, {m['valid_laps']} of {m['laps']} laps clean{others}"


def _rank(m: Mapping[str, Any]) -> tuple[float, float]:
    """Return what sorts the cleanest first, of equally clean ones the fastest."""
    return -m["valid_laps"] / max(1, m["laps"]), math.inf if m["mean_lap_s"] is None else m["mean_lap_s"]


def nothing(trained: Sequence[Path], outputs: Path) -> str:
    """Return why there is nothing to report, and the next command."""
    if not trained:
        return f"{outputs}: holds no finished run; train one with: racerl train +dr=friction_0.02"
    return f"{outputs}: holds no run that was raced; race one with: racerl evaluate {trained[-1]}"


def left_out(around: Sequence[RunFolder], outputs: Path, subjects: Sequence[Subject]) -> str:
    """Return one line about the runs that were found and have no laps to show; empty when there are none."""
    shown = (*RACED, "sweep", "report", "compare")
    raced = {s.training["run_id"] for s in subjects if s.training is not None and s.evaluation is not None}
    stages: dict[str, list[str]] = {}
    for run in around:
        stage = run.manifest["stage"]
        if stage not in shown and run.manifest["run_id"] not in raced:
            stages.setdefault(stage, []).append(str(run.path.relative_to(outputs)))
    return "; ".join(f"{stage}: {', '.join(paths)}" for stage, paths in stages.items())


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100.0 * share:+.1f}"


def table_row(subject: Subject) -> dict[str, Any]:
    """Return a driver's row of Table I as text."""
    if subject.evaluation is None:
        blank = dict.fromkeys(
            ("car", "fastest", "mean", "gap", "settled", "interval", "std", "e_off", "crashes", "valid"), "–"
        )
        return {"paper": False, "driver": subject.title, **blank}
    m = subject.evaluation.metrics
    return {
        "paper": False,
        "driver": subject.title,
        "car": m["car"],
        "fastest": number(m["fastest_valid_lap_s"], 3),
        "mean": number(m["mean_lap_s"], 3),
        "gap": _percent(gap(m["mean_lap_s"], subject.evaluation.floor_s)),
        "settled": number(m["settled_lap_s"], 3),
        "interval": interval(m.get("mean_lap_ci95"), 3) or "–",
        "std": number(m["std_lap_s"], 3),
        "e_off": number(m["e_off"], 5),
        "crashes": f"{100.0 * m['crash_share']:.0f}",
        "valid": f"{m['valid_laps']} of {m['laps']}",
    }


def paper_rows() -> list[dict[str, Any]]:
    """Return the rows of the paper's Table I as text."""
    return [
        {
            "paper": True,
            "driver": NAMES[row["name"]],
            "car": "real",
            "fastest": number(row["fastest_valid_lap_s"], 3),
            "mean": number(row["mean_lap_s"], 3),
            "gap": "–",
            "settled": "–",
            "interval": "–",
            "std": number(row["std_lap_s"], 2),
            "e_off": number(row["e_off"], 5),
            "crashes": "–",
            "valid": "– of 20",
        }
        for row in table_1().to_dict("records")
    ]


def _remarks(subjects: Sequence[Subject]) -> list[str]:
    remarks = [
        f"{subject.name} has not been raced: racerl evaluate RUN" for subject in subjects if subject.evaluation is None
    ]
    remarks += [
        f"{subject.name}: no time-optimal lap of its car and track is at hand: racerl optimum finds it"
        for subject in subjects
        if subject.evaluation is not None and subject.evaluation.floor_s is None
    ]
    for subject in subjects:
        for stage, facts in (
            ("training", subject.training),
            ("evaluation", subject.evaluation and subject.evaluation.manifest),
        ):
            if facts and facts.get("diverged"):
                remarks.append(f"{subject.name}: its training {facts['diverged']}")
            if facts and facts.get("nan_cars"):
                remarks.append(f"{subject.name}: the simulation failed (NaN) {facts['nan_cars']} times in {stage}")
    return remarks


def origins(subject: Subject) -> list[dict[str, Any]]:
    """Return where the numbers of a driver come from, a row per run."""
    manifests = [subject.training, subject.evaluation.manifest if subject.evaluation else None]
    return [
        {
            "name": subject.name,
            "torch": manifest.get("libraries", {}).get("torch", "–"),
            "git_sha": (manifest.get("git_sha") or "–")[:18],
            **{
                key: manifest.get(key, "–") for key in ("stage", "seed", "steps", "seconds", "threads", "device", "cpu")
            },
        }
        for manifest in manifests
        if manifest
    ]
