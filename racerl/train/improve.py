"""What a training may end with: a policy that is there is improved step by step, and examined on the way.

Two kinds: `racerl.train.refinement`, an evolution strategy, and `racerl.train.ascent`, the gradient of what it drives.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from torch import Tensor, nn

from racerl.control.policy import AnyPolicy
from racerl.train import checkpoint
from racerl.train.session import Progress, Session, require_finite_weights

FILE = "refinement.safetensors"


class Improver(Protocol):
    """A policy on its way; its weights are changed in place."""

    @property
    def network(self) -> nn.Module:
        """What is improved."""

    @property
    def done(self) -> int:
        """Steps of the weights so far."""

    def advance(self) -> dict[str, float]:
        """Take one step of the weights; return its measures, what a car makes of its way in m among them: `fitness`."""

    def snapshot(self) -> dict[str, Tensor]:
        """Return all that the next step depends on, but for its number."""

    def restore(self, tensors: dict[str, Tensor], state: Mapping[str, Any]) -> None:
        """Go on from a snapshot, and `state["done"]` steps."""


class Improvement(Protocol):
    """How long and how boldly, a key of the budget."""

    @property
    def name(self) -> str:
        """The budget's key, and what its measures are logged under."""

    @property
    def fact(self) -> str:
        """The manifest's key of the steps taken."""

    @property
    def remedy(self) -> str:
        """What to do where the weights do not stay finite."""

    @property
    def count(self) -> int:
        """Steps of the weights."""

    @property
    def evaluations(self) -> int:
        """Examinations, evenly over them."""

    @property
    def horizon(self) -> int:
        """Control steps that a car drives for one step of the weights."""

    @property
    def steps(self) -> int:
        """Control steps of one of them, of all cars together."""

    def begin(self, session: Session, policy: AnyPolicy) -> Improver:
        """Return what changes a policy in place, in the training's world."""


def improve(session: Session, plan: Improvement, policy: AnyPolicy, before: int, began: float) -> dict[str, Any]:
    """Improve a policy in place, after `before` control steps and `began` s of training; return facts to keep.

    What was interrupted goes on from its checkpoint. `clean_after_s`: seconds until a first examination without a
    crash, all of whose laps stay on the track, 0 where the best before was such; None if there was none.
    """
    way = plan.begin(session, policy)
    path = session.folder.path / FILE
    state = checkpoint.recover(path, way.restore)
    first = way.done
    session.recall(state, before + first * plan.steps)
    clean = state["clean"] if state else 0.0 if session.best and _clean(session.best) else None
    now = session.seconds
    failed = (state.get("nan_cars", 0) if state else 0) - _faults(session)  # in this process, before

    def keep() -> None:
        nan_cars = failed + _faults(session)
        facts = {"done": way.done, "clean": clean, "nan_cars": nan_cars, "session": session.facts()}
        checkpoint.keep(path, way.snapshot(), facts)

    with session.kept(keep) as between:
        while way.done < plan.count:
            measures = way.advance()
            for name, value in measures.items():
                session.logger.record(f"{plan.name}/{name}", value)
            number = way.done
            steps = before + number * plan.steps
            require_finite_weights({"policy": way.network.parameters()}, steps, plan.remedy)
            if number * plan.evaluations // plan.count > (number - 1) * plan.evaluations // plan.count:
                session.examine(policy, steps)
                if clean is None and _clean(session.last):
                    clean = session.seconds - began
            session.logger.dump(steps)
            between()
            rate = (number - first) * plan.steps / (session.seconds - now)
            whole, reward = plan.count * plan.steps, measures["fitness"] / plan.horizon
            told = Progress(steps - before, whole, session.seconds, rate, reward, session.last, "refine")
            session.on_progress(told)
    return {
        "steps": before + plan.count * plan.steps,
        plan.fact: plan.count,
        "nan_cars": failed + _faults(session),
        "clean_after_s": None if clean is None else round(clean, 1),
    }


def _faults(session: Session) -> int:
    """Return how many cars have failed in this process, in all races of the session."""
    return sum(race.faults for race in session.races)


def falling(limits: Sequence[float], done: int, count: int) -> float:
    """Return a number that goes exponentially from the first of the limits to the last in so many steps."""
    first, last = limits
    return float(first * (last / first) ** (done / max(1, count - 1)))


def _clean(evaluation: Mapping[str, Any]) -> bool:
    return bool(evaluation["laps"]) and evaluation["valid_laps"] == evaluation["laps"]
