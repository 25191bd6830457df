"""The export stage: a trained policy as files that other programs run, and proof that they drive alike.

Writes `policy.onnx`, `policy.h` and `card.json`: what the policy sees and does, in which units, limits and rate, the
vehicle and track that it learned on, what became of it in training, and by how much the exported files differ from it.
"""

import ctypes
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from racerl.control.policy import AnyPolicy
from racerl.deploy.c_header import c_header
from racerl.deploy.driver import Array, Driver
from racerl.deploy.trained import load_trained
from racerl.documents import write_bytes, write_json, write_text
from racerl.env.actions import Action
from racerl.env.observations import OBSERVATION_LIMIT
from racerl.errors import ConfigError, RunError
from racerl.evaluate.evaluate import label
from racerl.run import RunFolder
from racerl.vehicle.compiler import find_compiler
from racerl.vehicle.load import vehicle_document

ONNX, HEADER, CARD = "policy.onnx", "policy.h", "card.json"
PROOF, SEED = 10_000, 0  # observations that the files are compared on
WIDE = 1.5  # times their maxima, of the numbers seen
ALIKE = 1e-5  # rad and m/s, greatest difference
FUNCTION = '#include "policy.h"\nvoid drive(const float *x, float *m, float *d, float *s) {{ racerl_drive({}); }}\n'


def export(settings: Mapping[str, Any], out: Path) -> dict[str, Any]:
    """Write the policy of `settings["run"]` into `out`; return the card.

    Raises RunError where a file gives other references than the policy does in a race.
    """
    try:
        from racerl.deploy.onnx_file import onnx_bytes
    except ImportError as error:
        raise ConfigError("racerl export needs onnx: in your clone, pip install -e '.[export]'") from error
    trained = load_trained(Path(str(settings["run"])))
    policy, action, dt = trained.policy, trained.action, trained.dt
    origin, learned, manifest = trained.origin, trained.origin.settings, trained.origin.training.manifest
    driver = Driver.of(policy, trained.observation, action, dt)
    card = {
        "policy": label(learned),
        **_interface(driver, action, dt),
        "layers": policy.sizes,
        **({"memory": {"units": driver.units, "begins": 0.0}} if driver.units else {}),
        "observation": dict(policy.observation),
        "action": dict(policy.action),
        "vehicle": vehicle_document(learned["vehicle"], {}, "wheel_speed"),
        "track": {"name": Path(str(learned["track"]["file"])).stem, "length_m": trained.track.length},
        "trained": {**origin.course, "best": manifest.get("best")},
        "manifest": {key: manifest.get(key) for key in ("run_id", "git_sha", "racerl", "seed", "threads", "words")},
    }
    content, header = onnx_bytes(driver, card), c_header(driver, f"racerl: {card['policy']}")
    card["parity"] = _parity(driver, policy, action, dt, content, header)

    folder = RunFolder.start(out, "export", settings)
    write_bytes(folder.path / ONNX, content)
    write_text(folder.path / HEADER, header)
    write_json(folder.path / CARD, card)
    folder.finish(train_run_id=origin.identity)
    return card


def _interface(driver: Driver, action: Action, dt: float) -> dict[str, Any]:
    """Return what goes in and out, how often, and in which limits."""
    added = driver.middle is None
    return {
        "sees": [each._asdict() for each in driver.sees],
        "limit": driver.limit,
        "does": {
            "delta_ref": {"unit": "rad", "low": -driver.steering_max, "high": driver.steering_max},
            "drive_ref": {
                "unit": "A" if action.drive_mode == "motor_current" else "m/s",
                "low": driver.drive_min,
                "high": driver.drive_max,
                "added_to_the_last": added,
                "most_per_step": driver.gain if added else None,
            },
        },
        "rate_hz": 1.0 / dt,
    }


def _parity(
    driver: Driver, policy: AnyPolicy, action: Action, dt: float, content: bytes, header: str
) -> dict[str, Any]:
    """Return by how much references, and what is remembered, differ from the race's; None for what could not be run."""
    generator = np.random.default_rng(SEED)
    seen = generator.uniform(-WIDE, WIDE, (PROOF, len(driver.sees))).astype(np.float32) * driver.maxima
    last = generator.uniform(driver.drive_min, driver.drive_max, PROOF).astype(np.float32)
    memory = generator.uniform(-1.0, 1.0, (PROOF, driver.units)).astype(np.float32)
    scaled = (torch.from_numpy(seen) / torch.from_numpy(driver.maxima)).clamp(-OBSERVATION_LIMIT, OBSERVATION_LIMIT)
    before = torch.stack([torch.zeros(PROOF), torch.from_numpy(last)])
    decided, remembered = policy.decide(scaled, torch.from_numpy(memory))
    wanted = np.column_stack([*action.command(decided, before, dt).numpy(), remembered.numpy()])
    found = {
        "numpy": driver(seen, last, memory),
        "onnxruntime": _by_onnxruntime(content, seen, last, memory),
        "c": _by_compiler(header, seen, last, memory),
    }
    differences = {
        name: None if got is None else float(np.abs(np.column_stack(got) - wanted).max()) for name, got in found.items()
    }
    for name, difference in differences.items():
        if difference is not None and not difference <= ALIKE:
            raise RunError(f"{name}: the exported policy differs by {difference:.2g}, at most {ALIKE:g} is allowed")
    return {"observations": PROOF, "allowed": ALIKE, **differences}


def _by_onnxruntime(content: bytes, seen: Array, last: Array, memory: Array) -> tuple[Array, Array, Array]:
    try:
        import onnxruntime
    except ImportError as error:
        raise ConfigError("racerl export needs onnxruntime: in your clone, pip install -e '.[export]'") from error
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    told = {"observation": seen, "last_drive_ref": last[:, None], "memory": memory}
    steering, drive, *remembered = session.run(None, {each.name: told[each.name] for each in session.get_inputs()})
    return steering[:, 0], drive[:, 0], remembered[0] if remembered else memory


def _by_compiler(header: str, seen: Array, last: Array, memory: Array) -> tuple[Array, Array, Array] | None:
    """Return what the C header's function gives; None where there is no compiler."""
    compiler = find_compiler()
    if compiler is None:
        return None
    steering, drive, memory = np.empty_like(last), last.copy(), memory.copy()
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / HEADER).write_text(header)
        (Path(folder) / "drive.c").write_text(FUNCTION.format("x, m, d, s" if memory.size else "x, d, s"))
        kind = ["-O2", "-std=c99", "-Wall", "-Werror", "-shared", "-fPIC"]
        command = [compiler, *kind, "drive.c", "-o", "drive.so", "-lm"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)  # noqa: S603
        function = ctypes.CDLL(str(Path(folder) / "drive.so")).drive
        for i, row in enumerate(seen):
            places = (row, memory[i], drive[i:], steering[i:])
            function(*(ctypes.c_void_p(place.ctypes.data) for place in places))
    return steering, drive, memory
