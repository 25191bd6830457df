"""Checkpoints: everything that a training's next step depends on, so that an interrupted run continues bit for bit.

One safetensors file each, tensors and plain data as JSON, with a digest in front; nothing is pickled. The last two are
kept: where the newest is damaged, the run goes on from the one before.
"""

import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from racerl.documents import read_sealed, write_sealed
from racerl.errors import DocumentError, RunError
from racerl.train.ppo import RacePPO

FILE = "checkpoint.safetensors"
BEFORE = "before."  # in front of the name of the one before
MOST_BYTES = 2**34
STATE = "state"  # name of the plain data among the tensors
UNFIT = (SafetensorError, KeyError, TypeError, ValueError, RuntimeError, IndexError)
COUNTERS = ("num_timesteps", "_n_updates", "_current_progress_remaining", "rate_factor")
Tensors = dict[str, Tensor]
State = dict[str, Any]

log = logging.getLogger(__name__)


def keep(path: Path, tensors: Tensors, state: State) -> None:
    """Write tensors, and plain data beside them, into one file; the one that was there becomes the one before."""
    plain = torch.frombuffer(bytearray(json.dumps(state).encode()), dtype=torch.uint8)
    contiguous = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    if path.is_file():
        path.replace(_before(path))
    write_sealed(path, save({**contiguous, STATE: plain}))


def recover(path: Path, put: Callable[[Tensors, State], None]) -> State | None:
    """Give the newest checkpoint that is whole to `put`, and return its plain data; None where there is none.

    Warns of a damaged one, and removes it where there is another; raises RunError where there is none, or where it is
    whole and cannot be put here.
    """
    damage = ""
    for each in (path, _before(path)):
        if not each.is_file():
            continue
        try:
            content = read_sealed(each, MOST_BYTES)
        except DocumentError as error:
            damage = f"{each}: is damaged ({error})"
            log.warning("%s; looking for the one before", damage)
            continue
        try:
            tensors = load(content)
            state: State = json.loads(tensors.pop(STATE).numpy().tobytes())
            put(tensors, state)
        except UNFIT as error:
            told = " ".join(str(error).split())
            raise RunError(f"{each}: cannot be continued here ({told}); go on with the racerl that began it") from error
        if damage:
            path.unlink()  # or it would take the place of the one that is whole
        return state
    if damage:
        raise RunError(f"{damage}; remove the run folder and train again")
    return None


def discard(path: Path) -> None:
    """Remove what a finished training needs no longer."""
    path.unlink(missing_ok=True)
    _before(path).unlink(missing_ok=True)


def tensors_of(model: RacePPO) -> Tensors:
    """Return a model's state."""
    tensors = {f"policy.{name}": tensor for name, tensor in model.policy.state_dict().items()}
    tensors |= {f"race.{name}": tensor for name, tensor in model.race.snapshot().items()}
    tensors |= {f"optimizer.{name}": tensor for name, tensor in optimizer_tensors(model.policy.optimizer).items()}
    tensors |= {f"normaliser.{name}": tensor for name, tensor in vars(model.normaliser).items()}
    tensors |= {f"carried.{name}": tensor for name, tensor in model.carried.items()}
    tensors["random.shuffle"], tensors["random.torch"] = model.shuffle.get_state(), torch.get_rng_state()
    if model.device.type == "cuda":
        tensors["random.cuda"] = torch.cuda.get_rng_state(model.device)
    return tensors


def put_into(model: RacePPO, tensors: Tensors, state: State) -> None:
    """Put a model into the state of a checkpoint; raise one of `UNFIT` where it is another's."""
    model.policy.load_state_dict(section(tensors, "policy."))
    load_optimizer(model.policy.optimizer, section(tensors, "optimizer."))
    model.race.restore(section(tensors, "race."))
    for name in vars(model.normaliser):
        setattr(model.normaliser, name, tensors[f"normaliser.{name}"].to(model.device))
    model.carried = section(tensors, "carried.")
    for name in COUNTERS:
        setattr(model, name, state["counters"][name])
    model.race.faults = state["counters"]["faults"]
    model.shuffle.set_state(tensors["random.shuffle"])
    torch.set_rng_state(tensors["random.torch"])
    if "random.cuda" in tensors:
        torch.cuda.set_rng_state(tensors["random.cuda"], model.device)


def counters(model: RacePPO) -> State:
    """Return the numbers of a model that are no tensors."""
    return {name: getattr(model, name) for name in COUNTERS} | {"faults": model.race.faults}


def section(tensors: Tensors, prefix: str) -> Tensors:
    """Return the tensors whose names begin so, without that."""
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def optimizer_tensors(optimizer: torch.optim.Optimizer) -> Tensors:
    """Return an optimizer's state."""
    rows = optimizer.state_dict()["state"].items()
    return {f"{i}.{name}": torch.as_tensor(value) for i, state in rows for name, value in state.items()}


def load_optimizer(optimizer: torch.optim.Optimizer, tensors: Tensors) -> None:
    """Put an optimizer into such a state."""
    state: dict[int, Tensors] = {}
    for name, tensor in tensors.items():
        index, _, key = name.partition(".")
        state.setdefault(int(index), {})[key] = tensor
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def _before(path: Path) -> Path:
    return path.with_name(BEFORE + path.name)
