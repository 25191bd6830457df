"""The train stage: a policy for the configured race, examined on the way, the best one kept.

Writes into its run folder: `policy.safetensors` and `policy.json` (the best policy by evaluation), `progress.jsonl`
(one line per update, append-only) and `tensorboard/`.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from racerl import bounds
from racerl.assemble import check_settings, choose_device, use_threads
from racerl.errors import ConfigError
from racerl.train.algorithms import create_algorithm
from racerl.train.session import Progress, Session


def train(
    settings: Mapping[str, Any], out: Path, on_progress: Callable[[Progress], None] = lambda progress: None
) -> dict[str, Any]:
    """Train a policy into the run folder `out`; return the facts that the manifest keeps."""
    bounds.whole("seed", settings["seed"], 0, 2**31 - 1)
    check_settings(settings)
    if not isinstance(settings.get("algo"), Mapping):
        raise ConfigError(f"algo = {settings.get('algo')}: a mapping with a name is expected, as conf/algo/ppo.yaml")
    use_threads(settings["threads"])
    algorithm = create_algorithm(settings["algo"])
    session = Session(settings, out, choose_device(settings["device"]), on_progress)
    facts = {**algorithm.train(session), "seconds": round(session.seconds, 1), "best": session.best}
    session.folder.finish(**facts)
    return facts
