"""A trained policy: a small network from observation to action, kept as `policy.safetensors` and `policy.json`.

The two files hold numbers and plain data only; loading them runs no code. The JSON names the observation and the
action that the network was trained with.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, cast

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor, nn

from racerl.control.networks import RecurrentNetwork, build_network, forgotten
from racerl.documents import read_bytes, read_json, write_bytes, write_json
from racerl.errors import DocumentError, PolicyError

if TYPE_CHECKING:
    from racerl.env.race import Race

FORMAT = 1
WEIGHTS, FACTS = "policy.safetensors", "policy.json"
UNREFINED = "unrefined"  # folder, in a training's, of its policy as it was before the refinement
IMPROVEMENTS = ("refinement", "ascent")  # a budget's keys for what a training ends with, one of them or none
MAX_WEIGHTS_BYTES = 256 * 1024 * 1024
MAX_LAYERS, MAX_UNITS = 16, 65536
RECURRENT = "recurrent"  # key of the facts of a policy that remembers


@dataclass(frozen=True)
class Policy:
    """The mean action of a trained actor."""

    network: nn.Sequential
    observation: Mapping[str, Any]  # settings of the observation it reads
    action: Mapping[str, Any]  # settings of the action it gives
    name: str = "policy"
    units: ClassVar[int] = 0  # numbers that it remembers from step to step

    @torch.no_grad()
    def __call__(self, observation: Tensor) -> Tensor:
        """Return actions (N, 2) in [−1, 1] for observations (N, O)."""
        action: Tensor = self.network(observation)
        return action.clamp(-1.0, 1.0)

    def decide(self, observation: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions and a memory (N, 0), as a policy does that has one."""
        return self(observation), memory

    def act(self, race: "Race") -> Tensor:
        """Return the actions for the cars of a race."""
        return self(race.observe())

    @property
    def sizes(self) -> list[int]:
        """Units of every layer, input and output included."""
        linear = [layer for layer in self.network if isinstance(layer, nn.Linear)]
        return [linear[0].in_features, *(layer.out_features for layer in linear)]


class RecurrentPolicy:
    """The mean action of a trained actor that remembers; one race at a time, from its first step on."""

    name = "policy"

    def __init__(self, network: RecurrentNetwork, observation: Mapping[str, Any], action: Mapping[str, Any]) -> None:
        self.network, self.observation, self.action = network, observation, action
        self._memory = torch.empty(0, self.units)

    @property
    def sizes(self) -> list[int]:
        """Numbers that it reads, remembers and gives."""
        return self.network.sizes

    @property
    def units(self) -> int:
        """Numbers that it remembers from step to step."""
        return self.sizes[1]

    @torch.no_grad()
    def decide(self, observation: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions (N, 2) in [−1, 1] and the memory (N, U) after them."""
        actions, memory = self.network(observation, memory)
        return actions.clamp(-1.0, 1.0), memory

    def act(self, race: "Race") -> Tensor:
        """Return the actions for the cars of a race; of those whose episode begins, nothing is remembered."""
        if len(self._memory) != race.count:
            self._memory = torch.zeros(race.count, self.units, device=race.device)
        actions, self._memory = self.decide(race.observe(), forgotten(self._memory, race.age == 0))
        return actions


AnyPolicy = Policy | RecurrentPolicy


def create_policy(network: nn.Module, observation: Mapping[str, Any], action: Mapping[str, Any]) -> AnyPolicy:
    """Return a network of mean actions as a policy, of its kind."""
    if isinstance(network, RecurrentNetwork):
        return RecurrentPolicy(network, observation, action)
    return Policy(cast(nn.Sequential, network), observation, action)


def improved_by(budget: Mapping[str, Any]) -> str:
    """Return the key of a budget by which policies are improved in the end; "" where they are not."""
    return next((key for key in IMPROVEMENTS if budget.get(key) is not None), "")


def save_policy(policy: AnyPolicy, folder: Path, **facts: Any) -> None:
    """Write a policy into a folder, atomically, weights first."""
    weights = {name: tensor.detach().cpu().contiguous() for name, tensor in policy.network.state_dict().items()}
    write_bytes(folder / WEIGHTS, save(weights))
    write_json(
        folder / FACTS,
        {
            "format": FORMAT,
            "observation": dict(policy.observation),
            "action": dict(policy.action),
            "layers": policy.sizes,
            **({RECURRENT: True} if policy.units else {}),
            **facts,
        },
    )


def load_policy(folder: Path, device: torch.device | str = "cpu") -> AnyPolicy:
    """Read a policy; raise PolicyError when a file is missing, damaged, of another version or not finite."""
    facts = _read_facts(folder)
    about = facts["observation"], facts["action"]
    sizes = facts["layers"]
    with torch.device("meta"):  # no memory before the weights are there, however many the file speaks of
        network = RecurrentNetwork(*sizes) if facts.get(RECURRENT) else build_network(sizes)
    _fill(network, folder)
    network.to(device)
    return create_policy(network, *about)


def _read_facts(folder: Path) -> dict[str, Any]:
    """Return what a policy's JSON says of it; raise PolicyError where that cannot be."""
    try:
        facts: dict[str, Any] = read_json(folder / FACTS)
    except DocumentError as error:
        raise PolicyError(str(error)) from error
    if facts.get("format") != FORMAT:
        raise PolicyError(f"{folder / FACTS}: format {facts.get('format')!r}, this racerl reads {FORMAT}; train again")
    _require_sizes(facts, folder)
    for key in ("observation", "action"):
        if not isinstance(facts.get(key), dict):
            raise PolicyError(f"{folder / FACTS}: has no '{key}'; train again")
    return facts


def _fill(network: nn.Module, folder: Path) -> None:
    """Give a network the weights of a folder; raise PolicyError where they do not fit or are not finite."""
    weights = {name: tensor.float() for name, tensor in _read_weights(folder / WEIGHTS).items()}
    try:
        network.load_state_dict(weights, assign=True)
    except RuntimeError as error:
        raise PolicyError(
            f"{folder / WEIGHTS}: does not fit {FACTS} ({str(error).splitlines()[-1].strip()})"
        ) from error
    if not all(bool(torch.isfinite(tensor).all()) for tensor in network.state_dict().values()):
        raise PolicyError(f"{folder / WEIGHTS}: holds NaN or infinite weights; train again")
    network.requires_grad_(False)


def _require_sizes(facts: Mapping[str, Any], folder: Path) -> None:
    sizes = facts.get("layers")
    whole = isinstance(sizes, list) and all(type(n) is int and 0 < n <= MAX_UNITS for n in sizes)
    least, most = (3, 3) if facts.get(RECURRENT) else (2, MAX_LAYERS)
    if not whole or not least <= len(sizes or []) <= most:
        raise PolicyError(
            f"{folder / FACTS}: layers = {sizes!r}; a list of {least} … {most} positive sizes was expected"
        )


def _read_weights(path: Path) -> dict[str, Tensor]:
    try:
        return load(read_bytes(path, MAX_WEIGHTS_BYTES))
    except DocumentError as error:
        raise PolicyError(str(error)) from error
    except SafetensorError as error:
        raise PolicyError(f"{path}: is damaged ({error}); train again") from error
