"""Configurations: every file composes and builds, overrides do what they say, mistakes are one line."""

import pytest

from racerl import registry
from racerl.assemble import build_race
from racerl.choices import default_groups
from racerl.config import _rewrite, bare_words, compose_settings, make_env, run_command
from racerl.data.layout import read_layout
from racerl.errors import ConfigError, RacerlError, TrackError, VehicleError
from racerl.identify import methods
from racerl.record.drivers import create_driver
from racerl.train.algorithms import create_algorithm
from racerl.train.ppo import Budget
from racerl.vehicle import kernel
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.parameter import replace_values
from tests.conftest import CONF

GROUPS = ("vehicle", "track", "sim", "obs", "action", "dr", "algo", "budget")
CHOICES = [
    f"{group}={path.stem}"
    for group in (*GROUPS, "vehicle/effect")
    for path in sorted((CONF / group).glob("*.yaml"))
    if path.stem not in ("file", "posterior")
]
COMPANIONS = {"action=current": ["sim=motor_current"], "sim=motor_current": ["action=current"]}


def test_no_file_is_left_out():
    found = {path.relative_to(CONF).as_posix() for path in CONF.rglob("*.yaml")}
    listed = {f"{choice.replace('=', '/')}.yaml" for choice in CHOICES}
    rest = {
        "train.yaml",
        "evaluate.yaml",
        "refine.yaml",
        "record.yaml",
        "drive.yaml",
        "report.yaml",
        "compare.yaml",
        "show.yaml",
        "bench.yaml",
        "data.yaml",
        "identify.yaml",
        "gap.yaml",
        "close.yaml",
        "sweep.yaml",
        "optimum.yaml",
        "race.yaml",
        "rerun.yaml",
        "export.yaml",
        "tune.yaml",
        "track.yaml",
        # composed below, each with its command
        *(
            f"{group}/{path.name}"
            for group in ("benchmark", "controller", "drive", "engine", "method", "priors", "tracking")
            for path in (CONF / group).glob("*.yaml")
        ),
        "dr/posterior.yaml",  # tests/env draws from a run
        "track/file.yaml",
        "vehicle/file.yaml",
        *(f"car/{path.name}" for path in (CONF / "car").glob("*.yaml")),  # tests/evaluate drives each
        "hydra/racerl.yaml",
    }
    mappings = {path.relative_to(CONF).as_posix() for path in (CONF / "data").glob("*.yaml")}  # tests/data reads each
    assert found == listed | rest | mappings


@pytest.mark.parametrize("choice", CHOICES)
def test_every_choice_composes_and_drives(choice, monkeypatch):
    monkeypatch.setattr(kernel, "build", lambda code: None)  # tests/vehicle compiles; here torch drives one step
    word = f"+{choice}" if choice.startswith("vehicle/effect") else choice
    settings = compose_settings("train", [word, *COMPANIONS.get(choice, [])])
    Budget.of(settings["budget"])
    assert create_algorithm(settings["algo"])
    race = build_race(settings, cars=3, seeds=[0])
    import torch

    step = race.step(torch.zeros(3, 2))
    assert torch.isfinite(step.observation).all() and race.faults == 0


@pytest.mark.parametrize(
    "command, words",
    [
        ("train", []),
        ("evaluate", ["run=x"]),
        ("record", []),
        ("drive", []),
        ("report", []),
        ("compare", []),
        ("show", []),
        ("data", ["logs=[x]"]),
        ("identify", ["logs=[x]"]),
        ("optimum", []),
        ("track", []),
    ],
)
def test_every_command_composes(command, words):
    settings = compose_settings(command, words)
    assert settings["out"].startswith(f"outputs/{command}/")


@pytest.mark.parametrize("path", sorted((CONF / "method").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_method_composes_and_builds(path):
    settings = compose_settings("identify", ["logs=[x]", f"method={path.stem}"])
    assert registry.create(methods, settings["method"]).iterations > 0


@pytest.mark.parametrize("path", sorted((CONF / "tracking").glob("*.yaml")), ids=lambda path: path.stem)
@pytest.mark.parametrize("command, words", [("train", []), ("refine", ["from=x"])])
def test_every_tracker_composes(path, command, words):
    assert compose_settings(command, [*words, f"tracking={path.stem}"])["tracking"]["name"] == path.stem
    assert "tracking" not in compose_settings(command, words)


@pytest.mark.parametrize("name", [path.stem for path in sorted((CONF / "drive").glob("*.yaml"))])
def test_every_drive_composes_and_builds(name):
    settings = compose_settings("record", [f"drive={name}"])
    assert settings["drive"]["name"] == name and create_driver(settings["drive"])


@pytest.mark.parametrize("word", ["dr=friction_0.05", "+dr=friction_0.05", "++dr=friction_0.05"])
def test_plus_or_not(word):
    assert compose_settings("train", [word])["dr"]["sigma"] == 0.05


def test_groups_are_read_from_the_command():
    assert set(GROUPS) <= set(default_groups("train")) and "car" in default_groups("evaluate")


def test_files_stand_for_tracks_and_vehicles(tmp_path, monkeypatch):
    (tmp_path / "my track's.csv").write_text((CONF / "track" / "l_shape.csv").read_text())
    (tmp_path / "model.yaml").write_text(
        (CONF / "vehicle" / "f1tenth.yaml").read_text().replace("mass: 5.1", "mass: 4.4")
    )
    monkeypatch.chdir(tmp_path)
    settings = compose_settings("train", ["track=my track's.csv", f"vehicle={tmp_path}/model.yaml"])
    race = build_race(settings, cars=1, seeds=[0])
    assert race.vehicle.mass == 4.4 and race.track.name == "my track's"


def test_what_a_file_says_is_overridden_like_a_group(tmp_path, monkeypatch):
    (tmp_path / "model.yaml").write_text((CONF / "vehicle" / "f1tenth.yaml").read_text())
    monkeypatch.chdir(tmp_path)
    words = ["vehicle.friction=0.5", "vehicle=model.yaml", "+vehicle.front.p_Dy1=0.9"]  # in any order, + or not
    vehicle = load_vehicle(compose_settings("gap", ["logs=[a.csv]", *words])["vehicle"])
    usual = load_vehicle(compose_settings("gap", ["logs=[a.csv]", "vehicle=f1tenth"])["vehicle"])
    assert vehicle == replace_values(usual, {"friction": 0.5, "front.p_Dy1": 0.9}) != usual
    asked = ["vehicle=file", "vehicle.file=model.yaml", "vehicle.friction=0.5"]
    assert load_vehicle(compose_settings("train", asked)["vehicle"]).friction == 0.5
    wrong = compose_settings("train", ["vehicle=model.yaml", "vehicle.fricton=0.5"])["vehicle"]
    with pytest.raises(VehicleError, match="no parameter 'fricton'; did you mean friction"):
        load_vehicle(wrong)
    settings = compose_settings("train", ["track=l_shape.csv", "track.width=2"])
    with pytest.raises(TrackError, match=r"track\.width: a centreline has no settings"):
        build_race(settings, cars=1, seeds=[0])


def test_keys_that_a_mapping_leaves_out_are_overridden_all_the_same(tmp_path, monkeypatch):
    (tmp_path / "conf" / "data").mkdir(parents=True)
    (tmp_path / "conf" / "data" / "mine.yaml").write_text("channels: {x: /pose}\n")
    monkeypatch.chdir(tmp_path)
    words = ["data=mine", "data.shift.delta_ref=0.1", "data.gap=0.3", "+data.resample=50", "data.time.stamp=received"]
    layout = read_layout(compose_settings("identify", ["logs=[a.csv]", *words])["data"])
    assert (layout.shift, layout.gap, layout.resample) == ({"delta_ref": 0.1}, 0.3, 50.0)
    assert layout.time.stamp == "received" and "x" in layout.channels
    with pytest.raises(ConfigError, match="data has no key 'gapp'; did you mean gap"):
        read_layout(compose_settings("identify", ["logs=[a.csv]", "data.gapp=0.3"])["data"])


def test_a_conf_folder_here_shadows_the_packaged_one(tmp_path, monkeypatch):
    (tmp_path / "conf" / "dr").mkdir(parents=True)
    (tmp_path / "conf" / "dr" / "mine.yaml").write_text("sigma: 0.33\nparameters: [mass]\n")
    (tmp_path / "conf" / "dr" / "none.yaml").write_text("sigma: 0.01\nparameters: [mass]\n")
    monkeypatch.chdir(tmp_path)
    assert compose_settings("train", ["dr=mine"])["dr"]["sigma"] == 0.33
    assert compose_settings("train", [])["dr"]["sigma"] == 0.01


@pytest.mark.parametrize(
    "text, said",
    [
        ("# @package hydra.callbacks\nx:\n  _target_: builtins.open\n  file: exploded\n  mode: w\n", "_target_"),
        ("sigma: 0.1\nparameters: [{_target_: os.system}]\n", "_target_"),
        ("a: &a [1]\nb: *a\n", "aliases"),
        ("sigma: !!python/object/apply:os.system [ls]\n", "not valid YAML"),
    ],
)
def test_a_handed_configuration_cannot_run_code(tmp_path, monkeypatch, text, said):
    (tmp_path / "conf" / "dr").mkdir(parents=True)
    (tmp_path / "conf" / "dr" / "mine.yaml").write_text(text)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RacerlError, match=said):
        compose_settings("train", ["dr=mine"])
    with pytest.raises(RacerlError, match=said):
        run_command("train", ["dr=none", "--config-dir", str(tmp_path / "conf")], print)
    assert not (tmp_path / "exploded").exists()


@pytest.mark.parametrize(
    "words, said",
    [
        (["dr=frction_0.02"], "friction_0.02"),
        (["dr=posterior:"], "a run of racerl identify"),
        (["dr=posterior:nowhere"], "dr=posterior:nowhere: cars.parquet is not there"),
        (["dr=posterior"], "write racerl train dr=posterior:RUN"),
        (["drr=none"], "did you mean dr"),
        (["budget.stpes=3"], "budget.steps"),
        (["tarck=l_shape"], "track"),
        (["budget.refinement.pairs=2"], "budget=evolution, budget=workstation have it"),
        (["dr.parameters.x=0.3"], "is a list; give the list as a whole"),
        (["+dr.parameters.x=0.3"], "unknown key 'dr.parameters.x': dr.parameters has no keys; give it as a whole"),
        (["vehicle={}"], "vehicle={}: a choice of conf/vehicle is expected"),
        ([f"track={CONF.parent / 'tests' / 'env'}"], "is a folder; a file ends with .csv or .yaml or .yml"),
        ([f"vehicle={CONF / 'vehicle'}"], f"give a file in it, as vehicle={CONF / 'vehicle'}"),
        (["+seed=3"], "+seed: is there already; write seed=… without the +"),
        (["+colour=red"], "unknown key 'colour'"),
        (["sim.actuators=no"], "sim.actuators = no: true or false is expected"),
        (["action.steering_max=much"], "action.steering_max = much: a number is expected"),
        (["~seed"], "seed"),
        (["vehicle.front.p_Dx=1"], "p_Dx1"),
        (["seed"], "key=value"),
        (["seed=[1,"], "cannot read"),
        (["vehicle.mass=${nowhere}"], "nowhere"),
        (["track.file=???"], "track.file is missing"),
        (["+vehicle/effect=aero_drug"], "aero_drag"),
        (["vehicle/effect=aero_drag"], "an effect is added by +vehicle/effect=NAME"),
        (["vehicle.effects.aero_drag.area=0.1"], "an effect is added by +vehicle/effect=aero_drag"),
        (["vehicle.friction=0,5"], "a decimal has a point, 0.5"),
        (["vehicle.effects.aero_drug.area=0.1"], "unknown effect 'aero_drug'; did you mean aero_drag"),
        (
            ["+vehicle/effect=aero_drag", "vehicle.effects.aero_drag.coef=0.2"],
            "aero_drag has no 'coef'; choose from: coefficient",
        ),
        (["+vehicle/effect=[aero_drag,back_enf]"], "unknown vehicle/effect 'back_enf'; did you mean back_emf"),
        (["track=spa"], "technical; racerl track add gives one of your own a name"),
        (["budget.actor=64,64"], "a list is budget.actor=[64,64]"),
        (["dr.parameters=mass,friction"], "a list is dr.parameters=[mass,friction]"),
        (["tracking=wandb"], "unknown tracking 'wandb'; choose from: trackio"),
        (["--mutlirun"], "--multirun"),
        (["seed=.nan"], "seed"),
    ],
)
def test_mistakes_are_one_line_with_the_near_choices(words, said):
    with pytest.raises(RacerlError) as error:
        settings = compose_settings("train", words)
        if settings["seed"] != 0:
            raise ConfigError(f"seed = {settings['seed']}")
    assert said in str(error.value) and "\n" not in str(error.value)


def test_a_folder_is_no_file_and_a_file_no_folder_of_logs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("seed=3", "drive.csv"):
        (tmp_path / name).touch()
    (tmp_path / "car.yaml").mkdir()
    seen = []
    run_command("gap", ["drive.csv", "seed=3"], lambda settings, out: seen.append(settings["seed"]), "logs")
    assert seen == [3]
    with pytest.raises(ConfigError, match=r"car\.yaml: is a folder"):
        run_command("gap", ["drive.csv", "vehicle=car.yaml"], print, "logs")


def test_a_second_word_that_is_misspelt_is_no_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for command, words, positional, meant in (
        ("gap", ["clsoe", "log.csv"], "logs", "gap close"),
        ("report", ["comprae", "a", "b"], "runs", "report compare"),
    ):
        with pytest.raises(ConfigError, match=f"{words[0]}: no such file.*did you mean racerl {meant}"):
            run_command(command, words, print, positional)


def test_a_word_may_be_longer_than_a_file_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive.csv").touch()
    names = ",".join(["aero_drag", "back_emf", "yaw_damping"] * 30)
    seen = []
    run_command("gap", ["drive.csv", f"without=[{names}]"], lambda settings, out: seen.append(settings), "logs")
    assert seen[0]["without"] == names.split(",")


def test_environments_take_overrides():
    assert make_env(["obs=progress"]).observation_space.shape == (11,)
    with pytest.raises(ConfigError, match="an environment has one track"):
        make_env(["track=[l_shape,oval]"])


def test_settings_of_further_tracks_keep_their_kinds(tmp_path, monkeypatch):
    (tmp_path / "conf" / "track").mkdir(parents=True)
    (tmp_path / "conf" / "track" / "mine.yaml").write_text("file: a.yaml\norigin: [-1.0, 2.5, 0]\nnegate: true\n")
    monkeypatch.chdir(tmp_path)
    (other,) = compose_settings("train", ["track=[l_shape,mine]"])["track"]["others"]
    assert other == {"file": "a.yaml", "origin": [-1.0, 2.5, 0], "negate": True}


def test_several_runs_are_several_under_multirun(tmp_path, monkeypatch):
    assert _rewrite("evaluate", ["-m", "run=a,b"], None) == ["-m", "run=a,b"]
    assert _rewrite("evaluate", ["run=a,b"], None) == ["run='a,b'"]


def test_the_value_of_an_option_is_no_bare_word():
    assert [*bare_words(["--cfg", "job", "ablations", "seed=1", "-m", "~dr"])] == ["ablations"]


@pytest.mark.parametrize("name", ["a b", "it's", "a\\b", "a\\", "${x}", "Läufe, alle", "mu=0.5.csv"])
def test_a_name_of_any_letters_is_read_back_as_it_is(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).touch()
    assert compose_settings("data", [], {"logs": [name]})["logs"] == [name]
    assert _rewrite("data", [name], "logs")[0].startswith("logs=[")
