"""The MPC's benchmark: milliseconds with and without a compiler, and plans that agree with ipopt's."""

import json

import pytest

from racerl.bench.bench import bench
from racerl.config import compose_settings


@pytest.mark.slow
def test_steps_are_timed_and_plans_agree_with_ipopt(tmp_path):
    words = ["benchmark=mpc", "benchmark.steps=60", "benchmark.states=2"]
    facts = bench(compose_settings("bench", words), tmp_path / "b", compose_settings)
    assert json.loads((tmp_path / "b" / "bench.json").read_text())["median_ms"] == facts["median_ms"]
    for kind in (facts, facts["without_compiler"]):
        assert 0.0 < kind["median_ms"] <= kind["p99_ms"] <= kind["max_ms"] and kind["fallbacks"] == 0
    above = facts["above_ipopt"]
    assert above["states"] == 2 and above["not_compared"] == 0
    assert abs(above["iterated"]["max"]) < 0.01 and abs(above["iterated"]["min"]) < 0.01
