"""Where a training's numbers go beside its run folder, one file each; module `trackio` holds the class `Trackio`.

What is chosen here is no part of a run: the same words with another tracker, or none, train the same policy and go on
where they were.
"""

from collections.abc import Mapping
from typing import Any, Protocol

from stable_baselines3.common.logger import KVWriter

from racerl import registry
from racerl.errors import ConfigError
from racerl.run import RunFolder


class Tracker(Protocol):
    """A place for numbers; its fields are the settings of `conf/tracking/*.yaml`."""

    def follow(self, folder: RunFolder) -> KVWriter:
        """Return what writes a run's numbers; of a run that goes on, behind those that are there."""


def create_tracker(settings: Any) -> Tracker | None:
    """Build the tracker that `settings["name"]` names; None where there are no settings."""
    import racerl.train.trackers as package

    if settings is None:
        return None
    if not isinstance(settings, Mapping):
        raise ConfigError(f"tracking = {settings}: a mapping with a name is expected, as conf/tracking/trackio.yaml")
    tracker: Tracker = registry.create(package, settings)
    return tracker
