"""The benchmark of identification runs, agrees with itself and says where it ran."""

import pytest

from racerl.bench.bench import bench
from racerl.config import compose_settings
from racerl.documents import read_json
from racerl.errors import ConfigError, RunError
from racerl.report.figures import cost


@pytest.mark.slow
def test_identify(tmp_path):
    words = ["identify", "seconds=24", "shorter=[12]", "passes=2"]
    words = ["threads=1", *(f"benchmark{'.' if '=' in word else '='}{word}" for word in words)]
    settings = compose_settings("bench", words)
    facts = bench(settings, tmp_path / "out", compose_settings)
    assert facts == read_json(tmp_path / "out" / "bench.json")
    assert facts["gradient_disagreement"] < 1e-9  # the kernel's gradient is back-propagation's
    assert facts["gauss_newton"]["cost"] <= facts["adamw"]["cost"]
    expected = facts["torch_adamw"]["seconds"] / facts["gauss_newton"]["seconds"]
    assert facts["ratio_torch_adamw_to_gauss_newton"] == pytest.approx(expected)
    assert [round(row["log_seconds"]) for row in facts["growth"]] == [12, 24]
    assert facts["growth"][1]["command_seconds"] == facts["command"]["seconds"]
    assert cost.draw(facts) == cost.draw(facts)  # byte for byte
    assert facts["threads"] == 1 and {"cpu", "git_sha", "libraries"} <= set(facts)
    with pytest.raises(RunError, match="already holds"):
        bench(settings, tmp_path / "out", compose_settings)


@pytest.mark.slow
def test_sim(tmp_path):
    words = ["benchmark=sim", "benchmark.cars=[16,400]", "benchmark.seconds=0.05", "benchmark.repeats=1", "threads=1"]
    facts = bench(compose_settings("bench", words), tmp_path / "out", compose_settings)
    for name in ("env", "dynamics", "gradient", "torch_dynamics"):
        assert set(facts[f"{name}_steps_per_s_per_thread"]) == {"16", "400"}
    assert facts["dynamics_steps_per_s_per_thread"]["400"] > facts["env_steps_per_s_per_thread"]["400"]
    assert facts["kernel"] == "torch" or min(facts["ratio_dynamics_to_torch"].values()) > 2
    assert 0 < facts["kernel_build_seconds"] < 60
    assert cost.draw(facts).count("<use ") > 2 * 4  # a mark for each number of cars and each curve


def test_policy(tmp_path):
    words = ["benchmark=policy", "benchmark.budgets=[smoke]", "benchmark.calls=300", "threads=1"]
    facts = bench(compose_settings("bench", words), tmp_path / "out", compose_settings)["policy_call_us"]["smoke"]
    assert facts["layers"][1:] == [32, 32, 2] and facts["largest_difference"] < 1e-6
    for way in ("onboard", "torch", "sb3_predict"):
        assert 0 < facts[way]["median"] <= facts[way]["p99"]
    assert cost.draw(facts) is None
    assert facts["onboard"]["median"] < facts["torch"]["median"] < facts["sb3_predict"]["median"]


@pytest.mark.slow
def test_train(tmp_path):
    brief = ["budgets=[smoke]", "seconds=0.1", "seeds=[0]", "patience=1", "margin=100"]
    fast = ['fast=["budget=smoke"]', 'short=["budget=smoke"]']
    words = ["benchmark=train", *(f"benchmark.{word}" for word in (*brief, *fast))]
    facts = bench(compose_settings("bench", words), tmp_path / "out", compose_settings)
    throughput = facts["throughput"]["smoke"]
    assert throughput["ratio"] == pytest.approx(throughput["steps_per_s"] / throughput["stock_steps_per_s"])
    assert 100 < facts["peak_memory_mb"] < 4000
    lap = facts["time_to_lap"]
    assert lap["runs"][0]["valid_laps"] < 20 and lap["arrived"] == 0  # a smoke budget learns nothing
    assert lap["stock"][-1]["seconds"] >= 1 and not lap["stock_arrived"]
    assert lap["ratio_at_least"] == pytest.approx(lap["stock"][-1]["seconds"] / lap["median_seconds"])


def test_impossible_benchmarks_are_told(tmp_path):
    with pytest.raises(ConfigError, match="cars"):
        bench(compose_settings("bench", ["benchmark=sim", "benchmark.cars=[0]"]), tmp_path / "out", compose_settings)
