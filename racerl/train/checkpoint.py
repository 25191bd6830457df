"""Checkpoints: all that the next rollout depends on, in one safetensors file, so that a resumed run is bit-identical.

Taken at the start of a rollout: policy, optimizer, counters, race, and every random generator. Written atomically;
numbers and plain data only.
"""

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from racerl.documents import write_bytes
from racerl.errors import RunError
from racerl.train.ppo import RacePPO

FILE = "checkpoint.safetensors"
DAMAGED = (SafetensorError, KeyError, TypeError, ValueError, RuntimeError, OSError)
COUNTERS = ("num_timesteps", "_n_updates", "rate_factor")


def write_tensors(path: Path, tensors: dict[str, Tensor], state: dict[str, Any]) -> None:
    """Write tensors, and plain data beside them, into one file."""
    contiguous = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    write_bytes(path, save(contiguous, {"state": json.dumps(state)}))


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Return what was written; raise one of `DAMAGED` where it cannot be read."""
    with safe_open(path, framework="pt") as file:
        state: dict[str, Any] = json.loads(file.metadata()["state"])
        return {name: file.get_tensor(name) for name in file.keys()}, state  # noqa: SIM118 (no mapping)


def save_checkpoint(model: RacePPO, folder: Path, facts: dict[str, Any]) -> None:
    """Write the model's state and some plain facts."""
    tensors = {f"policy.{name}": tensor for name, tensor in model.policy.state_dict().items()}
    tensors |= {f"race.{name}": tensor for name, tensor in model.race.snapshot().items()}
    for i, state in model.policy.optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{i}.{name}": torch.as_tensor(value) for name, value in state.items()}
    tensors |= {f"normaliser.{name}": tensor for name, tensor in vars(model.normaliser).items()}
    tensors["random.shuffle"], tensors["random.torch"] = model.shuffle.get_state(), torch.get_rng_state()
    if model.device.type == "cuda":
        tensors["random.cuda"] = torch.cuda.get_rng_state(model.device)
    write_tensors(
        folder / FILE, tensors, {"counters": {name: getattr(model, name) for name in COUNTERS}, "facts": facts}
    )


def load_checkpoint(model: RacePPO, folder: Path) -> dict[str, Any]:
    """Put the model into the checkpoint's state and return its facts; raise RunError when it is damaged."""
    try:
        tensors, state = read_tensors(folder / FILE)
        model.policy.load_state_dict(section(tensors, "policy."))
        _load_optimizer(model, section(tensors, "optimizer."))
        model.race.restore(section(tensors, "race."))
        for name in vars(model.normaliser):
            setattr(model.normaliser, name, tensors[f"normaliser.{name}"].to(model.device))
    except DAMAGED as error:
        raise RunError(f"{folder / FILE}: is damaged ({error}); remove the run folder and train again") from error
    for name in COUNTERS:
        setattr(model, name, state["counters"][name])
    model.shuffle.set_state(tensors["random.shuffle"])
    torch.set_rng_state(tensors["random.torch"])
    if "random.cuda" in tensors:
        torch.cuda.set_rng_state(tensors["random.cuda"], model.device)
    facts: dict[str, Any] = state["facts"]
    return facts


def section(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return the tensors whose names begin so, without that."""
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def _load_optimizer(model: RacePPO, tensors: dict[str, Tensor]) -> None:
    state: dict[int, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        index, _, key = name.partition(".")
        state.setdefault(int(index), {})[key] = tensor
    groups = model.policy.optimizer.state_dict()["param_groups"]
    model.policy.optimizer.load_state_dict({"state": state, "param_groups": groups})
