"""A finished training as what a car needs of it: the policy with what it sees, does and knows of the track."""

from pathlib import Path
from typing import NamedTuple

from racerl.assemble import build_action, build_timing, build_track
from racerl.control.policy import AnyPolicy, load_policy
from racerl.env.actions import Action
from racerl.env.observations import Observation, create_observation
from racerl.errors import PolicyError
from racerl.evaluate.evaluate import Origin, origin_of
from racerl.track.track import Track


class Trained(NamedTuple):
    """A policy, where it comes from, and its world."""

    origin: Origin
    policy: AnyPolicy
    track: Track
    action: Action
    observation: Observation  # fitted
    dt: float  # s between two actions


def load_trained(run: Path) -> Trained:
    """Read a finished training, or its `unrefined/`.

    Raises RunError, PolicyError or ConfigError where it cannot drive.
    """
    origin, policy = origin_of(run), load_policy(run)
    settings = {**origin.settings, "action": policy.action}
    track = build_track(settings)
    observation = create_observation(policy.observation).fitted(track)
    if observation.size != policy.sizes[0]:
        raise PolicyError(f"{run}: reads {policy.sizes[0]} numbers, its observation has {observation.size}")
    return Trained(origin, policy, track, build_action(settings), observation, build_timing(settings).dt)
