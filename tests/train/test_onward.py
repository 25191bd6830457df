"""`racerl train from=RUN`: a policy goes on in another world."""

import pytest
import torch

from racerl.config import compose_settings
from racerl.control.policy import UNREFINED, load_policy, save_policy
from racerl.documents import read_json
from racerl.errors import ConfigError, PolicyError, RunError
from racerl.evaluate.evaluate import evaluate, label
from racerl.run import RunFolder
from racerl.train.onward import train_onward
from racerl.train.train import train
from tests.train.short import ascent, refinement

EVOLUTION = refinement()


@pytest.fixture(scope="module")
def origin(tmp_path_factory):
    """Return a finished training whose observation, action and randomization are not the usual ones."""
    out = tmp_path_factory.mktemp("origin") / "run"
    words = ["budget=smoke", "threads=1", "budget.steps=1024", "obs=progress", "action=speed", "+dr=friction_0.02"]
    train(compose_settings("train", words), out)
    return out


def onward(run, *words, ending=EVOLUTION):
    return compose_settings("refine", [f"from={run}", "budget=smoke", ending, "threads=1", *words])


@pytest.mark.parametrize(("ending", "steps"), [(EVOLUTION, {"refined": 2}), (ascent(), {"ascended": 4})])
def test_the_policy_goes_on_in_the_changed_car_with_the_rest_as_it_was(ending, steps, origin, tmp_path):
    facts = train_onward(onward(origin, "vehicle=published", "seed=3", ending=ending), tmp_path / "on")
    run = RunFolder.open_complete(tmp_path / "on", "train")
    assert run.manifest["made_of"].startswith("PPO, refined on")
    settings, before = run.settings(), RunFolder.open_complete(origin).settings()
    assert settings["vehicle"] == compose_settings("train", ["vehicle=published"])["vehicle"] != before["vehicle"]
    assert [settings[key]["name"] for key in ("obs", "action")] == ["progress", "speed"] and settings["seed"] == 3
    assert settings["dr"] == before["dr"] and settings["sim"] == before["sim"] and settings["track"] == before["track"]
    came, left = load_policy(tmp_path / "on" / UNREFINED), load_policy(origin)
    assert torch.equal(came.network[0].weight, left.network[0].weight)
    assert steps.items() <= facts.items()
    assert facts["before"] == read_json(tmp_path / "on" / UNREFINED / "policy.json")["evaluation"]
    evaluate(compose_settings("evaluate", [f"run={tmp_path / 'on'}", "laps=1", "seeds=[0]"]), tmp_path / "raced")


def test_what_a_policy_is_made_of_is_told(origin, tmp_path):
    train_onward(onward(origin), tmp_path / "on")
    once = RunFolder.open_complete(tmp_path / "on").settings()
    assert label(once) == "progress, speed, friction σ = 0.02, PPO, refined on by evolution"
    train_onward(onward(tmp_path / "on"), tmp_path / "further")
    assert label(RunFolder.open_complete(tmp_path / "further").settings()) == label(once)


def test_nothing_is_written_where_a_policy_cannot_go_on(origin, tmp_path):
    out = tmp_path / "on"
    with pytest.raises(ConfigError, match="choose a budget with a refinement"):
        train_onward(compose_settings("refine", [f"from={origin}", "budget=smoke"]), out)
    with pytest.raises(RunError, match="no racerl run folder"):
        train_onward(onward(tmp_path / "nowhere"), out)
    with pytest.raises(ConfigError, match="from = ''"):
        train_onward({**onward(origin), "from": ""}, out)
    with pytest.raises(ConfigError, match="vehicle is the run's; give vehicle=NAME or FILE"):
        onward(origin, "vehicle.friction=0.5")
    assert not out.exists()


def test_a_policy_of_other_observations_is_refused(origin, tmp_path):
    strange = tmp_path / "strange"
    strange.mkdir()
    for name in ("manifest.json", "config.yaml"):
        (strange / name).write_bytes((origin / name).read_bytes())
    policy = load_policy(origin)
    policy.observation["name"] = "geometric"
    save_policy(policy, strange)
    with pytest.raises((PolicyError, ConfigError)):
        train_onward(onward(strange), tmp_path / "on")
    assert not (tmp_path / "on").exists()
