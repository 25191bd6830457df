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

from racerl.control.policy import Policy
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
FUNCTION = '#include "policy.h"\nvoid drive(const float *x, float *d, float *s) { racerl_drive(x, d, s); }\n'


def export(settings: Mapping[str, Any], out: Path) -> dict[str, Any]:
    """Write the policy of `settings["run"]` into `out`; return the card.

    Raises RunError where a file gives other references than the policy does in a race.
    """
    try:
        from racerl.deploy.onnx_file import onnx_bytes
    except ImportError as error:
        raise ConfigError("racerl export needs onnx: in your clone, pip install -e '.[export]'") from error
    trained = load_trained(Path(settings["run"]))
    policy, action, dt = trained.policy, trained.action, trained.dt
    origin, learned, manifest = trained.origin, trained.origin.settings, trained.origin.training.manifest
    driver = Driver.of(policy, trained.observation, action, dt)
    card = {
        "policy": label(learned),
        **_interface(driver, action, dt),
        "layers": policy.sizes,
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


def _parity(driver: Driver, policy: Policy, action: Action, dt: float, content: bytes, header: str) -> dict[str, Any]:
    """Return by how much references differ from those of the race; None for what could not be run."""
    generator = np.random.default_rng(SEED)
    seen = generator.uniform(-WIDE, WIDE, (PROOF, len(driver.sees))).astype(np.float32) * driver.maxima
    last = generator.uniform(driver.drive_min, driver.drive_max, PROOF).astype(np.float32)
    scaled = (torch.from_numpy(seen) / torch.from_numpy(driver.maxima)).clamp(-OBSERVATION_LIMIT, OBSERVATION_LIMIT)
    before = torch.stack([torch.zeros(PROOF), torch.from_numpy(last)])
    wanted = action.command(policy(scaled), before, dt).numpy()
    found = {
        "numpy": driver(seen, last),
        "onnxruntime": _by_onnxruntime(content, seen, last),
        "c": _by_compiler(header, seen, last),
    }
    differences = {
        name: None if got is None else float(np.abs(np.stack(got) - wanted).max()) for name, got in found.items()
    }
    for name, difference in differences.items():
        if difference is not None and not difference <= ALIKE:
            raise RunError(f"{name}: the exported policy differs by {difference:.2g}, at most {ALIKE:g} is allowed")
    return {"observations": PROOF, "allowed": ALIKE, **differences}


def _by_onnxruntime(content: bytes, seen: Array, last: Array) -> tuple[Array, Array]:
    try:
        import onnxruntime
    except ImportError as error:
        raise ConfigError("racerl export needs onnxruntime: in your clone, pip install -e '.[export]'") from error
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    steering, drive = session.run(None, {"observation": seen, "last_drive_ref": last[:, None]})
    return steering[:, 0], drive[:, 0]


def _by_compiler(header: str, seen: Array, last: Array) -> tuple[Array, Array] | None:
    """Return what the C header's function gives; None where there is no compiler."""
    compiler = find_compiler()
    if compiler is None:
        return None
    steering, drive = np.empty_like(last), last.copy()
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / HEADER).write_text(header)
        (Path(folder) / "drive.c").write_text(FUNCTION)
        command = [compiler, "-O2", "-std=c99", "-Wall", "-Werror", "-shared", "-fPIC", "drive.c", "-o", "drive.so"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)  # noqa: S603
        function = ctypes.CDLL(str(Path(folder) / "drive.so")).drive
        for i, row in enumerate(seen):
            places = (row.ctypes.data, drive[i:].ctypes.data, steering[i:].ctypes.data)
            function(*map(ctypes.c_void_p, places))
    return steering, drive
