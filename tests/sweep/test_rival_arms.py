"""Arms that train nothing: one job for all seeds, rows beside those of policies, and the pages that show them."""

import dataclasses
import json
import re
import shutil

import numpy as np
import pandas as pd
import pytest

from racerl.assemble import build_track
from racerl.config import compose_settings
from racerl.errors import RacerlError
from racerl.report.sweep_page import draw_sweep
from racerl.run import RunFolder
from racerl.sweep import sweep as sweeping
from racerl.sweep import work as stage
from racerl.sweep.definition import METRICS, Comparison, read_sweeps
from racerl.sweep.elsewhere import Elsewhere
from racerl.sweep.jobs import UNTRAINED, Race, plan
from racerl.sweep.statistics import MEASURES, contrast, resample
from racerl.sweep.sweep import gather, results, summarise
from racerl.sweep.tables import LAPS, TRAININGS
from racerl.sweep.work import work

SETTINGS = {
    "words": [],
    "threads": 1,
    "seeds": [],
    "laps": 1,
    "starts": [0, 1],
    "cars": ["model", "twin"],
    "twins": [],
}


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """A finished sweep of rivals alone."""
    out = tmp_path_factory.mktemp("rivals") / "sweep"
    RunFolder.start(out, "sweep", SETTINGS)
    track = build_track(compose_settings("train"))
    line = out / "line.csv"
    line.write_text("\n".join(f"0; {x}; {y}; 0; 0; 1.5; 0" for x, y in zip(track.x, track.y, strict=True)))
    arms = {
        "pursuit": ("controller=pure_pursuit", f"controller.raceline={line}"),
        "human": ("run=paper:human", "track=l_shape"),
        "human_like": ("drive=human_like",),
    }
    sweep = dataclasses.replace(read_sweeps("controllers")[0], arms=arms, claims=(), seeds=(0, 1))
    made = plan([sweep], SETTINGS, out, compose_settings)
    for job in made.jobs:
        work(job.name, str(job.path), job.train, job.races, None)
    return made


def test_there_is_one_job_for_all_seeds(planned):
    assert sorted(job.name for job in planned.jobs) == ["human", "human_like", "pursuit"]
    assert all(job.done and job.train is None for job in planned.jobs)
    assert {seed for _, _, seed in planned.of} == {UNTRAINED}


def test_their_laps_stand_beside_those_of_policies(planned):
    tables = gather(planned, SETTINGS["laps"])
    laps = tables[LAPS]
    assert laps["number"].max() == 1  # a recorded driver goes on, what counts ends
    human = laps[laps["arm"] == "human"]
    assert len(human) == 2 and human["time_s"].nunique() == 1  # the same in both cars
    assert len(laps[(laps["arm"] == "human_like") & (laps["car"] == "twin")]) == 2  # a run for every start
    facts = results(planned.sweeps, SETTINGS["cars"], laps, tables[TRAININGS])
    rows = {(row["arm"], row["car"]): row for row in facts["arms"]}
    assert len(rows) == 6 and all(row["trainings"] == 0 for row in rows.values())
    assert rows["human", "model"]["lap_time"]["value"] == pytest.approx(5.85, abs=0.01)
    assert rows["human", "model"]["reward"]["value"] is None
    assert rows["pursuit", "twin"]["lap_time"] != rows["pursuit", "model"]["lap_time"]


def test_the_page_has_table_1_with_recorded_drives_once(planned):
    out = planned.jobs[0].path.parent.parent
    summarise(planned, SETTINGS, out, {})
    page = draw_sweep(out).read_text()
    drivers = re.findall(r"<td>([^<]*, (?:model|twin|recorded|real car))</td>", page)
    assert drivers.count("human, recorded") == 1 and "human, model" not in drivers
    assert {"pursuit, model", "pursuit, twin", "human like, twin", "paper: MPC, real car"} <= set(drivers)
    assert "5.850</td>" in page  # one lap, no interval


def elsewhere(planned, tmp_path, **changes):
    """The same sweep in another folder, which is told of the first."""
    settings = {**SETTINGS, **changes}
    first = planned.jobs[0].path.parent.parent
    summarise(planned, SETTINGS, first, {})
    again = plan(planned.sweeps, settings, tmp_path / "second", compose_settings)
    return again, Elsewhere.read([str(first)], again, settings)


def test_what_another_sweep_finished_stands_in_for_the_same_jobs(planned, tmp_path):
    again, found = elsewhere(planned, tmp_path)
    assert found.has(again) == {"human", "human_like", "pursuit"} and found.origins[0]["jobs"] == 3
    before, after = (gather(*asked) for asked in ((planned, 1), (again, 1, found.tables)))
    for name in (LAPS, TRAININGS):
        pd.testing.assert_frame_equal(before[name], after[name], check_dtype=False, rtol=1e-5)
    assert not any(job.path.exists() for job in again.jobs)
    (tmp_path / "second").mkdir()
    facts = summarise(again, SETTINGS, tmp_path / "second", {}, found)
    assert facts["jobs"] == {"planned": 3, "done": 3} and facts["also"] == list(found.origins)


def test_the_same_job_under_another_name_stands_in(planned, tmp_path):
    arms = {"a_driver": planned.sweeps[0].arms["human_like"]}
    other = dataclasses.replace(planned, sweeps=[dataclasses.replace(planned.sweeps[0], name="mine", arms=arms)])
    again, found = elsewhere(other, tmp_path)
    assert found.has(again) == {"a_driver"}
    ours, theirs = gather(again, 1, found.tables)[LAPS], gather(planned, 1)[LAPS]
    theirs = theirs[theirs["arm"] == "human_like"]
    assert set(ours["arm"]) == {"a_driver"} and set(ours["sweep"]) == {"mine"}
    assert ours["time_s"].tolist() == pytest.approx(theirs["time_s"].tolist(), rel=1e-5)  # as tables keep them


def test_jobs_with_other_words_are_not_the_same(planned, tmp_path):
    arms = dict(planned.sweeps[0].arms) | {"human_like": ("drive=human_like", "drive.block=30")}
    other = dataclasses.replace(planned, sweeps=[dataclasses.replace(planned.sweeps[0], arms=arms)])
    again, found = elsewhere(other, tmp_path)
    assert found.has(again) == {"human", "pursuit"}


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"laps": 2}, "has laps = 1, this sweep 2"),
        ({"starts": [0]}, r"has starts = \[0, 1\], this sweep \[0\]"),
        ({"cars": ["model", "twin", "twin_half"]}, "did not race in twin_half"),
        ({"words": ["track=oval"]}, "none of its trainings"),
    ],
)
def test_laps_of_another_race_do_not_stand_in(planned, tmp_path, changes, said):
    mine = dataclasses.replace(planned.sweeps[0], arms={"pursuit": ("controller=pure_pursuit",)})
    with pytest.raises(RacerlError, match=said):
        elsewhere(dataclasses.replace(planned, sweeps=[mine]), tmp_path, **changes)


def copy_of(planned, tmp_path):
    """The first sweep's folder, without its jobs."""
    first = planned.jobs[0].path.parent.parent
    summarise(planned, SETTINGS, first, {})
    return shutil.copytree(first, tmp_path / "copy", ignore=shutil.ignore_patterns("jobs"))


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda facts: facts["cars"].update(twin="0"), "raced in another twin"),
        (lambda facts: facts["cars"].pop("twin"), "did not race in twin"),
    ],
)
def test_cars_of_the_same_name_and_other_numbers_are_others(planned, tmp_path, change, said):
    copied = copy_of(planned, tmp_path)
    facts = json.loads((copied / "results.json").read_text())
    change(facts)
    (copied / "results.json").write_text(json.dumps(facts))
    with pytest.raises(RacerlError, match=said):
        Elsewhere.read([str(copied)], planned, SETTINGS)


def test_a_sweep_that_has_not_ended_is_told(planned, tmp_path):
    copied = copy_of(planned, tmp_path)
    (copied / "results.json").unlink()
    with pytest.raises(RacerlError, match="run that sweep on until it ends"):
        Elsewhere.read([str(copied)], planned, SETTINGS)


def test_arms_may_have_any_name_and_jobs_that_of_another_arm(planned, tmp_path):
    copied = copy_of(planned, tmp_path)
    for name in (LAPS, TRAININGS):
        table = pd.read_csv(copied / name, dtype=str, keep_default_na=False)
        table["arm"] = table["arm"].replace({"human": "NA", "pursuit": "0.02"})
        if "job" in table:
            table["job"] = "other-" + table["job"].str.rpartition("-")[2]
        table.to_csv(copied / name, index=False)
    named = {"NA": "human", "0.02": "pursuit", "human_like": "human_like"}
    arms = {arm: planned.sweeps[0].arms[was] for arm, was in named.items()}
    again = plan([dataclasses.replace(planned.sweeps[0], arms=arms)], SETTINGS, tmp_path / "second", compose_settings)
    found = Elsewhere.read([str(copied)], again, SETTINGS)
    assert found.has(again) == set(arms) and found.origins[0]["jobs"] == 3


def test_a_damaged_table_is_told(planned, tmp_path):
    copied = copy_of(planned, tmp_path)
    (copied / LAPS).write_text("not,a,table\n1,2,3\n")
    with pytest.raises(RacerlError, match="is damaged"):
        Elsewhere.read([str(copied)], planned, SETTINGS)


def test_rivals_race_in_the_world_of_the_others(tmp_path):
    sweep = dataclasses.replace(
        read_sweeps("controllers")[0],
        base=("dr=friction_0.02", "vehicle=published"),
        arms={
            "mpc": ("controller=mpc",),
            "like": ("drive=human_like", "vehicle=jetracer"),
            "human": ("run=paper:human", "track=l_shape"),
        },
        claims=(),
    )
    settings = {**SETTINGS, "words": ["budget=smoke", "sim.step=0.005"]}
    jobs = {job.name: job for job in plan([sweep], settings, tmp_path, compose_settings).jobs}
    published, jetracer = (
        compose_settings("train", [f"vehicle={name}"])["vehicle"] for name in ("published", "jetracer")
    )
    assert jobs["mpc"].races["", "twin"].settings["vehicle"] == published
    assert jobs["mpc"].races["", "model"].settings["sim"]["step"] == 0.005
    assert jobs["like"].races["", "model"].record["vehicle"]["mass"] == jetracer["mass"]  # its own word counts
    assert jobs["human"].races["", "model"].settings["track"] is not None
    again = {job.name: job for job in plan([sweep], SETTINGS, tmp_path, compose_settings).jobs}
    assert again["mpc"].path != jobs["mpc"].path and again["human"].path == jobs["human"].path


def test_rivals_come_behind_the_first_trainings_and_before_the_others(tmp_path):
    (sweep,) = read_sweeps("controllers")
    settings = {**SETTINGS, "words": ["budget=smoke"], "cars": ["model"]}
    names = [job.name for job in plan([sweep], settings, tmp_path, compose_settings).jobs]
    rivals = {"mpc", "pure_pursuit", "optimum", "human", "human_like"}
    assert all(name.endswith("-0") for name in names[:3]) and set(names[3:8]) == rivals
    assert [name[-2:] for name in names[8:]] == [f"-{seed}" for seed in (1, 2, 3, 4) for _ in range(3)]


@pytest.mark.parametrize(
    "words, laps, twins, driven, raced",
    [
        (["budget=smoke"], None, None, 2, []),
        (["budget.trial=true"], None, None, 2, []),
        ([], None, None, 20, ["twin_half"]),
        (["budget=smoke"], 7, ["twin_double"], 7, ["twin_double"]),
        ([], None, [], 20, []),
    ],
)
def test_a_trial_is_raced_for_a_few_laps_and_in_no_other_twins(
    tmp_path, monkeypatch, words, laps, twins, driven, raced
):
    class Enough(Exception):
        pass

    def stop(sweeps, settings, out, compose):
        raise Enough(settings)

    monkeypatch.setattr(sweeping, "plan", stop)
    monkeypatch.setattr(
        sweeping, "read_sweeps", lambda name: [dataclasses.replace(read_sweeps(name)[0], twins=("twin_half",))]
    )
    settings = compose_settings("sweep", ["name=controllers"])
    assert settings["laps"] is None and settings["twins"] is None
    with pytest.raises(Enough) as asked:
        sweeping.sweep({**settings, "words": words, "laps": laps, "twins": twins}, tmp_path, compose_settings)
    planned = asked.value.args[0]
    assert planned["laps"] == driven and planned["cars"] == ["model", "twin", *raced]


def test_a_race_tells_its_laps(planned, tmp_path, monkeypatch):
    """Through the file that a training tells its steps by."""
    told = []
    monkeypatch.setattr(stage, "PERIOD", 0.0)
    monkeypatch.setattr(stage, "write_json", lambda path, facts: told.append((path, facts)))
    for name in ("pursuit", "human_like"):
        job = next(job for job in planned.jobs if job.name == name)
        races = {place: move(asked, tmp_path.joinpath(name, *place)) for place, asked in job.races.items()}
        work(name, str(tmp_path / name), None, races, None)
    shares = [facts["share"] for path, facts in told if path == tmp_path / "pursuit" / stage.STATE]
    remarks = {facts["remark"] for _, facts in told}
    assert shares == sorted(shares) and len(set(shares)) > 4 and shares[-1] == 1.0
    assert {f"racing ({car}), lap {lap} of 2" for car in ("model", "twin") for lap in (0, 1, 2)} <= remarks
    assert "racing (twin), being driven" in remarks


def move(asked, out):
    """Return a race of two laps in another folder."""
    record = asked.record and {**asked.record, "out": str(out) + "_drive", "seconds": 20.0}
    settings = {**asked.settings, "laps": 2} if "laps" in asked.settings else asked.settings
    if record:
        settings = {**settings, "run": f"{record['out']}/{record['file']}"}
    return Race(settings, record)


def rows_of(arm, seed, times):
    measures = dict.fromkeys(MEASURES, 0.0) | {"valid": True, "crashed": False, "turn_in_m": np.nan}
    return [{"arm": arm, "seed": seed, "start": 0, **measures, "time_s": time} for time in times]


def test_seeds_of_policies_do_not_narrow_the_interval_of_what_is_not_trained():
    spread_out = [5.0, 6.0, 7.0, 8.0]
    laps = pd.DataFrame(
        rows_of("rival", UNTRAINED, spread_out)
        + [row for seed in range(8) for row in rows_of("policy", seed, [5.0 + seed / 10] * 4)]
    )
    rewards = pd.DataFrame({"arm": ["rival"] + ["policy"] * 8, "seed": [UNTRAINED, *range(8)], "reward": np.nan})
    samples = resample(laps, rewards, np.random.default_rng(0))
    assert len(samples.per_seed["rival"]["lap_time"]) == 1 and len(samples.per_seed["policy"]["lap_time"]) == 8
    # four laps drawn from four: a standard deviation of √1.25/2
    assert samples.resampled["rival"]["lap_time"].std() == pytest.approx(np.sqrt(1.25) / 2, rel=0.1)
    difference = contrast(
        Comparison("lap_time", {"policy": 1.0, "rival": -1.0}, below=0.0),
        {arm: samples.per_seed[arm]["lap_time"] for arm in ("policy", "rival")},
    )
    assert np.allclose(difference, 5.0 + np.arange(8) / 10 - 6.5)
    assert set(METRICS) == set(samples.per_seed["rival"])
