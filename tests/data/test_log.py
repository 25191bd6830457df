"""The log: runs, rate and the plausibility of what it holds."""

import numpy as np
import pandas as pd
import pytest

from racerl.data.log import Log, sample_time
from racerl.errors import LogError


def test_a_clean_log_comes_back_as_it_is(driven):
    log = Log.from_table("drive", driven)
    assert log.dt == 0.01 and log.seconds == pytest.approx(60.0) and len(list(log.runs())) == 3
    np.testing.assert_array_equal(log.array("v_x"), driven["v_x"])


def test_runs_are_made_from_gaps_when_there_is_no_run_column(driven):
    assert len(list(Log.from_table("drive", driven.drop(columns="run")).runs())) == 3


def test_a_missing_value_splits_its_run(driven):
    table = driven.copy()
    table.loc[500, "v_y"] = np.nan
    log = Log.from_table("drive", table)
    assert len(log.table) == len(driven) - 1 and len(list(log.runs())) == 4 and "missing value" in log.remarks[0]


@pytest.mark.parametrize(
    "spoil, said",
    [
        (lambda t: t.drop(columns="t"), "no column 't'"),
        (lambda t: t[["t", "run"]], "none of the channels"),
        (lambda t: t.assign(t=t["t"] * 1000), "another unit"),
        (lambda t: t.sample(frac=1.0, random_state=0), "mixed up|does not increase"),
        (lambda t: t.assign(delta=np.degrees(t["delta"])), "another one"),
        (lambda t: t.assign(v_x="fast"), "not numeric"),
        (lambda t: t.assign(v_x=np.nan), "miss a value"),
        (lambda t: t.iloc[:1], "at least two"),
    ],
)
def test_bad_tables_are_one_line(driven, spoil, said):
    with pytest.raises(LogError, match=said) as error:
        Log.from_table("drive", spoil(driven))
    assert "\n" not in str(error.value)


def test_where_time_goes_back_is_told():
    t = np.concatenate([0.01 * np.arange(50), 0.01 * np.arange(30, 80)])
    with pytest.raises(LogError, match=r"at 1 of 99 rows, first from 0.49 to 0.3 s in row 50; .*a column run"):
        sample_time("a", pd.DataFrame({"t": t, "run": 0}))
    assert sample_time("a", pd.DataFrame({"t": t, "run": np.repeat([0, 1], 50)})) == 0.01
