"""The identify stage on a simulated car whose parameters nobody told, and on real logs where they are at hand."""

import gzip
import io
import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from rich.console import Console

from racerl.cli import _following, _print_identification, main
from racerl.config import compose_settings
from racerl.errors import ConfigError, LogError, RacerlError
from racerl.identify.identify import identify
from racerl.record.record import record
from racerl.report.identification_page import draw_identification
from racerl.train.train import train
from racerl.vehicle.cars import read_cars
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.parameter import values
from tests.identify.conftest import FEW, settings_for

REAL = Path(__file__).resolve().parents[3] / "shared" / "data"


def truth_of(folder: Path) -> dict[str, float]:
    """The hidden values, with the friction factor, a convention, taken into the coefficients that it scales."""
    table = values(load_vehicle(yaml.safe_load((folder / "vehicle.yaml").read_text())))
    nominal = values(load_vehicle(compose_settings("train", ["vehicle=published"])["vehicle"]))["friction"]
    scaled = {n: v * table["friction"] / nominal for n, v in table.items() if n.endswith(("p_Dx1", "p_Dy1"))}
    return {**table, **scaled}


@pytest.fixture(scope="module")
def identified(hidden, tmp_path_factory):
    out = tmp_path_factory.mktemp("identified") / "run"
    return identify(settings_for(hidden / "log.parquet"), out), out


def test_the_hidden_car_is_found(identified, hidden):
    facts, _ = identified
    truth = truth_of(hidden)
    known = {name: p for name, p in facts["parameters"].items() if p["identified"]}
    assert {"steering.time_constant", "drive.time_constant", "yaw_inertia", "front.p_Ky1"} <= set(known)
    error = {name: abs(p["value"] / truth[name] - 1) for name, p in known.items()}
    assert max(error.values()) < 0.05 and np.median(list(error.values())) < 0.015, error
    assert max(error["steering.time_constant"], error["drive.time_constant"]) < 0.03
    # what three minutes cannot tell is said, and lies inside its interval more often than not
    loose = [name for name, p in facts["parameters"].items() if not p["identified"]]
    inside = [facts["parameters"][n]["ci95"][0] <= truth[n] <= facts["parameters"][n]["ci95"][1] for n in loose]
    assert loose and np.mean(inside) > 0.6


def test_a_programme_tells_what_moves_the_car(identified):
    facts, _ = identified
    held = {name for names in facts["open"]["untold"].values() for name in names}
    assert not held & {
        "yaw_inertia",
        "l_f",
        "steering.time_constant",
        "drive.time_constant",
        "front.p_Ky1",
        "rear.p_Ky1",
    }
    assert all(facts["parameters"][name]["value"] == facts["parameters"][name]["start"] for name in held)


def test_held_out_errors_shrink_to_the_noise(identified):
    facts, _ = identified
    for channel in ("v_x", "v_y", "yaw_rate"):
        held, before, still = (facts[k]["85"][channel] for k in ("rmse", "rmse_unfitted", "rmse_hold_last_state"))
        assert held < 0.9 * before < 0.9 * still
    assert facts["rmse"]["85"]["v_x"] < 0.02  # the noise of a differentiated pose is 0.012 m/s
    assert list(facts["rmse"]) == ["1", "5", "20", "50", "85"]


def test_the_page_and_the_model_can_be_used(identified, tmp_path):
    facts, out = identified
    page = draw_identification(out).read_text()
    assert "front.p_Ky1" in page and page.count("</figure>") == 3
    car = load_vehicle({"file": str(out / "model.yaml")})
    assert car.yaw_inertia == pytest.approx(facts["parameters"]["yaw_inertia"]["value"], rel=1e-5)
    words = [f"vehicle={out}/model.yaml", f"dr=posterior:{out}", "budget=smoke", "threads=1", "budget.steps=2000"]
    settings = compose_settings("train", words)
    cars = read_cars(out, car)
    for name, row in facts["parameters"].items():
        assert np.quantile(cars[name], [0.025, 0.975]) == pytest.approx(row["ci95"], rel=1e-4, abs=1e-6), name
    train(settings, tmp_path / "trained")
    assert (tmp_path / "trained" / "policy.safetensors").is_file()


def test_the_page_begins_with_the_verdict_and_folds_the_parameters(lacking):
    page = draw_identification(lacking.out).read_text()
    body = page[page.index("<body>") :]
    verdict = "because errors in runs held out grew: v_x × "
    order = [verdict, "racerl gap LOG", "factor [1]", "Measured and simulated", "Tyres", "<details>", "yaw_inertia"]
    places = [body.index(part) for part in order]
    assert places == sorted(places) and f"<title>usable: no, {verdict}" in page
    rows = {name: body[body.index(f"<td>{name} [") :].split("</tr>")[0] for name in ("v_x", "yaw_rate")}
    factors = {name: row["factor"] for name, row in lacking.facts["verdict"]["channels"].items()}
    assert f'worse">× {factors["v_x"]:.2f}<' in rows["v_x"] and "worse" not in rows["yaw_rate"]


@pytest.mark.slow
def test_the_same_seed_gives_the_same_files_on_one_thread_and_two(hidden, tmp_path):
    log = pd.read_parquet(hidden / "log.parquet")
    log[log["run"] < 2].to_parquet(tmp_path / "log.parquet")
    for threads in (1, 2):
        identify(settings_for(tmp_path / "log.parquet", FEW, f"threads={threads}"), tmp_path / str(threads))
    for name in ("model.yaml", "identification.json", "overlay.parquet", "tyres.parquet"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes(), name


def test_scoring_alone_changes_nothing(identified, hidden, tmp_path):
    facts, out = identified
    words = ["fit=false", f"vehicle={out}/model.yaml"]
    settings = compose_settings("identify", [f"logs=['{hidden}/log.parquet']", *words])
    scored = identify(settings, tmp_path / "scored")
    assert not (tmp_path / "scored" / "model.yaml").exists() and "parameters" not in scored
    assert scored["rmse"]["85"]["v_x"] == pytest.approx(facts["rmse"]["85"]["v_x"], rel=0.05)
    assert "given vehicle" in draw_identification(tmp_path / "scored").read_text()


@pytest.mark.parametrize(
    "missing",
    [
        pytest.param(("delta",), marks=pytest.mark.slow),
        pytest.param(("delta_ref", "omega_ref"), marks=pytest.mark.slow),
        pytest.param(("delta_ref", "omega"), marks=pytest.mark.slow),
        pytest.param(("x", "y", "yaw"), marks=pytest.mark.slow),
    ],
)
def test_missing_channels(hidden, tmp_path, missing):
    log = pd.read_parquet(hidden / "log.parquet").drop(columns=list(missing))
    log.to_parquet(tmp_path / "log.parquet")
    facts = identify(settings_for(tmp_path / "log.parquet", FEW, "folds=0"), tmp_path / "out")
    truth, stiffness = truth_of(hidden), facts["parameters"]["front.p_Ky1"]
    assert abs(stiffness["value"] / truth["front.p_Ky1"] - 1) < 0.05
    assert facts["inputs"]["steering"] == ("delta" if "delta_ref" in missing else "delta_ref")
    assert ("steering.time_constant" in facts["parameters"]) == ("delta_ref" not in missing)


def test_motion_alone_does_not_tell_the_mass(hidden, tmp_path):
    log = pd.read_parquet(hidden / "log.parquet")
    log[log["run"] < 4].to_parquet(tmp_path / "log.parquet")
    words = ["priors.mass=0.3", "+priors.friction=0.3", "folds=0", FEW]
    facts = identify(settings_for(tmp_path / "log.parquet", *words), tmp_path / "out")
    assert not facts["parameters"]["mass"]["identified"] and not facts["parameters"]["friction"]["identified"]
    assert "mass" in facts["parameters"]["yaw_inertia"]["not_separable_from"]


def test_a_single_run_is_held_out_in_stretches(hidden, tmp_path):
    log = pd.read_parquet(hidden / "log.parquet")
    log[log["run"] == 1].to_parquet(tmp_path / "log.parquet")
    facts = identify(settings_for(tmp_path / "log.parquet", FEW), tmp_path / "out")
    assert "stretches" in facts["held_out"] and facts["rmse"]["85"]["v_x"] is not None


def test_a_step_too_long_for_the_car_is_seen(hidden, tmp_path):
    log = pd.read_parquet(hidden / "log.parquet")
    log[log["run"] == 1].to_parquet(tmp_path / "log.parquet")
    words = [f"logs=['{tmp_path}/log.parquet']", "fit=false", "vehicle=published", "vehicle.rear.p_Ky1=60"]
    facts = identify(compose_settings("identify", words), tmp_path / "out")
    assert any("too stiff" in warning and "step=0.00" in warning for warning in facts["warnings"])
    facts = identify(compose_settings("identify", [*words, "step=0.0005"]), tmp_path / "fine")
    assert not any("too stiff" in warning for warning in facts["warnings"])


def straight(hidden: Path) -> pd.DataFrame:
    """A log in which the car stands still."""
    log = pd.read_parquet(hidden / "log.parquet").head(2000)
    for channel in ("v_x", "v_y", "yaw_rate", "omega", "omega_ref", "delta", "delta_ref"):
        log[channel] = 0.0
    return log


BAD = {
    "truncated": lambda log: log.to_csv(index=False)[:20].encode(),
    "shuffled": lambda log: log.sample(frac=1.0, random_state=0).to_csv(index=False).encode(),
    "no time": lambda log: log.drop(columns="t").to_csv(index=False).encode(),
    "NaN-ridden": lambda log: log.assign(v_x=log["v_x"].where(log.index % 3 == 0)).to_csv(index=False).encode(),
    "scaled": lambda log: log.assign(delta=np.degrees(log["delta"])).to_csv(index=False).encode(),
    "short": lambda log: log.head(60).to_csv(index=False).encode(),
    "empty": lambda log: b"",
    "binary": lambda log: gzip.compress(log.head(99).to_csv(index=False).encode())[:-30],
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_logs_are_one_line_and_nothing_is_written(hidden, tmp_path, kind):
    path = tmp_path / ("log.csv.gz" if kind == "binary" else "log.csv")
    path.write_bytes(BAD[kind](pd.read_parquet(hidden / "log.parquet").head(3000)))
    with pytest.raises(RacerlError) as error:
        identify(settings_for(path), tmp_path / "out")
    assert "\n" not in str(error.value) and "log.csv" in str(error.value)
    assert not (tmp_path / "out").exists()


def test_no_excitation(hidden, tmp_path):
    straight(hidden).to_parquet(tmp_path / "log.parquet")
    with pytest.raises(LogError, match="never stays above") as error:
        identify(settings_for(tmp_path / "log.parquet"), tmp_path / "out")
    assert "\n" not in str(error.value) and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "word, said",
    [
        ("window=0", "window = 0"),
        ("window=1000000", "window"),
        ("inputs=guess", "auto, commands, measured"),
        ("starts=0", "starts"),
        ("folds=1", "folds = 1"),
        ("step=0", "step = 0: allowed"),
        ("priors.mass=heavy", "priors.mass"),
        ("+priors.masss=0.1", "did you mean mass"),
        ("hold=[nothing]", "no parameter"),
        ("weights.yaw_rate=-1", "weights.yaw_rate"),
        ("fit=1", "true or false"),
        ("hold=null", "hold = None"),
        ("hold=[1]", "hold"),
        ("priors=null", "a choice of conf/priors"),
        ("weights=null", "a mapping"),
        ("+weights.yawrate=3", "did you mean yaw_rate"),
        ("method.iterations=1.5", "whole number"),
        ("method.tolerance=abc", "a number is expected"),
        ("vehicle.steering.time_constant=0.002", "delta is off .* give step=0.0045"),
        ("method.iterations=0", "iterations"),
    ],
)
def test_mistyped_settings(hidden, tmp_path, word, said):
    with pytest.raises(RacerlError, match=said) as error:
        identify(settings_for(hidden / "log.parquet", word), tmp_path / "out")
    assert "\n" not in str(error.value) and not (tmp_path / "out").exists()


def test_something_must_count(hidden, tmp_path):
    words = [f"weights.{name}=0" for name in ("v_x", "v_y", "yaw_rate")] + ["+weights.delta=0", "+weights.omega=0"]
    with pytest.raises(ConfigError, match="leave one"):
        identify(settings_for(hidden / "log.parquet", *words), tmp_path / "out")


def test_the_command_line(hidden, tmp_path, monkeypatch, capsys):
    shutil.copy(hidden / "log.parquet", tmp_path / "drive.parquet")
    monkeypatch.chdir(tmp_path)
    words = ["racerl", "identify", "drive.parquet", "fit=false", "out=scored"]
    monkeypatch.setattr("sys.argv", list(words))
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 0 and (tmp_path / "scored" / "report.html").is_file()
    told = capsys.readouterr().out
    assert "given vehicle" in told and told.splitlines()[-1] == "next: racerl train"
    monkeypatch.setattr("sys.argv", list(words))
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2 and "already holds" in capsys.readouterr().err


def test_the_terminal_tells_the_verdict_first_and_one_row_per_channel(lacking):
    stream = io.StringIO()
    _print_identification(Console(file=stream, width=100, force_terminal=True), lacking.facts)
    lines = stream.getvalue().splitlines()
    assert lines[0].startswith("usable: no, because errors in runs held out grew: v_x × ")
    rows = {name: [line for line in lines[1:] if f" {name} " in line] for name in ("v_x", "yaw_rate")}
    assert all(len(found) == 1 for found in rows.values())
    red = "\x1b[31m"
    assert f"{red}× {lacking.facts['verdict']['channels']['v_x']['factor']:.2f}" in rows["v_x"][0]
    assert red not in rows["yaw_rate"][0]


def test_the_next_command_has_the_users_words():
    words = [
        "my drives/a.csv",
        "b.csv",
        "data=dart",
        "data.velocities=poses",
        "vehicle=jetracer",
        "starts=1",
        "step=0.0025",
    ]
    words += ["+vehicle/effect=yaw_damping", "vehicle.effects.yaw_damping.coefficient=0.1", "out=somewhere"]
    model = Path("outputs/identify/my car/model.yaml")
    car = "vehicle=jetracer +vehicle/effect=yaw_damping vehicle.effects.yaw_damping.coefficient=0.1"
    logs = "'my drives/a.csv' b.csv data=dart data.velocities=poses"
    assert _following("racerl gap LOG", words, model) == f"racerl gap {logs} {car}"
    assert _following("racerl identify LOG", words, model).startswith(f"racerl identify {logs} vehicle=jetracer step=")
    assert _following("racerl train VEHICLE", words, model) == f"racerl train {car}"
    assert _following("racerl train vehicle=MODEL", words, model) == f"racerl train vehicle='{model}'"


@pytest.mark.skipif(not (REAL / "put").is_dir(), reason="the measured logs are not here (shared/data/put)")
def test_the_default_car_on_the_real_log(tmp_path):
    """The published parameters have 0.114, 0.187, 0.265 on the log's poses; the car was fitted to it."""
    words = [f"logs=['{REAL / 'put' / 'lab_drive.csv.gz'}']", "vehicle=f1tenth", "fit=false", "threads=1"]
    rmse = identify(compose_settings("identify", words), tmp_path / "out")["rmse"]["85"]
    assert rmse["v_x"] <= 0.100 and rmse["v_y"] <= 0.080 and rmse["yaw_rate"] <= 0.175


@pytest.mark.slow
@pytest.mark.skipif(not (REAL / "put").is_dir(), reason="the measured logs are not here (shared/data/put)")
def test_the_default_car_is_what_identify_finds(tmp_path):
    log = REAL / "put" / "lab_drive.csv.gz"
    identify(compose_settings("identify", [f"logs=['{log}']", "folds=0"]), tmp_path / "out")
    found = values(load_vehicle({"file": str(tmp_path / "out" / "model.yaml")}))
    default = values(load_vehicle(compose_settings("train", [])["vehicle"]))
    assert found == pytest.approx(default, rel=1e-3)


@pytest.mark.slow
def test_thirty_six_minutes_recover_a_car_within_three_percent(tmp_path):
    errors: dict[str, list[float]] = {}
    for seed in range(5):
        folder = tmp_path / f"car{seed}"
        record(
            compose_settings(
                "record", ["vehicle=published", "hidden.spread=0.2", f"hidden.seed={seed}", f"seed={seed}"]
            ),
            folder,
        )
        words = [f"logs=['{folder}/log.parquet']", "vehicle=published", "folds=0", "starts=2"]
        facts = identify(compose_settings("identify", words), tmp_path / f"found{seed}")
        truth = truth_of(folder)
        for name, p in facts["parameters"].items():
            if p["identified"]:
                errors.setdefault(name, []).append(abs(p["value"] / truth[name] - 1))
    median = {name: float(np.median(error)) for name, error in errors.items()}
    print(json.dumps(median, indent=1))
    assert len(median) > 20 and max(median.values()) < 0.03
    assert max(errors["steering.time_constant"] + errors["drive.time_constant"]) < 0.03
