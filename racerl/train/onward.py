"""`racerl train from=RUN`: a trained policy refined in a changed car, track or randomization."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from racerl.assemble import check_settings
from racerl.control.policy import load_policy
from racerl.errors import ConfigError
from racerl.evaluate.evaluate import OVERRIDABLE, learned
from racerl.run import RunFolder
from racerl.train.session import Progress
from racerl.train.train import train


def train_onward(
    settings: Mapping[str, Any], out: Path, on_progress: Callable[[Progress], None] = lambda progress: None
) -> dict[str, Any]:
    """Refine the policy of the run `settings["from"]` into the run folder `out`; return the facts of its manifest.

    The world is that of the run but for the groups given here. `before` is the policy's examination as it came.
    Raises RunError where that is no finished training.
    """
    if not isinstance(settings["from"], str) or not settings["from"]:
        raise ConfigError(f"from = {settings['from']!r}: the folder of a finished training run is expected")
    run = RunFolder.open_complete(Path(settings["from"]), "train")
    before = run.settings()
    check_settings(before)
    policy = load_policy(run.path)
    given = {group: settings[group] for group in OVERRIDABLE if settings.get(group) is not None}
    kept = {key: settings.get(key) for key in ("budget", "seed", "threads", "device", "out", "tracking")}
    # the policy knows what it sees and does, in which scale
    world = {**before, **given, "obs": dict(policy.observation), "action": dict(policy.action)}
    origin = {"name": "trained", "run": str(settings["from"]), "learned": learned(before)}
    return train({**world, **kept, "algo": origin}, out, on_progress)
