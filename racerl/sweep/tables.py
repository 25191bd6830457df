"""The files of a sweep's folder: its results, and tables whose rows are keyed by sweep, arm and seed."""

from pathlib import Path

import pandas as pd

RESULTS = "results.json"
LAPS, LEARNING, TRAININGS, STEERING = "laps.csv", "learning.csv", "trainings.csv", "steering.csv"
KEY = ["sweep", "arm", "seed"]
WORDS = ("policy", "sweep", "arm", "job", "car")  # columns that may look like numbers, or like NA


def read_table(path: Path) -> pd.DataFrame:
    """Return a table whose rows name their policy, "" where none is known: older sweeps had one alone."""
    table = pd.read_csv(path, dtype=dict.fromkeys(WORDS, str), keep_default_na=False, na_values=[""])
    return table.fillna({"policy": ""}) if "policy" in table else table.assign(policy="")
