"""Proximal policy optimisation within the budget; an interrupted run continues from its checkpoint, bit for bit."""

import time
from dataclasses import dataclass
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback

from racerl.assemble import build_race
from racerl.train.checkpoint import FILE as CHECKPOINT
from racerl.train.checkpoint import load_checkpoint, save_checkpoint
from racerl.train.ppo import Budget, RacePPO
from racerl.train.session import Progress, Session, policy_of

CHECKPOINT_PERIOD = 30.0  # s


@dataclass(frozen=True)
class Ppo:
    """PPO; its numbers stand in the budget."""

    def train(self, session: Session) -> dict[str, Any]:
        """Train for `budget.steps` control steps."""
        budget = Budget.of(session.settings["budget"])
        race = build_race(session.settings, cars=budget.cars, seeds=[session.seed], device=session.device)
        session.start()
        model = RacePPO(race, budget, session.seed)
        model.set_logger(session.logger)
        trainer = Trainer(session)
        model.learn(budget.steps, callback=trainer)
        trainer.examine()
        (session.folder.path / CHECKPOINT).unlink(missing_ok=True)
        return {"steps": model.num_timesteps, "nan_cars": race.faults}


class Trainer(BaseCallback):
    """Evaluates, writes checkpoints and reports, always at the start of a rollout."""

    model: RacePPO

    def __init__(self, session: Session) -> None:
        super().__init__()
        self.session = session
        self.examined = 0  # evaluations so far

    def _on_training_start(self) -> None:
        session = self.session
        if (session.folder.path / CHECKPOINT).is_file():
            facts = load_checkpoint(self.model, session.folder.path)
            session.best, session.last = facts["best"], facts["last"]
            self.examined, session.earlier_seconds = facts["examined"], facts["seconds"]
        self._began = self._saved = time.perf_counter()
        self._first_step = self.model.num_timesteps

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        budget = self.model.budget
        if self.model.num_timesteps >= (self.examined + 1) * budget.steps / budget.evaluations:
            self.examine()
            self.examined += 1
        if time.perf_counter() - self._saved > CHECKPOINT_PERIOD:
            self.save()
        elapsed = time.perf_counter() - self._began
        self.session.on_progress(
            Progress(
                steps=self.model.num_timesteps,
                total_steps=budget.steps,
                seconds=self.session.seconds,
                steps_per_s=(self.model.num_timesteps - self._first_step) / max(elapsed, 1e-9),
                reward=float(self.model.rollout.rewards.mean()),
                evaluation=self.session.last,
            )
        )

    def save(self) -> None:
        """Write a checkpoint."""
        session = self.session
        facts = {"best": session.best, "last": session.last, "examined": self.examined, "seconds": session.seconds}
        save_checkpoint(self.model, session.folder.path, facts)
        self._saved = time.perf_counter()

    def examine(self) -> None:
        """Evaluate the current policy."""
        policy = policy_of(self.model.actor(), self.model.race, self.session.settings)
        self.session.examine(policy, self.model.num_timesteps)
