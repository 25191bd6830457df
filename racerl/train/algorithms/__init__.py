"""How a policy is trained, one file each; module `imitation` holds the class `Imitation`."""

from collections.abc import Mapping
from typing import Any, Protocol

from racerl import registry
from racerl.train.session import Session


class Algorithm(Protocol):
    """A way of training; its fields are the settings of `conf/algo/*.yaml`."""

    def train(self, session: Session) -> dict[str, Any]:
        """Train in the session, start it first, keep the best policy; return facts for the manifest."""


def create_algorithm(settings: Mapping[str, Any]) -> Algorithm:
    """Build the algorithm that `settings["name"]` names."""
    import racerl.train.algorithms as package

    algorithm: Algorithm = registry.create(package, settings)
    return algorithm
