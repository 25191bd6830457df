"""Proximal policy optimisation within the budget; an interrupted run continues from its checkpoint, bit for bit."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback

from racerl import bounds
from racerl.control.policy import AnyPolicy
from racerl.errors import Diverged
from racerl.registry import construct
from racerl.train.checkpoint import FILE, counters, keep, put_into, recover, tensors_of
from racerl.train.drift import Drift
from racerl.train.ppo import Budget, RacePPO
from racerl.train.recurrent_ppo import RecurrentPPO
from racerl.train.session import Progress, Session, require_finite_weights


@dataclass(frozen=True)
class Memory:
    """The memory of a recurrent policy."""

    units: int

    def __post_init__(self) -> None:
        bounds.whole("algo.recurrent.units", self.units, 1, 1024)


@dataclass(frozen=True)
class Ppo:
    """PPO; its numbers stand in the budget."""

    privileged: bool = False  # the critic is told what is drawn of each car
    drift: Mapping[str, Any] | None = None  # what it is paid for side slip at first
    recurrent: Mapping[str, Any] | None = None  # the memory of a policy that has one

    def __post_init__(self) -> None:
        bounds.switch("algo.privileged", self.privileged)
        self._drift(), self._recurrent()  # refuse wrong numbers before anything is trained

    def train(self, session: Session) -> dict[str, Any]:
        """Train for `budget.steps` control steps."""
        budget = Budget.of(session.settings["budget"])
        memory = self._recurrent()
        race = session.build_races(budget.cars)
        session.start()
        build = partial(RecurrentPPO, units=memory.units) if memory else RacePPO
        model = build(race, budget, session.seed, privileged=self.privileged, drift=self._drift())
        model.set_logger(session.logger)
        trainer = Trainer(session)
        try:
            with session.kept(trainer.save) as trainer.between:
                model.learn(budget.steps, callback=trainer)
            trainer.check()
        except Diverged:
            trainer.examine()
            raise
        trainer.examine()
        return {"steps": model.num_timesteps, "nan_cars": race.faults}

    def _drift(self) -> Drift | None:
        return None if self.drift is None else construct(Drift, self.drift, "algo.drift")

    def _recurrent(self) -> Memory | None:
        return None if self.recurrent is None else construct(Memory, self.recurrent, "algo.recurrent")


class Trainer(BaseCallback):
    """Evaluates, writes checkpoints and reports, always at the start of a rollout."""

    model: RacePPO

    def __init__(self, session: Session) -> None:
        super().__init__()
        self.session = session
        self.examined = 0  # evaluations so far
        self.between: Callable[[], None] = lambda: None
        self.good: AnyPolicy  # after the last update whose weights were finite
        self.good_steps = 0

    def _on_training_start(self) -> None:
        session = self.session
        state = recover(session.folder.path / FILE, partial(put_into, self.model))
        session.recall(state, self.model.num_timesteps)
        if state:
            self.examined = state["examined"]
        self._began = time.perf_counter()
        self._first_step = self.model.num_timesteps

    def _on_step(self) -> bool:
        return True

    def check(self) -> None:
        """Remember the policy as it is if all weights are finite; raise Diverged otherwise."""
        model = self.model
        policy = model.as_policy(self.session.settings)
        networks = {"actor": policy.network.parameters(), "critic": model.policy.parameters()}
        require_finite_weights(networks, model.num_timesteps, "lower budget.learning_rate or budget.gradient_norm")
        self.good, self.good_steps = policy, model.num_timesteps

    def _on_rollout_start(self) -> None:
        self.check()
        budget = self.model.budget
        if self.model.num_timesteps >= (self.examined + 1) * budget.steps / budget.evaluations:
            self.examine()
            self.examined += 1
        self.between()
        elapsed = time.perf_counter() - self._began
        self.session.on_progress(
            Progress(
                steps=self.model.num_timesteps,
                total_steps=budget.steps,
                seconds=self.session.seconds,
                steps_per_s=(self.model.num_timesteps - self._first_step) / max(elapsed, 1e-9),
                reward=self.model.reward,
                evaluation=self.session.last,
            )
        )

    def save(self) -> None:
        """Write a checkpoint."""
        state = {"counters": counters(self.model), "examined": self.examined, "session": self.session.facts()}
        keep(self.session.folder.path / FILE, tensors_of(self.model), state)

    def examine(self) -> None:
        """Evaluate the policy that was good last."""
        self.session.examine(self.good, self.good_steps)
