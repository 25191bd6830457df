"""The proof of a gap on windows made up by hand: what counts, up to which limit, and what is shown."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from racerl.gap import prove as prove_module
from racerl.gap.comparison import WILD
from racerl.gap.evidence import Evidence
from racerl.gap.locate import horizons, maps
from racerl.gap.prove import prove
from racerl.gap.stage import stages
from racerl.gap.verdict import Verdict, proved

WINDOWS, LENGTH = 60, 85


@pytest.fixture
def proof(monkeypatch):
    """Return what is proved of windows whose errors have these sizes, in units of the noise, before and after."""
    rows = np.arange(WINDOWS) * LENGTH
    columns = {"t": 0.01 * np.arange(WINDOWS * LENGTH + 1), "v_x": np.ones(WINDOWS * LENGTH + 1)}
    evidence = SimpleNamespace(
        columns=columns, first=np.zeros(WINDOWS * LENGTH + 1, dtype=int), start=rows, run=np.zeros(WINDOWS, dtype=int)
    )
    vars(evidence).update(length=LENGTH, observed=("v_x",), numbers=LENGTH + 1)

    def errors(sizes):
        return {"chassis": np.ones((LENGTH + 1, 1, 1)) * sizes}

    monkeypatch.setattr(prove_module, "held_out_errors", lambda investigation, found: errors(found))
    monkeypatch.setattr(prove_module, "maps", lambda *_: [])

    def of(before, after, configured=None):
        noise = {"chassis": np.ones(1)}
        investigation = SimpleNamespace(evidence={"chassis": evidence}, noise=noise, base=before, seed=0)
        investigation.noise_errors = errors(np.ones(WINDOWS))
        start = SimpleNamespace(errors=lambda: errors(before if configured is None else configured))
        monkeypatch.setattr(prove_module, "unfitted", lambda _: start)
        return prove(investigation, after)

    return of


def sizes(**places):
    """Return a size of one for every window but for some, by name `wN` of the first of them."""
    found = np.ones(WINDOWS)
    for name, (count, size) in places.items():
        found[int(name[1:]) :][:count] = size
    return found


def test_windows_in_which_the_missing_effect_acts_count(proof):
    told = proof(sizes(w20=(20, 9.0)), sizes(), configured=sizes(w0=(60, 50.0)))
    assert told["wild_windows"] == {"chassis": 0} and told["gap"]["explained"] == pytest.approx(1.0)
    assert 3.0 < told["gap"]["before"] < 9.0 and told["gap"]["unfitted"] == pytest.approx(50.0)
    assert told["gap"]["by_channel"]["v_x"]["before"] == pytest.approx(told["gap"]["before"])


def test_what_no_vehicle_foresees_is_left_out_and_one_window_does_not_decide(proof):
    told = proof(sizes(w0=(3, 90.0), w30=(1, 4000.0)), sizes(w0=(3, 95.0)))
    assert told["wild_windows"] == {"chassis": 3}
    assert told["gap"]["after"] == pytest.approx(1.0) and 1.0 < told["gap"]["before"] < 1.5


def test_windows_that_effects_spoil_speak_against_them(proof):
    told = proof(sizes(w0=(10, 2.0)), sizes(w30=(10, 40.0)))
    assert proved(Verdict("named", ("pose_latency",), (), (), ""), told["gap"]).kind == "unknown"


@pytest.mark.parametrize("blown", [np.nan, np.inf, 1e200])
def test_a_rollout_that_blows_up_counts_up_to_the_limit(proof, blown):
    told = proof(sizes(w0=(10, 3.0)), sizes(w3=(1, blown)), configured=sizes(w0=(60, blown)))
    json.dumps(told, allow_nan=False)
    assert told["gap"]["after"] ** 2 == pytest.approx((59 + WILD) / 60)
    assert told["gap"]["unfitted"] ** 2 == pytest.approx(WILD)
    assert told["stretch"]["windows"] and told["wild_windows"] == {"chassis": 0}


def test_maps_and_horizons_leave_out_rollouts_that_blew_up(clean):
    evidence = Evidence.of([clean], stages(clean.channels)[2], LENGTH, 0.5)
    errors = np.random.default_rng(0).standard_normal((LENGTH + 1, 3, len(evidence.start)))
    errors[5:, 1, 7] = np.inf
    errors[9, 2, 8] = np.nan
    car = SimpleNamespace(vehicle=SimpleNamespace(arm=0.1, l_r=0.1))
    known = SimpleNamespace(evidence={"chassis": evidence}, noise={"chassis": np.ones(3)}, base=car)
    told = maps(known, {"chassis": errors}), horizons(errors)
    json.dumps(told, allow_nan=False)
    assert len(told[0]) > 20 and np.mean([row["p"] for row in told[0]]) > 0.3
    assert told[1]["20"] == pytest.approx([1.0] * 3, abs=0.3)
    errors[-1] = np.nan  # in every window: there is nothing to tell
    assert (maps(known, {"chassis": errors}), horizons(errors)) == ([], {})
