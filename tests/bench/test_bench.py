"""The benchmark of identification runs, agrees with itself and says where it ran."""

import pytest

from racerl.bench.bench import bench
from racerl.config import compose_settings
from racerl.documents import read_json
from racerl.errors import RunError


def test_identify(tmp_path):
    words = ["benchmark=identify", "benchmark.seconds=40", "benchmark.passes=3", "threads=1"]
    settings = compose_settings("bench", words)
    facts = bench(settings, tmp_path / "out", compose_settings)
    assert facts == read_json(tmp_path / "out" / "bench.json")
    assert facts["gradient_disagreement"] < 1e-9  # the kernel's gradient is back-propagation's
    assert facts["gauss_newton"]["cost"] <= facts["adamw"]["cost"]
    expected = facts["torch_adamw"]["seconds"] / facts["gauss_newton"]["seconds"]
    assert facts["ratio_torch_adamw_to_gauss_newton"] == pytest.approx(expected)
    assert facts["threads"] == 1 and {"cpu", "git_sha", "libraries"} <= set(facts)
    with pytest.raises(RunError, match="already holds"):
        bench(settings, tmp_path / "out", compose_settings)
