"""The page of a sweep: verdicts, sentences, intervals and colours, from files whose content is known."""

import json
import re
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from racerl.report.figures.style import COLOURS
from racerl.report.interval import draw as draw_interval
from racerl.report.sweep_page import Findings, draw_sweep
from racerl.run import RunFolder
from racerl.sweep import statistics
from racerl.sweep.conclusions import headline
from racerl.sweep.definition import read_sweeps
from racerl.sweep.statistics import MEASURES, told, weigh
from racerl.sweep.sweep import results
from racerl.sweep.tables import LAPS, LEARNING, RESULTS, STEERING, TRAININGS

TIMES = {"geometric": 5.5, "progress": 6.0, "speed_rate": 5.5, "speed": 5.4, "with_actuators": 5.5}
NAMES = ("track_representation", "action_space", "actuator_model")


@pytest.fixture(scope="module", autouse=True)
def few_resamples():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(statistics, "RESAMPLES", 50)
        yield


def swept(folder: Path, trial: int | None = None, seeds: int = 3, policies=("learned",), twins=()) -> Path:
    """Leave the files of a sweep of three ablations whose laps are known; the arm without_actuators has failed.

    Refined policies of `speed` leave the track, as they were learned they don't; of `twins`, `geometric` is slowest.
    """
    RunFolder.start(folder, "sweep", {}, threads=1)
    generator = np.random.default_rng(0)
    laps, trainings, curves, steering = [], [], [], []
    sweeps = [sweep for name in NAMES for sweep in read_sweeps(name)]
    for sweep in sweeps:
        for arm in sweep.arms:
            for seed in range(seeds) if arm in TIMES else ():
                where = {"sweep": sweep.name, "arm": arm, "seed": seed}
                job = "base" if TIMES[arm] == 5.5 else arm  # the same training under several names
                facts = {"reward": 0.9 / TIMES[arm] + 0.001 * seed, "job": f"{arm}-{seed}-{job}{seed}"}
                trainings += [{**where, "policy": policy, **facts} for policy in policies]
                curves.append(pd.DataFrame({**where, "steps": [1e6, 2e6], "reward": [0.1, 0.9 / TIMES[arm]]}))
                for policy, car in product(policies, ("model", "twin", *twins)):
                    raced = {**where, "policy": policy, "car": car}
                    if "turn_in" in sweep.metrics:
                        steering.append(pd.DataFrame({**raced, "s_m": [0.0, 1.0], "delta_rad": [0.0, 0.1]}))
                    for number in range(4):
                        measures = dict.fromkeys(MEASURES, 0.0) | {"valid": True, "crashed": False}
                        if policy == "refined" and arm == "speed":
                            measures |= {"off_track_m": generator.uniform(0.3, 0.5), "valid": (seed + number) % 7 == 0}
                        time = TIMES[arm] + generator.normal(0.0, 0.02) + (car in twins and arm == "geometric")
                        laps.append({**raced, "start": 0, "number": number, **measures, "time_s": time})
    tables = {LAPS: pd.DataFrame(laps), TRAININGS: pd.DataFrame(trainings)}
    tables |= {LEARNING: pd.concat(curves), STEERING: pd.concat(steering)}
    for name, table in tables.items():
        table.to_csv(folder / name, index=False)
    facts = results(sweeps, ["model", "twin"], tables[LAPS], tables[TRAININGS], trial is not None, twins)
    facts |= {"jobs": {"planned": 4, "done": 4}, "failed": {}, "trial_steps": trial}
    (folder / RESULTS).write_text(json.dumps(facts))
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return swept(tmp_path_factory.mktemp("sweeps") / "sweep")


@pytest.fixture(scope="module")
def page(folder):
    return draw_sweep(folder).read_text()


def test_the_title_counts_the_verdicts_of_the_results(folder, page):
    verdicts = [claim["verdict"] for claim in json.loads((folder / RESULTS).read_text())["claims"]]
    assert verdicts == ["refuted", "undecided", "not tested", "not tested"]  # every lap clean: no width
    assert "<title>0 supported, 1 refuted, 1 undecided, 2 not tested</title>" in page
    assert "<h1>0 supported, 1 refuted, 1 undecided, 2 not tested</h1>" in page


def test_a_claim_is_a_sentence_with_its_interval_and_the_formula_is_folded(page):
    assert re.search(
        r"In the twin, the mean lap of “geometric” is 8\.\d+ % below that of “progress” \(−8\.\d+ … −8\.\d+ %\)\. "
        r"Claimed: below 0 %\. <b>As claimed\.</b>",
        page,
    )
    assert "<b>not tested, without actuators has not been driven</b>" in page
    folded = re.findall("<details>.*?</details>", page, re.DOTALL)
    assert len(folded) == 4 and "+1 × geometric -1 × progress, divided by progress" in folded[0]
    assert page.count('class="effect" role="img"') == 5  # tests that had what they need


def test_no_zero_is_drawn_out_and_every_column_has_a_unit(page):
    assert "0.00000" not in page
    heads = re.findall("<th[^>]*>([^<]*)</th>", page)
    assert {head for head in heads if "[" not in head} == {"arm", "car", "trainings", "claim", "says", "verdict"}


def test_one_arm_has_one_colour_in_every_figure(folder):
    found = Findings.read(folder)
    same = {found.colours[key] for key in found.colours if TIMES[key[1]] == 5.5}
    assert len(same) == 1 and len(set(found.colours.values())) == 3
    svg = {name: (folder / f"{name}.svg").read_text() for name in ("learning", "transfer", "turn_in")}
    used = {name: set(re.findall("#[0-9a-f]{6}", each)) & set(COLOURS) for name, each in svg.items()}
    assert used["learning"] == used["transfer"] == set(found.colours.values()) and used["turn_in"] == same
    ours, theirs = svg["learning"].split('id="axes_2"')
    base = found.colours["track_representation", "geometric"]
    legend = r'stroke: (#[0-9a-f]{6})[^>]*/>\s*</g>\s*<g id="text_\d+">\s*<text[^>]*>([^<]*)</text>'
    labelled, paper = dict(re.findall(legend, ours)), dict(re.findall(legend, theirs))
    assert labelled[base].startswith("geometric, speed rate") and paper[base] == "geometric speed rate"
    assert paper[found.colours["action_space", "speed"]] == "geometric speed"


def test_a_trial_has_a_banner_and_no_verdict(tmp_path):
    page = draw_sweep(swept(tmp_path / "trial", trial=2048)).read_text()
    assert "<h1>A trial of 2,048 control steps per training: no verdicts</h1>" in page
    assert '<p class="warning">Trial budget: trainings of 2,048 control steps' in page
    shown = page.partition("<h3>")[2].partition('<p class="note">')[0]
    assert not re.search("supported|refuted|undecided|as claimed", shown, re.IGNORECASE) and "no verdict" in shown


def test_a_claim_that_holds_for_refined_policies_alone_says_so(tmp_path, page):
    folder = swept(tmp_path / "both", policies=("learned", "refined"))
    facts = json.loads((folder / RESULTS).read_text())
    both = draw_sweep(folder).read_text()
    assert headline(facts) == "As learned: 0 supported, 1 refuted, 1 undecided, 2 not tested; " + (
        "refined: 1 supported, 1 refuted, 0 undecided, 2 not tested"
    )
    rows = re.findall(r"<tr><td>(\d+)</td><td>[^<]*</td>(.*?)</tr>", both)
    verdicts = {int(claim): re.findall("<b>(.*?)</b>", cells) for claim, cells in rows}
    assert (
        verdicts[4] == ["refuted", "refuted"]
        and verdicts[5][0].startswith("undecided")
        and verdicts[5][1] == "supported"
    )
    assert "Policies refined: supported" in both and "Policies" not in page
    assert (folder / "turn_in_learned.svg").is_file() and (folder / "turn_in_refined.svg").is_file()


def test_an_arm_that_was_raced_and_drove_no_lap_has_not_been_driven_and_none_stands_in(tmp_path):
    folder = swept(tmp_path / "creeping", policies=("learned", "refined"))
    laps, trainings = (pd.read_csv(folder / name) for name in (LAPS, TRAININGS))
    gone = (laps["arm"] == "geometric") & (laps["policy"] == "learned")
    sweeps = [sweep for name in NAMES for sweep in read_sweeps(name)]
    facts = results(sweeps, ["model", "twin"], laps[~gone], trainings)
    (learned, refined) = (claim for claim in facts["claims"] if claim["claim"] == 4)
    assert told(learned) == "not tested, geometric has not been driven" and refined["verdict"] == "refuted"
    assert {row["policy"] for row in facts["arms"] if row["arm"] == "geometric"} == {"refined"}


def test_an_arm_without_a_refinement_stands_beside_refined_ones(tmp_path):
    folder = swept(tmp_path / "mixed", policies=("learned", "refined"))
    laps, trainings = (pd.read_csv(folder / name) for name in (LAPS, TRAININGS))
    laps, trainings = (
        table[(table["arm"] != "progress") | (table["policy"] == "learned")] for table in (laps, trainings)
    )
    sweeps = [sweep for name in NAMES for sweep in read_sweeps(name)]
    facts = {**json.loads((folder / RESULTS).read_text()), **results(sweeps, ["model", "twin"], laps, trainings)}
    laps.to_csv(folder / LAPS, index=False)
    trainings.to_csv(folder / TRAININGS, index=False)
    (folder / RESULTS).write_text(json.dumps(facts))
    rows = [row for row in facts["arms"] if row["arm"] == "progress"]
    assert [(row["policy"], row["car"]) for row in rows] == [("learned", "model"), ("learned", "twin")]
    refined = next(c for c in facts["claims"] if c["claim"] == 4 and c["policy"] == "refined")
    assert refined["tests"][1]["holds"]  # against the one there is
    assert "progress" in draw_sweep(folder).read_text() and (folder / "transfer_refined.svg").is_file()


def test_a_sweep_from_before_there_were_two_policies_is_drawn(tmp_path):
    folder = swept(tmp_path / "old")
    for name in (LAPS, TRAININGS, STEERING):
        pd.read_csv(folder / name).drop(columns="policy", errors="ignore").to_csv(folder / name, index=False)
    facts = json.loads((folder / RESULTS).read_text())
    for row in (*facts["arms"], *facts["claims"]):
        del row["policy"]
    del facts["in_other_twins"]
    (folder / RESULTS).write_text(json.dumps(facts))
    assert "<h1>0 supported, 1 refuted, 1 undecided, 2 not tested</h1>" in draw_sweep(folder).read_text()


def test_claims_are_judged_in_other_twins_and_a_verdict_that_turns_is_bold(tmp_path, page):
    folder = swept(tmp_path / "twins", policies=("learned", "refined"), twins=("twin_half",))
    facts = json.loads((folder / RESULTS).read_text())
    other = [row for row in facts["in_other_twins"] if row["claim"] == 4 and row["policy"] == "learned"]
    (own,) = (row for row in facts["claims"] if row["claim"] == 4 and row["policy"] == "learned")
    assert other[0]["car"] == "twin_half" and own["tests"][1]["holds"] and other[0]["tests"][1]["holds"] is False
    assert {row["car"] for row in facts["arms"]} == {"model", "twin"}
    table = draw_sweep(folder).read_text().partition("Which claim rests")[2].partition("</table>")[0]
    assert "<th>half</th>" in table and table.count("<tr>") == 1 + 2 * len(facts["claims"]) // 2
    assert "Which claim rests" not in page


def test_one_training_decides_nothing(tmp_path):
    page = draw_sweep(swept(tmp_path / "single", seeds=1)).read_text()
    assert "<h1>0 supported, 0 refuted, 2 undecided, 2 not tested</h1>" in page and "undecided, 1 training" in page


@pytest.mark.parametrize("limit, dashes", [({"above": 5.0}, 1), ({"below": 0.0}, 1), ({"within": 2.0}, 2)])
def test_the_interval_marks_threshold_and_zero(limit, dashes):
    svg = draw_interval(3.0, [1.0, 4.0], limit, "%")
    assert svg.count('class="threshold"') == dashes and svg.count('class="zero"') == 1
    place = {name: float(re.search(rf'class="{name}" d="M([0-9.]+)', svg)[1]) for name in ("zero", "interval")}
    dot = float(re.search(r'cx="([0-9.]+)"', svg)[1])
    assert place["zero"] < place["interval"] < dot
    shaded = re.search(r'class="claimed" x="([0-9.]+)" y="2" width="([0-9.]+)"', svg)
    first, width = float(shaded[1]), float(shaded[2])
    assert (first <= dot <= first + width) is False


@pytest.mark.parametrize("name", ["ablations", "controllers"])
def test_a_reference_page_agrees_with_its_results(name):
    folder = Path(__file__).parents[2] / "outputs" / "reference" / name
    facts, page = json.loads((folder / RESULTS).read_text()), (folder / "report.html").read_text()
    assert f"<h1>{headline(facts)}</h1>\n" in page
    assert facts["jobs"]["done"] == facts["jobs"]["planned"] and not facts["failed"]
    for claim in facts["claims"]:
        assert (claim["verdict"], claim["why"]) == weigh(claim["tests"])
        assert f"<b>{told(claim)}</b>" in page
    lapless = {arm for claim in facts["claims"] for test in claim["tests"] for arm in test["lapless"]}
    assert lapless == ({"without_actuators"} if name == "ablations" else set())
    assert ("not every training of “without actuators” has such a lap" in page) == bool(lapless)
