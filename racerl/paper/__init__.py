"""The paper's own numbers: Table I and what its Figures 3 to 6 show, digitised; the two laps of Fig. 6 as drives.

Time of the laps: the lines of Fig. 6 are drawn through samples 0.05 s apart, 111 of a lap of 5.561 s and 117 of one of
5.847 s; read so, they give the figure's own delta time within 7 ms (rms). ∫ds/v_x would make the laps 10 % too long:
v_x is the speed along the body, and a car that slides is faster along its path. Sample i of v_x and δ is taken to
belong to point i + 1, the first past the line, for the same place s; the last ones hold beyond the figure's axis.

Not in the figure, so assumed: yaw is the direction of the path, without the sideslip; and the car goes straight on
beyond either end of its line, past the start line, because a lap is not quite the same as the next.
"""

from importlib.resources import files

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from racerl.errors import ConfigError, suggest

SAMPLE = 0.05  # s between the points of Fig. 6
RATE = 100.0  # Hz, of the drives made from it
BEYOND = 4  # samples added at either end of a lap
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


def figure_6_delta_time() -> pd.DataFrame:
    """Return s_m, rl_minus_human_s: below 0 the policy is ahead."""
    return _read("figure6_delta_time.csv")


def rl_lap() -> pd.DataFrame:
    """Return the policy's lap of Fig. 6 as a drive log: t, run, x, y, yaw, v_x, delta at 100 Hz."""
    return _lap("rl")


def human_lap() -> pd.DataFrame:
    """Return the human's lap of Fig. 6 as a drive log: t, run, x, y, yaw, v_x, delta at 100 Hz."""
    return _lap("human")


def _lap(driver: str) -> pd.DataFrame:
    points = figure_6("lines", driver)[["x_m", "y_m"]].to_numpy()
    on = np.arange(1, BEYOND + 1)[:, None]
    points = np.vstack(
        [points[0] + on[::-1] * (points[0] - points[1]), points, points[-1] + on * (points[-1] - points[-2])]
    )
    path = CubicSpline(SAMPLE * np.arange(len(points)), points)
    t = np.arange(0.0, path.x[-1], 1 / RATE)
    (x, y), (dx, dy) = path(t).T, path(t, 1).T
    speed, steering = figure_6("speed", driver)["v_x"], figure_6("steering", driver)["delta_rad"]
    drawn = SAMPLE * (BEYOND + 1 + np.arange(len(speed)))
    return pd.DataFrame(
        {
            "t": t,
            "run": 0,
            "x": x,
            "y": y,
            "yaw": np.unwrap(np.arctan2(dy, dx)),
            "v_x": np.interp(t, drawn, speed),
            "delta": np.interp(t, drawn, steering),
        }
    )


PAPER = "paper:"
LAPS = {f"{PAPER}rl": ("the paper's RL, Fig. 6", rl_lap), f"{PAPER}human": ("the paper's human, Fig. 6", human_lap)}


def find_lap(word: str) -> tuple[str, pd.DataFrame]:
    """Return title and drive of `paper:rl` or `paper:human`; raise ConfigError for anything else."""
    if word not in LAPS:
        raise ConfigError(f"unknown driver '{word}'{suggest(word, LAPS)}")
    title, lap = LAPS[word]
    return title, lap()
