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
COUNTERS = ("num_timesteps", "_n_updates", "rate_factor")


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
    contiguous = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    counters = {name: getattr(model, name) for name in COUNTERS}
    write_bytes(folder / FILE, save(contiguous, {"state": json.dumps({"counters": counters, "facts": facts})}))


def load_checkpoint(model: RacePPO, folder: Path) -> dict[str, Any]:
    """Put the model into the checkpoint's state and return its facts; raise RunError when it is damaged."""
    try:
        with safe_open(folder / FILE, framework="pt") as file:
            state = json.loads(file.metadata()["state"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (no mapping)
        model.policy.load_state_dict(_section(tensors, "policy."))
        _load_optimizer(model, _section(tensors, "optimizer."))
        model.race.restore(_section(tensors, "race."))
        for name in vars(model.normaliser):
            setattr(model.normaliser, name, tensors[f"normaliser.{name}"].to(model.device))
    except (SafetensorError, KeyError, TypeError, ValueError, RuntimeError, OSError) as error:
        raise RunError(f"{folder / FILE}: is damaged ({error}); remove the run folder and train again") from error
    for name in COUNTERS:
        setattr(model, name, state["counters"][name])
    model.shuffle.set_state(tensors["random.shuffle"])
    torch.set_rng_state(tensors["random.torch"])
    if "random.cuda" in tensors:
        torch.cuda.set_rng_state(tensors["random.cuda"], model.device)
    facts: dict[str, Any] = state["facts"]
    return facts


def _section(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def _load_optimizer(model: RacePPO, tensors: dict[str, Tensor]) -> None:
    state: dict[int, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        index, _, key = name.partition(".")
        state.setdefault(int(index), {})[key] = tensor
    groups = model.policy.optimizer.state_dict()["param_groups"]
    model.policy.optimizer.load_state_dict({"state": state, "param_groups": groups})
