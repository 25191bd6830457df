"""A policy that is there already: the refinement goes on from it, in whatever world the settings describe."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from racerl.control.policy import improved_by, load_policy
from racerl.errors import ConfigError, PolicyError
from racerl.train.session import Session


@dataclass(frozen=True)
class Trained:
    """The run that trained it, and by what it was learned there."""

    run: str
    learned: str

    def train(self, session: Session) -> dict[str, Any]:
        """Examine the policy as it is in its new world, and keep it.

        Raises ConfigError where no refinement follows, PolicyError where the policy reads other observations.
        """
        if not improved_by(session.settings["budget"]):
            raise ConfigError(
                f"from = {self.run}: a policy that is there is refined only; choose a budget with a refinement, "
                "as budget=laptop has"
            )
        policy = load_policy(Path(self.run), session.device)
        size = session.examiner.races[0].observation.size
        if policy.sizes[0] != size or policy.sizes[-1] != 2:
            raise PolicyError(
                f"{self.run}: the policy has {policy.sizes[0]} inputs and {policy.sizes[-1]} outputs, the race "
                f"{size} and 2"
            )
        session.start()
        session.examine(policy, 0)
        return {"steps": 0, "nan_cars": 0, "before": session.best}
