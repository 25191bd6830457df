"""An exported policy drives as the policy does: by its numbers in a race, in ONNX, in C."""

import json
import shutil
import sys

import numpy as np
import onnx
import pytest
import torch

from racerl.config import compose_settings
from racerl.control.networks import RecurrentNetwork, build_network
from racerl.control.policy import Policy, RecurrentPolicy, load_policy, save_policy
from racerl.deploy import export as stage
from racerl.deploy.c_header import c_header
from racerl.deploy.driver import Driver
from racerl.deploy.export import CARD, HEADER, ONNX, _by_compiler, _by_onnxruntime, export
from racerl.deploy.onnx_file import onnx_bytes
from racerl.errors import ConfigError, RunError
from racerl.vehicle.compiler import find_compiler
from tests.env.test_race import make

WORDS = [[], ["action=speed"], ["obs=progress"], ["obs=history"], ["action=current", "sim=motor_current"]]
RECURRENT = "recurrent"


def driver_of(*words):
    """Return a race and a policy of random weights for it, large enough that its references differ."""
    race = make(*(word for word in words if word != RECURRENT), cars=16)
    torch.manual_seed(1)
    if RECURRENT in words:
        remembers = RecurrentNetwork(race.observation.size, 12, 2).requires_grad_(False)
        for weight in remembers.parameters():
            torch.nn.init.normal_(weight, std=0.5)
        policy = RecurrentPolicy(remembers, {}, {})
        return race, policy, Driver.of(policy, race.observation, race.action, race.timing.dt)
    network = build_network([race.observation.size, 24, 24, 2])
    for layer, size in zip(network[::2], (2.0, 2.0, 0.5), strict=True):
        torch.nn.init.normal_(layer.weight, std=size / layer.in_features**0.5)
    policy = Policy(network.requires_grad_(False), {}, {})
    return race, policy, Driver.of(policy, race.observation, race.action, race.timing.dt)


@pytest.mark.parametrize("words", [*WORDS, [RECURRENT], [RECURRENT, "action=speed"]])
def test_what_is_driven_in_a_race_is_what_the_files_say(words):
    race, policy, driver = driver_of(*words)
    content, header = onnx_bytes(driver, {}), c_header(driver, "a test")
    scale = torch.tensor([each.maximum for each in driver.sees])
    reached, memories = [], [np.zeros((16, driver.units), np.float32)] * 3
    for _ in range(40):
        seen, last = (race.observe() * scale).numpy(), race.command[1].numpy().copy()
        step = race.step(policy.act(race))
        found = [driver(seen, last, memories[0]), _by_onnxruntime(content, seen, last, memories[1])]
        found += [_by_compiler(header, seen, last, memories[2])] if find_compiler() else []
        memories = [memory * (race.age > 0).numpy()[:, None] for _, _, memory in found]
        for steering, drive, _ in found:
            assert np.allclose(steering, step.command[0], atol=1e-5) and np.allclose(drive, step.command[1], atol=2e-5)
        reached.append(step.command.numpy())
    commands = np.concatenate(reached, axis=1)
    assert np.ptp(commands[0]) > 0.2 * driver.steering_max and np.ptp(commands[1]) > 0.2 * driver.drive_max


@pytest.mark.parametrize("words", WORDS)
def test_every_number_seen_is_what_its_name_says(words):
    race, _, driver = driver_of(*words)
    for _ in range(5):
        race.step(torch.rand(16, 2) - 0.3)
    seen = race.observe() * torch.tensor([each.maximum for each in driver.sees])
    value = {each.name: seen[:, i] for i, each in enumerate(driver.sees)}
    own = dict(zip(race.vehicle.states, race.state, strict=True))
    for name in ("v_x", "v_y", "yaw_rate", "delta", "omega"):
        assert torch.allclose(value[name], own[name], atol=1e-5), name
    assert torch.allclose(value["delta_ref"], race.command[0]) and torch.allclose(value["drive_ref"], race.command[1])
    most = driver.limit * race.action.rate_max
    assert torch.allclose(value["drive_ref_rate"], race.command_rate.clamp(-most, most), atol=1e-4)
    s, n = race.place[0], race.place[1]
    assert torch.allclose(value["n"], n, atol=1e-6)
    if "s" in value:
        assert torch.allclose(value["s"], s, atol=1e-4)
    else:
        track, spacing = race.track, race.observation.spacing
        places = track.spacing * np.arange(len(track.curvature))
        bend = np.interp(s + 3 * spacing, places, track.curvature, period=track.length)
        assert np.allclose(value["curvature_3"], bend, atol=0.05)
        assert torch.allclose(value["half_width_3"], torch.tensor(0.5), atol=1e-3)


def test_the_files_of_a_training_and_their_card(smoke_run, tmp_path):
    card = export(compose_settings("export", [f"run='{smoke_run}'"]), tmp_path / "out")
    assert json.loads((tmp_path / "out" / CARD).read_text()) == card
    model = onnx.load(tmp_path / "out" / ONNX)
    inside = json.loads(next(each.value for each in model.metadata_props if each.key == "racerl"))
    assert inside == {key: value for key, value in card.items() if key != "parity"}
    assert card["rate_hz"] == 20.0 and card["sees"][0] == {"name": "v_x", "unit": "m/s", "maximum": 6.0}
    assert card["does"]["drive_ref"] == {
        "unit": "m/s",
        "low": 0.01,
        "high": 7.0,
        "added_to_the_last": True,
        "most_per_step": 0.25,
    }
    assert card["track"]["name"] == "l_shape" and card["vehicle"]["mass"] == 5.1 and card["trained"]["steps"] == 2048
    assert 0.0 <= card["parity"]["onnxruntime"] <= 1e-5 and card["parity"]["observations"] == 10_000
    again = export(compose_settings("export", [f"run='{smoke_run}'"]), tmp_path / "again")
    assert again == card
    for name in (ONNX, HEADER, CARD):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def test_a_policy_that_remembers_is_exported_with_its_memory(smoke_run, tmp_path):
    _, policy, _ = driver_of(RECURRENT)
    run = shutil.copytree(smoke_run, tmp_path / "run")
    before = load_policy(smoke_run)
    policy.observation, policy.action = before.observation, before.action
    save_policy(policy, run)
    card = export(compose_settings("export", [f"run='{run}'"]), tmp_path / "out")
    assert card["memory"] == {"units": 12, "begins": 0.0} and 0.0 < card["parity"]["onnxruntime"] <= 1e-5
    graph = onnx.load(tmp_path / "out" / ONNX).graph
    assert [each.name for each in graph.input] == ["observation", "last_drive_ref", "memory"]
    assert [each.name for each in graph.output] == ["delta_ref", "drive_ref", "next_memory"]
    assert "float memory[RACERL_MEMORY]" in (tmp_path / "out" / HEADER).read_text()


def test_a_file_that_drives_otherwise_is_not_written(smoke_run, tmp_path, monkeypatch):
    def other(driver, title):
        return c_header(Driver(**{**vars(driver), "gain": 1.1 * driver.gain}), title)

    if not find_compiler():
        pytest.skip("no C compiler on this machine")
    monkeypatch.setattr(stage, "c_header", other)
    with pytest.raises(RunError, match="c: the exported policy differs by"):
        export(compose_settings("export", [f"run='{smoke_run}'"]), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_without_the_libraries_it_says_what_to_install(smoke_run, tmp_path, monkeypatch):
    for library in ("onnx", "onnxruntime"):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, library, None)
            patch.delitem(sys.modules, "racerl.deploy.onnx_file", raising=False)
            with pytest.raises(ConfigError, match=r"pip install -e '\.\[export\]'"):
                export(compose_settings("export", [f"run='{smoke_run}'"]), tmp_path / library)


def test_a_name_cannot_end_the_headers_comment():
    _, _, driver = driver_of()
    text = c_header(driver, "a */ int evil; /*\n#define b")
    assert text.splitlines()[0] == "/* a * / int evil; /* #define b"
