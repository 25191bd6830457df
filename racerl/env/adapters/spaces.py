"""Observation and action of one car as Gymnasium spaces."""

import numpy as np
from gymnasium import spaces

from racerl.env.observations import OBSERVATION_LIMIT
from racerl.env.race import Race
from racerl.env.races import Races


def observation_space(race: Race | Races) -> spaces.Box:
    """Return the box of one car's observation."""
    return spaces.Box(-OBSERVATION_LIMIT, OBSERVATION_LIMIT, (race.observation.size,), np.float32)


def action_space() -> spaces.Box:
    """Return [−1, 1]²."""
    return spaces.Box(-1.0, 1.0, (2,), np.float32)
