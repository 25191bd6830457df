"""Damaged logs, made up by the thousand: a log comes out or a typed error in one line, within two seconds.

With `--hypothesis-profile=thorough` 2,750 cases: 900 damaged tables, 500 spoilt ones, 300 of arbitrary bytes, 950
damaged bags, 100 zips of them; a fifth of each without.
"""

import io
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from racerl.data.inspect import inspect
from racerl.data.load import load_logs
from racerl.data.log import CHANNELS, Log
from racerl.errors import RacerlError
from racerl.record.bag import encode_bag
from tests.conftest import CONF
from tests.damage import damaged
from tests.data.conftest import mapping, write_bag

SLOWEST = 2.0  # seconds of computing per case, whatever else the machine does
MAPPINGS = {path.stem: mapping(path.stem) for path in sorted((CONF / "data").glob("*.yaml"))}
TABLES = (".csv", ".csv.gz", ".parquet")


def fuzz(cases: int) -> settings:
    most = cases if settings.get_current_profile_name() == "thorough" else cases // 5
    return settings(max_examples=most, suppress_health_check=list(HealthCheck), derandomize=True, database=None)


@pytest.fixture(scope="module")
def files(small, tmp_path_factory) -> dict[str, bytes]:
    """Small valid files of every kind."""
    folder = tmp_path_factory.mktemp("valid")
    made = {}
    poses = small.drop(columns=["v_x", "v_y", "yaw_rate"])
    for suffix, table in ((".csv", small), (".csv.gz", poses)):
        table.round(4).to_csv(folder / f"a{suffix}", index=False)
        made[suffix] = (folder / f"a{suffix}").read_bytes()
    small.to_parquet(folder / "a.parquet")
    made[".parquet"] = (folder / "a.parquet").read_bytes()
    made[".db3"] = write_bag(folder / "sqlite", 14).read_bytes()
    made[".mcap"] = write_bag(folder / "mcap", 14, "mcap").read_bytes()
    made["stock"] = encode_bag(small.iloc[:14], 0.33)
    return made


# damage: (kind, where as a share of the file, which bit or how much)
DAMAGE = st.lists(
    st.tuples(
        st.sampled_from(["flip", "flip", "flip", "cut", "drop", "double", "zero", "insert"]),
        st.floats(0.0, 1.0),
        st.integers(0, 255),
    ),
    min_size=1,
    max_size=6,
)


def attempt(suffix: str, content: bytes, name: str) -> Log | None:
    """Load the bytes; whatever goes wrong must be a typed error of one line, and leave nothing behind."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"log{suffix}"
        path.write_bytes(content)
        began = time.process_time()
        try:
            log = load_logs([path], MAPPINGS[name])[0]
        except RacerlError as error:
            assert "\n" not in str(error) and len(str(error)) < 700
            log = None
        assert time.process_time() - began < SLOWEST
        assert [file.name for file in Path(folder).iterdir()] == [path.name] and path.read_bytes() == content
    if log is not None:
        assert_plausible(log)
    return log


def assert_plausible(log: Log) -> None:
    for name in log.channels:
        values = log.array(name)
        assert np.isfinite(values).all() and np.abs(values).max() <= CHANNELS[name].largest
    for run in log.runs():
        assert (np.diff(run["t"]) > 0).all()


@fuzz(900)
@given(st.sampled_from(TABLES), DAMAGE)
def test_damaged_tables(files, suffix, damage):
    attempt(suffix, damaged(files[suffix], damage), "drive_log")


@fuzz(300)
@given(st.sampled_from([*TABLES, ".db3", ".mcap", ".zip"]), st.binary(max_size=400), st.sampled_from(sorted(MAPPINGS)))
def test_arbitrary_bytes(suffix, content, name):
    assert attempt(suffix, content, name) is None or suffix in TABLES


def _spoil(table: pd.DataFrame, kind: str, column: str, number: float, dice: np.random.Generator) -> pd.DataFrame:
    rows = dice.permutation(len(table))
    if kind == "shuffle":
        return table.iloc[rows]
    if kind == "double":
        return pd.concat([table, table.iloc[rows[:10]]])
    if kind == "repeat":
        return table.iloc[np.arange(len(table)).repeat(2)]
    if kind == "drop":
        return table.drop(columns=column) if len(table.columns) > 1 else table
    if kind == "cut":
        return table.iloc[: int(abs(number))]
    if kind == "text":
        return table.assign(**{column: table[column].astype(object).where(rows > 2, "broken")})
    if kind == "scale":
        return table.assign(**{column: table[column] * number})
    spoilt = table[column].astype(float).where(rows > int(abs(number)) % 40, {"nan": np.nan, "value": number}[kind])
    return table.assign(**{column: spoilt})


KINDS = ["shuffle", "double", "repeat", "drop", "cut", "text", "scale", "nan", "value"]
COLUMNS = ["t", "run", *CHANNELS]
SPOILS = st.lists(
    st.tuples(
        st.sampled_from(KINDS), st.sampled_from(COLUMNS), st.floats(width=32, allow_nan=True) | st.integers(-40, 40)
    ),
    min_size=1,
    max_size=4,
)


@fuzz(500)
@given(st.sampled_from([".csv", ".parquet"]), SPOILS, st.integers(0, 1000), st.booleans())
def test_spoilt_tables(small, suffix, spoils, seed, posed):
    dice = np.random.default_rng(seed)
    table = small.drop(columns=["v_x", "v_y", "yaw_rate"]) if posed else small
    with np.errstate(all="ignore"):
        for kind, column, number in spoils:
            if column in table and table[column].dtype != object:
                number = float(number) if np.isfinite(number) else 1.0
                table = _spoil(table, kind, column, number, dice)
    stream = io.BytesIO()
    if suffix == ".csv":
        table.to_csv(stream, index=False)
    else:
        mixed = [column for column in table if table[column].dtype == object]
        table.assign(**{column: table[column].astype(str) for column in mixed}).to_parquet(stream)
    log = attempt(suffix, stream.getvalue(), "drive_log")
    if log is not None:
        inspect(log)


@fuzz(800)
@given(st.sampled_from([".db3", ".mcap"]), DAMAGE)
def test_damaged_bags(files, suffix, damage):
    attempt(suffix, damaged(files[suffix], damage), "ros2")


@fuzz(150)
@given(DAMAGE, st.sampled_from(["f1tenth", "drive_log"]))
def test_damaged_bags_of_the_stock_system(files, damage, name):
    attempt(".mcap", damaged(files["stock"], damage), name)


@fuzz(100)
@given(st.sampled_from([".db3", ".mcap"]), DAMAGE, DAMAGE, st.booleans())
def test_damaged_zips(files, suffix, inner, outer, both):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(f"bag/a{suffix}", damaged(files[suffix], inner) if both else files[suffix])
    attempt(".zip", damaged(stream.getvalue(), outer), "ros2")
