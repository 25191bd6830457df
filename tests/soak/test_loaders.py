"""Damaged files by the thousand, in every loader: what is read is sound, anything else is a typed error of one line.

Each case takes one file of a sound set and damages its bytes, or puts something absurd in place of a number or a word.
Less than two seconds and 500 MB each. Fails where a size or a shape is believed before it is checked, where a number
that is no number passes, where a `.so` is loaded without its hash, and where a checkpoint is read without its digest.
(Damaged logs and bags have a file of their own, `tests/data/test_fuzz.py`; stored configurations another,
`tests/evaluate/test_stored_config.py`.)
"""

import json
import re
import shutil
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
import yaml
from PIL import Image

from racerl.assemble import build_race
from racerl.config import compose_settings
from racerl.control.controllers import create_controller, read_controller
from racerl.control.networks import build_network
from racerl.control.policy import load_policy, save_policy
from racerl.data.layout import read_layout
from racerl.data.load import load_logs
from racerl.documents import read_json, read_yaml
from racerl.errors import RacerlError
from racerl.gap.checkpoint import Checkpoint
from racerl.optimum import kept
from racerl.record.record import record
from racerl.report.report import report
from racerl.run import RunFolder
from racerl.sweep import definition
from racerl.track.load import read_track
from racerl.train import checkpoint
from racerl.train.session import policy_of, read_progress
from racerl.vehicle import compiler
from racerl.vehicle.load import load_vehicle
from tests.conftest import CONF
from tests.damage import BYTES, damaged

pytestmark = pytest.mark.soak

SECONDS, MEGABYTES = 2.0, 500
LONGEST = 7000  # letters of a line, which may hold a word of 5,000
ABSURD = [
    "nan",
    "-1",
    "0",
    "1e308",
    "1e999",
    "-.inf",
    "null",
    "[]",
    "{}",
    "true",
    "x",
    "''",
    "x" * 5000,
    "\0",
    "9" * 400,
]
SEED = 20261126


@dataclass
class Loader:
    """A sound set of files in a folder, which of them are damaged, and what reads them."""

    files: dict[str, bytes]
    damaged: str  # pattern of names
    read: Callable[[Path], Any]
    cases: int


def spoil(content: bytes, dice: np.random.Generator) -> bytes:
    """Return damaged bytes: bits, pieces, or a number or word of a text that is something absurd now."""
    for _ in range(dice.integers(1, 4)):
        kind = dice.choice([*BYTES, "word", "word", "word", "line"])
        if kind == "word" and (words := list(re.finditer(rb"[-\w.+]+", content[:20_000]))):
            word = words[int(dice.integers(len(words)))]
            content = content[: word.start()] + str(dice.choice(ABSURD)).encode() + content[word.end() :]
        elif kind == "line" and len(lines := content.split(b"\n")) > 1:
            del lines[int(dice.integers(len(lines)))]
            content = b"\n".join(lines)
        else:
            content = damaged(content, [(kind, float(dice.random()), int(dice.integers(1, 64)))])
    return content


def as_files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def loaders(tmp_path_factory) -> dict[str, Loader]:
    folder = tmp_path_factory.mktemp("sound")
    settings = compose_settings("train", ["+dr=friction_0.02"])
    race = build_race(settings, cars=2, seeds=[0])
    network = build_network([race.observation.size, 4, 2])
    run = RunFolder.start(folder / "run", "train", settings, seed=0)
    save_policy(policy_of(network, race, settings), run.path)
    (run.path / "progress.jsonl").write_text('{"steps": 1, "train/reward": 0.5}\n{"steps": 2, "train/reward": 0.6}\n')
    run.finish(steps=2, seconds=0.0)
    vehicle = settings["vehicle"]
    (folder / "model.yaml").write_text(yaml.safe_dump(vehicle))
    table = (CONF / "track" / "l_shape.csv").read_bytes() if (CONF / "track" / "l_shape.csv").is_file() else None
    track = race.track
    if table is None:
        rows = np.stack([track.x, track.y, track.width_right, track.width_left], axis=1)[::5]
        table = (
            b"# x_m, y_m, w_tr_right_m, w_tr_left_m\n"
            + "\n".join(", ".join(f"{value:.4f}" for value in row) for row in rows).encode()
        )
    map_files = a_map(folder, track, table)
    cars = {f"race.{name}": tensor for name, tensor in race.snapshot().items()}
    checkpoint.keep(folder / "checkpoint.safetensors", cars, {"steps": 3, "facts": {"a": [1.0]}})
    parts = Checkpoint(folder / "gap")
    parts.keep("0" * 32, {"theta": np.arange(5.0), "cost": np.array(1.0)})
    logged = folder / "logged"
    record(compose_settings("record", ["seconds=20", "drive=race", "file=log.parquet"]), logged)
    pd.read_parquet(logged / "log.parquet").iloc[:120].to_csv(folder / "log.csv", index=False)
    evaluated = folder / "evaluated"
    raced(evaluated, run.path)

    def restored(place: Path) -> Any:
        return checkpoint.recover(
            place / "checkpoint.safetensors", lambda tensors, state: race.restore(checkpoint.section(tensors, "race."))
        )

    def reported(place: Path) -> Any:
        asked = compose_settings("report", [f"runs=['{place / 'evaluated'}']"])
        return report({**asked, "out": str(place / "page")}, place / "page", place / "nothing")

    def one(name: str, path: Path) -> dict[str, bytes]:
        return {name: path.read_bytes()}

    lap = {
        "states": [[0.0] * 4] * 9,
        "commands": [[0.0] * 4] * 2,
        "durations": [0.1] * 4,
        "stretch": {"s": [0.0] * 4, "kappa": [0.0] * 4},
    }
    return {
        "track csv": Loader({"t.csv": table}, "t.csv", lambda p: read_track(p / "t.csv"), 1600),
        "map yaml": Loader(map_files, "map.yaml", lambda p: read_track(p / "map.yaml"), 800),
        "map image": Loader(map_files, "map.png", lambda p: read_track(p / "map.yaml"), 500),
        "map centreline": Loader(map_files, "map_centerline.csv", lambda p: read_track(p / "map.yaml"), 400),
        "vehicle": Loader(
            one("m.yaml", folder / "model.yaml"), "m.yaml", lambda p: load_vehicle({"file": str(p / "m.yaml")}), 1600
        ),
        "policy weights": Loader(
            as_files(run.path), "policy.safetensors", lambda p: sound(load_policy(p), race.observation.size), 900
        ),
        "policy facts": Loader(as_files(run.path), "policy.json", load_policy, 900),
        "manifest": Loader(as_files(run.path), "manifest.json", lambda p: RunFolder.open_complete(p).settings(), 600),
        "stored configuration": Loader(
            as_files(run.path), "config.yaml", lambda p: RunFolder.open_complete(p).settings(), 400
        ),
        "progress": Loader(as_files(run.path), "progress.jsonl", read_progress, 400),
        "training checkpoint": Loader(
            one("checkpoint.safetensors", folder / "checkpoint.safetensors"), "checkpoint.safetensors", restored, 600
        ),
        "gap checkpoint": Loader(
            {f"{'0' * 32}.safetensors": (folder / "gap" / f"{'0' * 32}.safetensors").read_bytes()},
            "*.safetensors",
            lambda p: unharmed(Checkpoint(p).find("0" * 32)),
            500,
        ),
        "log csv": Loader(
            one("log.csv", folder / "log.csv"), "log.csv", lambda p: load_logs([p / "log.csv"], DRIVE_LOG), 600
        ),
        "log parquet": Loader(
            one("log.parquet", logged / "log.parquet"),
            "log.parquet",
            lambda p: load_logs([p / "log.parquet"], DRIVE_LOG),
            300,
        ),
        "log mapping": Loader(
            one("map.yaml", CONF / "data" / "f1tenth.yaml"),
            "map.yaml",
            lambda p: read_layout(read_yaml(p / "map.yaml")),
            500,
        ),
        "controller": Loader(
            one("c.yaml", CONF / "controller" / "mpc.yaml"),
            "c.yaml",
            lambda p: create_controller(read_controller({"file": str(p / "c.yaml")})),
            500,
        ),
        "sweep": Loader(
            one("s.yaml", definition.folder() / "action_space.yaml"), "s.yaml", lambda p: swept(p / "s.yaml"), 500
        ),
        "kept lap": Loader(
            {"lap.json": json.dumps(lap).encode()},
            "lap.json",
            lambda p: kept._read(p / "lap.json", race.vehicle, race.action),
            300,
        ),
        "metrics": Loader(prefixed(evaluated), "evaluated/metrics.json", reported, 100),
        "trajectories": Loader(prefixed(evaluated), "evaluated/trajectories.parquet", reported, 60),
        "documents": Loader({"d.json": json.dumps(vehicle).encode()}, "d.json", lambda p: read_json(p / "d.json"), 400),
    }


DRIVE_LOG = yaml.safe_load((CONF / "data" / "drive_log.yaml").read_text())


def prefixed(folder: Path) -> dict[str, bytes]:
    return {f"evaluated/{name}": content for name, content in as_files(folder).items()}


def raced(out: Path, run: Path) -> None:
    from racerl.evaluate.evaluate import evaluate

    evaluate(compose_settings("evaluate", [f"run={run}", "laps=1", "seeds=[0]"]), out)


def a_map(folder: Path, track: Any, table: bytes) -> dict[str, bytes]:
    """Return a ROS map set of a track, coarse."""
    (left_x, left_y), (right_x, right_y) = track.boundary(1), track.boundary(-1)
    low = np.array([min(left_x.min(), right_x.min()), min(left_y.min(), right_y.min())]) - 1.0
    high = np.array([max(left_x.max(), right_x.max()), max(left_y.max(), right_y.max())]) + 1.0
    resolution = 0.1
    size = np.ceil((high - low) / resolution).astype(int)
    x, y = np.meshgrid(low[0] + resolution * np.arange(size[0]), low[1] + resolution * np.arange(size[1]))
    apart = np.hypot(x[..., None] - track.x, y[..., None] - track.y)
    nearest = apart.argmin(axis=2)
    free = apart.min(axis=2) < np.minimum(track.width_left, track.width_right)[nearest]
    Image.fromarray(np.where(free, 254, 0).astype(np.uint8)[::-1]).save(folder / "map.png")
    facts = {"image": "map.png", "resolution": resolution, "origin": [*map(float, low), 0.0], "negate": 0}
    facts |= {"occupied_thresh": 0.65, "free_thresh": 0.196}
    return {
        "map.yaml": yaml.safe_dump(facts).encode(),
        "map.png": (folder / "map.png").read_bytes(),
        "map_centerline.csv": table,
    }


def sound(policy: Any, size: int) -> Any:
    """Return a policy that answers with numbers."""
    if policy.sizes[0] == size:
        assert torch.isfinite(policy.network(torch.zeros(1, size))).all()
    return policy


def unharmed(parts: Any) -> Any:
    assert parts is None or (parts["theta"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0] and parts["cost"].item() == 1.0)
    return parts


def swept(path: Path) -> Any:
    return definition._sweep("s", read_yaml(path))


@pytest.mark.parametrize(
    "name",
    [
        "track csv",
        "map yaml",
        "map image",
        "map centreline",
        "vehicle",
        "policy weights",
        "policy facts",
        "manifest",
        "stored configuration",
        "progress",
        "training checkpoint",
        "gap checkpoint",
        "log csv",
        "log parquet",
        "log mapping",
        "controller",
        "sweep",
        "kept lap",
        "metrics",
        "trajectories",
        "documents",
    ],
)
def test_damaged_files(name, loaders, tmp_path, capsys):
    loader, dice = loaders[name], np.random.default_rng([SEED, *name.encode()])
    loader.read(place(loader, tmp_path / "sound", {}))  # as it is, it can be read
    names = [each for each in loader.files if Path(each).match(loader.damaged)]
    read, slowest, largest, wrong = 0, 0.0, 0, dict[str, str]()
    for number in range(loader.cases):
        chosen = names[int(dice.integers(len(names)))]
        folder = place(loader, tmp_path / str(number), {chosen: spoil(loader.files[chosen], dice)})
        forget_peak()
        before, began = memory("VmRSS"), time.process_time()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                loader.read(folder)
            read += 1
        except RacerlError as error:
            if "\n" in str(error) or len(str(error)) > LONGEST:
                wrong[f"no line: {str(error)[:200]!r}"] = str(number)
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            wrong[f"{type(error).__name__} in {Path(last.filename).name}:{last.lineno}: {str(error)[:200]}"] = str(
                number
            )
        took, grown = time.process_time() - began, memory("VmHWM") - before
        slowest, largest = max(slowest, took), max(largest, grown)
        if took > SECONDS or grown > MEGABYTES:
            wrong[f"{took:.1f} s and {grown} MB"] = str(number)
        if str(number) not in wrong.values():
            shutil.rmtree(folder)
    with capsys.disabled():
        print(f"\n{name}: {loader.cases} cases, {read} read, at most {slowest:.2f} s and {largest} MB")
    assert not wrong, f"{name}, {tmp_path}: {wrong}"


def test_damaged_kernels(tmp_path, monkeypatch, capsys):
    """A library that is not what its name says is built anew; none but a whole one is ever loaded."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    dice = np.random.default_rng(SEED)
    for number in range(300):
        code = f"int twice(int x) {{ return 2 * x + {number % 3}; }}"
        built = compiler.build(code)
        assert built is not None and built.twice(21) == 42 + number % 3
        for library in tmp_path.rglob("*.so"):
            content = spoil(library.read_bytes(), dice)
            library.unlink()  # what this process has mapped stays
            library.write_bytes(content)
    with capsys.disabled():
        print("\nkernels: 300 damaged, all built anew")


def place(loader: Loader, folder: Path, changed: dict[str, bytes]) -> Path:
    folder.mkdir(parents=True)
    for name, content in {**loader.files, **changed}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5")


def memory(key: str) -> int:
    """Return resident memory in MB: VmRSS now, VmHWM its peak since it was forgotten."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(key))
    return int(line.split()[1]) // 1024
