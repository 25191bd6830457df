"""The paper's own numbers: Table I and what its Figures 3 to 6 show, digitised."""

from importlib.resources import files

import pandas as pd

NAMES = {
    "rl_geometric": "paper: RL, geometric",
    "rl_without_actuator_model": "paper: RL, no actuator model",
    "rl_frenet_progress": "paper: RL, progress",
    "mpc": "paper: MPC",
    "human": "paper: human",
}


def _read(name: str) -> pd.DataFrame:
    with (files("racerl.paper") / name).open(encoding="utf-8") as stream:
        return pd.read_csv(stream)


def table_1() -> pd.DataFrame:
    """Return name, fastest_valid_lap_s, mean_lap_s, std_lap_s, e_off of the real car, 20 laps each."""
    return _read("table1_controllers.csv")


def figure_6(what: str, driver: str = "rl") -> pd.DataFrame:
    """Return `lines` (x_m, y_m), `speed` (s_m, v_x) or `steering` (s_m, delta_rad) of the paper's rl or human."""
    table = _read(f"figure6_{what}.csv")
    return table[table["driver"] == driver]


def figure_3() -> pd.DataFrame:
    """Return randomization (none, friction, all), sigma, median_lap_s, e_off of the real car."""
    return _read("figure3_domain_randomization.csv")


def figure_4() -> pd.DataFrame:
    """Return curve (observation_action), million_steps, reward per step of the training."""
    return _read("figure4_learning.csv")


def figure_5() -> pd.DataFrame:
    """Return policy (with_actuator_model, without_actuator_model), s_m, delta_rad on the real car."""
    return _read("figure5_steering.csv")
