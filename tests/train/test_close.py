"""Three policies are trained and raced in the car that the log came from."""

import json
import shutil

import pytest

from racerl.config import compose_settings
from racerl.documents import write_json
from racerl.errors import ConfigError, LogError, RacerlError, RunError
from racerl.run import RunFolder
from racerl.train.close import close, interval, means, recovered
from tests.train.short import refinement


@pytest.fixture
def diagnosed(tmp_path):
    """Return a finished diagnosis that named more friction, whose vehicle files are small changes of one car."""
    folder = RunFolder.start(tmp_path / "gap", "gap", {})
    published = compose_settings("train", ["vehicle=published"])["vehicle"]
    for name, mass in (("model.yaml", 5.1), ("model_before.yaml", 5.0)):
        (folder.path / name).write_text(json.dumps({**published, "mass": mass}))  # JSON is YAML
    write_json(folder.path / "verdict.json", {"verdict": "named", "effects": [{"name": "aero_drag"}]})
    folder.finish()
    return folder.path


def settings_of(run, **changes):
    words = [
        f"logs=['{run}']",
        "real=published",
        "train=['budget=smoke','seed=5']",
        "laps=1",
        "seeds=[0]",
        "trainings=[0]",
        "threads=1",
    ]
    return {**compose_settings("close", words), **changes}


def test_three_policies_race_in_one_car_and_a_second_start_goes_on(diagnosed, tmp_path):
    heard = []
    facts = close(settings_of(diagnosed), tmp_path / "out", compose_settings, lambda share, what: heard.append(what))
    assert list(facts["policies"]) == ["old", "new", "oracle"] and facts["effects"] == ["aero_drag"]
    assert json.loads((tmp_path / "out" / "close.json").read_text()) == facts
    assert heard == [f"{kind}, seed 0: {what}" for kind in ("old", "new", "oracle") for what in ("training", "racing")]
    masses = {}
    for kind in facts["policies"]:
        trained = RunFolder.open_complete(tmp_path / "out" / f"{kind}_0", "train").settings()["vehicle"]
        raced = RunFolder.open_complete(tmp_path / "out" / f"{kind}_0_race", "evaluate").settings()["vehicle"]
        masses[kind] = trained.get("file", trained.get("mass")), raced["mass"]
    assert RunFolder.open_complete(tmp_path / "out" / "new_0", "train").settings()["seed"] == 0
    assert {raced for _, raced in masses.values()} == {5.1} and masses["oracle"][0] == 5.1
    assert str(masses["old"][0]).endswith("model_before.yaml") or masses["old"][0] == 5.0
    with pytest.raises(RunError, match="already holds"):
        close(settings_of(diagnosed), tmp_path / "out", compose_settings)


@pytest.mark.slow
def test_the_old_policy_is_refined_in_the_new_model_where_the_budget_refines(diagnosed, tmp_path):
    settings = settings_of(diagnosed, train=["budget=smoke", refinement()])
    facts = close(settings, tmp_path / "out", compose_settings)
    assert list(facts["policies"]) == ["old", "refined", "new", "oracle"]
    refined = RunFolder.open_complete(tmp_path / "out" / "refined_0", "train")
    assert refined.settings()["vehicle"]["file"].endswith("gap/model.yaml")
    assert refined.settings()["algo"]["run"].endswith("old_0")
    assert refined.manifest["seconds"] == facts["policies"]["refined"]["trainings"][0]["training_s"]
    three = [facts["policies"][kind]["e_off"] for kind in ("old", "refined", "oracle")]
    assert facts["recovered_by_refining"]["e_off"] == recovered(*three)


def test_a_real_car_without_a_gradient_is_told_before_anything_is_trained(diagnosed, tmp_path):
    car = {**compose_settings("train", ["vehicle=published"])["vehicle"], "body": "commonroad_mb"}
    (tmp_path / "car.yaml").write_text(json.dumps(car))  # JSON is YAML
    settings = settings_of(diagnosed, train=["budget.steps=1024"], real=str(tmp_path / "car.yaml"))
    with pytest.raises(ConfigError, match="use budget=evolution"):
        close(settings, tmp_path / "out", compose_settings)
    assert not (tmp_path / "out").exists()


def test_logs_are_diagnosed_first(diagnosed, tmp_path, monkeypatch):
    asked = []

    def diagnose(settings, out, on_progress):
        asked.append(settings["logs"])
        shutil.copytree(diagnosed, out)

    monkeypatch.setattr("racerl.train.close.gap", diagnose)
    monkeypatch.setattr("racerl.train.close.load_given", lambda settings: [])
    settings = {**settings_of("drive.csv.gz"), "gap": ["vehicle=published"]}
    facts = close(settings, tmp_path / "out", compose_settings)
    assert asked == [["drive.csv.gz"]] and facts["effects"] == ["aero_drag"]
    assert (tmp_path / "out" / "gap" / "model.yaml").is_file()


def test_a_log_that_is_not_there_leaves_nothing_behind(tmp_path):
    with pytest.raises(LogError, match="no such file"):
        close(settings_of(tmp_path / "drive.csv"), tmp_path / "out", compose_settings)
    assert not (tmp_path / "out").exists()


def test_a_policy_gets_no_vehicle_of_its_own(diagnosed, tmp_path):
    with pytest.raises(ConfigError, match=r"train = vehicle.friction=0.5: each policy has a vehicle of its own"):
        close({**settings_of(diagnosed), "train": ["vehicle.friction=0.5"]}, tmp_path / "out", compose_settings)
    assert not (tmp_path / "out").exists()


def test_a_car_that_is_not_there_is_told_before_anything_is_trained(diagnosed, tmp_path):
    (tmp_path / "no_car.yaml").write_text("mass: 3\n")
    for real, said in (
        ("nowhere.yaml", "^real = nowhere.yaml: no such file"),
        (str(tmp_path / "no_car.yaml"), "^real = .*no_car.yaml: vehicle: section 'front' is missing"),
    ):
        with pytest.raises(RacerlError, match=said):
            close(settings_of(diagnosed, real=real), tmp_path / "out", compose_settings)
    assert not (tmp_path / "out").exists()


def test_without_an_effect_there_is_nothing_to_train_with(diagnosed, tmp_path):
    write_json(diagnosed / "verdict.json", {"verdict": "none", "effects": []})
    with pytest.raises(ConfigError, match="verdict is none"):
        close(settings_of(diagnosed), tmp_path / "out", compose_settings)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("change", "said"), [({"laps": 0}, "laps = 0"), ({"seeds": []}, "seeds = ")])
def test_races_that_cannot_be_are_told_before_anything_is_trained(diagnosed, tmp_path, change, said):
    with pytest.raises(ConfigError, match=said):
        close(settings_of(diagnosed, **change), tmp_path / "out", compose_settings)
    assert not (tmp_path / "out").exists()


def test_a_folder_may_have_any_name(tmp_path):
    odd = str(tmp_path / "a,b (Läufe)" / "old_0")
    assert compose_settings("evaluate", [f"run={odd}"])["run"] == odd
    assert compose_settings("evaluate", ["run=5"])["run"] == "5"


@pytest.mark.parametrize("trainings", [[], [0, 0], [-1], "0"])
def test_trainings_must_be_different_seeds(diagnosed, tmp_path, trainings):
    with pytest.raises(ConfigError, match="trainings"):
        close(settings_of(diagnosed, trainings=trainings), tmp_path / "out", compose_settings)
    assert not (tmp_path / "out").exists()


def test_measures_are_means_over_trainings_that_all_have_them():
    one = {"mean_lap_s": 6.0, "e_off": 0.2, "crash_share": 1.0}
    other = {"mean_lap_s": 5.0, "e_off": 0.0, "crash_share": 0.0}
    assert means([one, other]) == {"mean_lap_s": 5.5, "e_off": pytest.approx(0.1), "crash_share": 0.5}
    assert means([{**one, "mean_lap_s": None}, other])["mean_lap_s"] is None


def test_the_share_of_the_oracles_gain():
    assert recovered(6.0, 5.6, 5.5) == pytest.approx(0.8)
    assert recovered(6.0, None, 5.5) is None and recovered(5.5, 5.5, 5.6) is None


@pytest.mark.parametrize(
    ("old", "new", "oracle", "known"),
    [
        ([7.5, 7.4, 7.45], [7.2, 7.3, 7.25], [7.2, 7.25, 7.15], True),
        ([6.2, 6.4, 6.5], [6.1, 6.4, 6.3], [6.3, 6.2, 6.35], False),  # the oracle may as well be slower
        ([7.5], [7.3], [7.2], False),
        ([7.5, None], [7.3, 7.2], [7.2, 7.1], False),
    ],
)
def test_the_shares_interval_is_that_of_the_trainings(old, new, oracle, known):
    columns = {"old": old, "new": new, "oracle": oracle}
    found = interval([[{"mean_lap_s": seconds} for seconds in column] for column in columns.values()], "mean_lap_s")
    if not known:
        assert found is None
    else:
        low, high = found
        share = recovered(*(sum(column) / len(column) for column in columns.values()))
        assert (min(old) - max(new)) / (max(old) - min(oracle)) < low < share < high
        assert high < (max(old) - min(new)) / (min(old) - max(oracle))
