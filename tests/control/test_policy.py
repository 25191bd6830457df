"""Policies as files: what is saved comes back, what is damaged or hostile is refused."""

import json
import pickle

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from racerl.control.networks import build_network
from racerl.control.policy import FACTS, WEIGHTS, Policy, load_policy, save_policy
from racerl.errors import PolicyError


@pytest.fixture
def folder(tmp_path):
    torch.manual_seed(0)
    save_policy(Policy(build_network([6, 8, 2]), {"name": "geometric"}, {"name": "speed_rate"}), tmp_path)
    return tmp_path


def test_a_policy_comes_back_as_it_was(folder):
    torch.manual_seed(0)
    network = build_network([6, 8, 2])
    policy = load_policy(folder)
    x = torch.randn(5, 6)
    assert torch.equal(policy(x), network(x).clamp(-1, 1)) and policy.sizes == [6, 8, 2]
    assert policy.observation == {"name": "geometric"}


def test_actions_are_bounded(folder):
    assert load_policy(folder)(1e6 * torch.randn(100, 6)).abs().max() == 1.0


def edit(folder, **changes):
    facts = json.loads((folder / FACTS).read_text())
    (folder / FACTS).write_text(json.dumps({**facts, **changes}))


@pytest.mark.parametrize(
    "change, said",
    [
        ({"format": 99}, "format 99"),
        ({"layers": [6, 9, 2]}, "does not fit"),
        ({"layers": "many"}, "layers"),
        ({"layers": [6, -8, 2]}, "layers"),
        ({"layers": [6, 10**9, 2]}, "layers"),
        ({"layers": [6, *[65536] * 14, 2]}, "does not fit"),
        ({"layers": [6, 65536, 2], "recurrent": True}, "does not fit"),
        ({"observation": 3}, "observation"),
        ({"layers": [6]}, "layers"),
        ({"layers": [6.5, 2]}, "layers"),
    ],
)
def test_wrong_facts_are_refused(folder, change, said):
    edit(folder, **change)
    with pytest.raises(PolicyError, match=said) as error:
        load_policy(folder)
    assert "\n" not in str(error.value)


def test_missing_and_damaged_files_are_refused(folder):
    whole = (folder / WEIGHTS).read_bytes()
    for content in (whole[:50], b"", whole[:-4], b"\xff" * 100):
        (folder / WEIGHTS).write_bytes(content)
        with pytest.raises(PolicyError):
            load_policy(folder)
    (folder / WEIGHTS).unlink()
    with pytest.raises(PolicyError, match="cannot be read"):
        load_policy(folder)
    (folder / FACTS).unlink()
    with pytest.raises(PolicyError):
        load_policy(folder)


def test_nan_weights_are_refused(folder):
    network = build_network([6, 8, 2])
    network[0].weight.data[0, 0] = torch.nan
    save_policy(Policy(network, {"name": "geometric"}, {"name": "speed_rate"}), folder)
    with pytest.raises(PolicyError, match="NaN"):
        load_policy(folder)


def test_a_pickle_is_not_run(folder):
    class Bomb:
        def __reduce__(self):
            return (open, (str(folder / "exploded"), "w"))

    (folder / WEIGHTS).write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(PolicyError):
        load_policy(folder)
    assert not (folder / "exploded").exists()


@settings(max_examples=200)
@given(st.binary(max_size=300))
def test_random_weights_only_raise_policy_errors(tmp_path_factory, content):
    folder = tmp_path_factory.mktemp("fuzz")
    save_policy(Policy(build_network([3, 2]), {"name": "progress"}, {"name": "speed"}), folder)
    (folder / WEIGHTS).write_bytes(content)
    with pytest.raises(PolicyError):
        load_policy(folder)
