"""Files from strangers that mean harm: nothing is run, nothing outside is read or written, nothing hangs.

An audit hook sees every file that is opened, every process that is started and every class that is unpickled. Fails
where pipes and devices are read (`documents.read_bytes`), where an image may lie outside its map's folder
(`documents.inside`), where a zip's members keep their folders, where YAML has tags or aliases, and where a name
reaches a page as markup.
"""

import contextlib
import gzip
import io
import os
import pickle
import signal
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from racerl.assemble import build_race
from racerl.config import _check_user_files, compose_settings
from racerl.control.controllers import create_controller, read_controller
from racerl.control.networks import build_network
from racerl.control.policy import load_policy, save_policy
from racerl.data.load import load_logs
from racerl.data.survey import survey
from racerl.documents import read_json, read_yaml
from racerl.errors import RacerlError
from racerl.evaluate.evaluate import evaluate
from racerl.gap.checkpoint import Checkpoint
from racerl.report.log_page import draw_logs
from racerl.report.report import report
from racerl.run import RunFolder
from racerl.track.load import read_track
from racerl.train import checkpoint
from racerl.train.session import policy_of, read_progress
from racerl.vehicle.load import load_vehicle
from tests.conftest import CONF

pytestmark = pytest.mark.soak

SECONDS = 5  # until something hangs
DRIVE_LOG = yaml.safe_load((CONF / "data" / "drive_log.yaml").read_text())
WATCHED = ("open", "os.system", "subprocess.Popen", "os.exec", "os.posix_spawn", "pickle.find_class", "os.fork")
SCRIPT = "<script>alert(1)</script>"
_seen: list[tuple[str, tuple[Any, ...]]] | None = None


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if _seen is not None and event in WATCHED:
        _seen.append((event, arguments))


sys.addaudithook(_hook)


class Hangs(BaseException):
    """Not to be caught with an OSError."""


class Harm:
    """Runs a command when it is unpickled."""

    def __init__(self, canary: Path) -> None:
        self.canary = canary

    def __reduce__(self):
        return os.system, (f"touch {self.canary}",)


@contextlib.contextmanager
def watched(folder: Path, canary: Path, secret: Path | None = None):
    """Let something be read: within seconds, without code or processes, without a file written outside or a secret."""
    global _seen

    def hangs(*_):
        raise Hangs

    before = signal.signal(signal.SIGALRM, hangs)
    signal.alarm(SECONDS)
    _seen = []
    try:
        with contextlib.suppress(RacerlError):
            yield
    finally:
        seen, _seen = _seen, None
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert not canary.exists()
    for event, arguments in seen:
        assert event == "open", (event, arguments)
        path, mode, flags = arguments
        if isinstance(path, int):
            continue
        place = Path(os.fsdecode(path)).resolve()
        assert secret is None or place != secret.resolve()
        writes = (mode and set(mode) & set("wax+")) or (flags or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        assert not writes or place.is_relative_to(folder.resolve()) or place.is_relative_to(tempfile.gettempdir()), (
            place
        )


@pytest.fixture
def canary(tmp_path):
    return tmp_path / "canary"


@pytest.fixture(scope="module")
def sound_run(tmp_path_factory):
    """Return the files of a small finished training."""
    settings = compose_settings("train", ["+dr=friction_0.02"])
    race = build_race(settings, cars=1, seeds=[0])
    run = RunFolder.start(tmp_path_factory.mktemp("sound") / "run", "train", settings, seed=0)
    save_policy(policy_of(build_network([race.observation.size, 4, 2]), race, settings), run.path)
    run.finish(steps=0, seconds=0.0)
    return {path.name: path.read_bytes() for path in run.path.iterdir()}


READERS = {  # file name: what reads the folder with it
    "policy.safetensors": load_policy,
    "policy.json": load_policy,
    "manifest.json": RunFolder.open_complete,
    "config.yaml": lambda folder: RunFolder.open_complete(folder).settings(),
    "progress.jsonl": read_progress,
    "checkpoint.safetensors": lambda folder: checkpoint.recover(folder / "checkpoint.safetensors", lambda *_: None),
    "0.safetensors": lambda folder: Checkpoint(folder).find("0"),
    "track.csv": lambda folder: read_track(folder / "track.csv"),
    "map.yaml": lambda folder: read_track(folder / "map.yaml"),
    "vehicle.yaml": lambda folder: load_vehicle({"file": str(folder / "vehicle.yaml")}),
    "controller.yaml": lambda folder: create_controller(read_controller({"file": str(folder / "controller.yaml")})),
    "log.csv": lambda folder: load_logs([folder / "log.csv"], DRIVE_LOG),
    "log.csv.gz": lambda folder: load_logs([folder / "log.csv.gz"], DRIVE_LOG),
    "log.parquet": lambda folder: load_logs([folder / "log.parquet"], DRIVE_LOG),
    "log.zip": lambda folder: load_logs([folder / "log.zip"], DRIVE_LOG),
    "log.db3": lambda folder: load_logs([folder / "log.db3"], DRIVE_LOG),
    "log.mcap": lambda folder: load_logs([folder / "log.mcap"], DRIVE_LOG),
    "any.json": lambda folder: read_json(folder / "any.json"),
    "any.yaml": lambda folder: read_yaml(folder / "any.yaml"),
}


def gzip_bomb() -> bytes:
    stream = io.BytesIO()
    with gzip.open(stream, "wb", compresslevel=9) as out:
        for _ in range(3 * 1024):
            out.write(bytes(1024**2))  # 3 GiB
    return stream.getvalue()


def zip_bomb() -> bytes:
    stream = io.BytesIO()
    with (
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("a.db3", "w", force_zip64=True) as out,
    ):
        for _ in range(2 * 1024):
            out.write(bytes(1024**2))
    return stream.getvalue()


def nested(opening: str, closing: str, depth: int = 100_000) -> bytes:
    return (opening * depth + closing * depth).encode()


def aliases() -> bytes:
    lines = ['a0: &a0 ["x", "x", "x", "x", "x", "x", "x", "x", "x"]']
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)]
    return "\n".join(lines).encode()


def huge_header() -> bytes:
    """A safetensors file that says its header is very long, and one tensor very large."""
    return (2**62).to_bytes(8, "little") + b"{}"


def huge_tensor() -> bytes:
    header = b'{"0.weight":{"dtype":"F32","shape":[1000000000,1000000000],"data_offsets":[0,4]}}'
    return len(header).to_bytes(8, "little") + header + bytes(4)


BOMBS = {
    "gzip bomb": gzip_bomb,
    "zip bomb": zip_bomb,
    "YAML aliases": aliases,
    "deep JSON": lambda: nested("[", "]"),
    "deep YAML": lambda: nested("{a: ", "}", 20_000),
    "deep mapping": lambda: b"".join(b" " * i + b"a:\n" for i in range(3000)),
    "huge header": huge_header,
    "huge tensor": huge_tensor,
    "tag": lambda: b"!!python/object/apply:os.system ['touch canary']",
    "new object": lambda: b"a: !!python/object/new:os.system [touch canary]",
    "target": lambda: b"_target_: os.system\n_args_: [touch canary]\nname: x\n",
    "interpolation": lambda: b"name: ${oc.env:HOME}\nformat: 1\nstage: ${oc.env:HOME}\n",
    "long line": lambda: b"x," * 3_000_000,
    "digits": lambda: b"9" * 1_000_000,
    "nothing": lambda: b"",
}


@pytest.fixture(scope="module")
def bombs():
    return {name: make() for name, make in BOMBS.items()}


@pytest.mark.parametrize("name", list(READERS))
def test_bombs_and_pickles(name, bombs, sound_run, tmp_path, canary, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pickled = pickle.dumps(Harm(canary))
    stream = io.BytesIO()
    torch.save({"0.weight": Harm(canary)}, stream)
    contents = {**bombs, "pickle": pickled, "torch pickle": stream.getvalue()}
    for number, (kind, content) in enumerate(contents.items()):
        folder = tmp_path / f"{number}"
        write(folder, sound_run, name, content)
        with watched(folder, canary):
            READERS[name](folder)
        assert kind and not canary.exists()


def write(folder: Path, sound_run, name: str, content: bytes) -> None:
    folder.mkdir()
    for other, whole in sound_run.items():
        (folder / other).write_bytes(whole)
    if name == "map.yaml":
        (folder / "map_centerline.csv").write_text("0,0,1,1\n")
    (folder / name).write_bytes(content)


@pytest.mark.parametrize("name", list(READERS))
def test_pipes_devices_folders_and_loops(name, sound_run, tmp_path, canary):
    def link(to):
        return lambda path: path.symlink_to(to)

    kinds = [os.mkfifo, link("/dev/zero"), link("/dev/stdin"), link("/proc/self/mem"), Path.mkdir]
    kinds += [lambda path: path.symlink_to(path), link("/dev/full"), link("/proc/kmsg")]
    for number, make in enumerate(kinds):
        folder = tmp_path / str(number)
        write(folder, sound_run, name, b"")
        (folder / name).unlink()
        make(folder / name)
        with watched(folder, canary):
            READERS[name](folder)


@pytest.mark.parametrize(
    "image", ["../secret.png", "{outside}/secret.png", "link.png", "sub/../../secret.png", "fifo.png"]
)
def test_a_map_shows_no_image_from_outside(image, tmp_path, canary):
    folder, outside = tmp_path / "map", tmp_path / "outside"
    folder.mkdir()
    outside.mkdir()
    for place in (outside, tmp_path):
        (place / "secret.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (folder / "link.png").symlink_to(outside / "secret.png")
    os.mkfifo(folder / "fifo.png")
    facts = {"image": image.format(outside=outside), "resolution": 0.1, "origin": [0, 0, 0], "negate": 0}
    (folder / "map.yaml").write_text(yaml.safe_dump({**facts, "occupied_thresh": 0.65}))
    rows = [(0, 0), (9, 0), (9, 9), (0, 9)]
    (folder / "map_centerline.csv").write_text("\n".join(f"{x},{y},1,1" for x, y in rows))
    for secret in (outside / "secret.png", tmp_path / "secret.png"):
        with watched(folder, canary, secret):
            read_track(folder / "map.yaml")


@pytest.mark.parametrize(
    "member", ["../../evil.db3", "{outside}/evil.db3", "a/../../evil.db3", "..\\evil.db3", "metadata.yaml"]
)
def test_a_zip_writes_nothing_outside(member, tmp_path, canary):
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    with zipfile.ZipFile(folder / "log.zip", "w") as archive:
        archive.writestr(member.format(outside=tmp_path), b"SQLite format 3\0" + bytes(200))
        link = zipfile.ZipInfo("link.db3")
        link.external_attr = 0o120777 << 16  # a symbolic link
        archive.writestr(link, "/etc/passwd")
    with watched(folder, canary, Path("/etc/passwd")):
        load_logs([folder / "log.zip"], DRIVE_LOG)
    assert {path.name for path in folder.iterdir()} == {"log.zip"} and not list(tmp_path.rglob("evil*"))


@pytest.mark.parametrize("key", ["_target_", "a._target_", "_recursive_: true\n_target_"])
def test_a_user_folder_names_no_code(key, tmp_path):
    (tmp_path / "vehicle").mkdir()
    (tmp_path / "vehicle" / "x.yaml").write_text(f"{key}: os.system\n")
    with pytest.raises(RacerlError, match="_target_"):
        _check_user_files(tmp_path)


def test_a_stored_configuration_is_taken_as_it_stands(sound_run, tmp_path, canary):
    """Interpolations are not resolved, so that what stands in the environment goes nowhere."""
    os.environ["RACERL_SECRET"] = "swordfish"  # noqa: S105 (a canary)
    try:
        write(tmp_path / "run", sound_run, "note.txt", b"")
        stored = yaml.safe_load(sound_run["config.yaml"])
        for key in ("track", "vehicle", "obs", "action", "sim", "dr"):
            changed = {**stored, key: {"name": "${oc.env:RACERL_SECRET}", "file": "${oc.env:RACERL_SECRET}"}}
            (tmp_path / "run" / "config.yaml").write_text(yaml.safe_dump(changed))
            out = tmp_path / f"out_{key}"
            try:
                evaluate(compose_settings("evaluate", [f"run={tmp_path / 'run'}", "laps=1", "seeds=[0]"]), out)
            except RacerlError as error:
                assert "swordfish" not in str(error) and "\n" not in str(error)
            for file in out.rglob("*"):
                assert file.is_dir() or b"swordfish" not in file.read_bytes()
    finally:
        del os.environ["RACERL_SECRET"]


def test_names_reach_pages_as_text(smoke_evaluation, tmp_path):
    import shutil

    name = "<img src=x onerror=alert(1)>[red]x[.csv"
    log = tmp_path / name
    log.write_text(
        "t,x,y,yaw,v_x,v_y,yaw_rate,delta,omega,delta_ref,omega_ref\n"
        + "".join(f"{k * 0.02},{k * 0.02},0,0,1,0,0,0,1,0,1\n" for k in range(400))
    )
    survey(compose_settings("data", [f"logs=['{log}']"]), tmp_path / "data")
    page = draw_logs(tmp_path / "data").read_text()
    assert "<img src=x" not in page and "&lt;img src=x" in page

    raced = tmp_path / "raced"
    shutil.copytree(smoke_evaluation, raced)
    for file in ("metrics.json", "manifest.json", "config.yaml"):
        content = (raced / file).read_text()
        (raced / file).write_text(
            content.replace("l_shape", SCRIPT).replace("geometric", SCRIPT).replace("model", SCRIPT)
        )
    with contextlib.suppress(RacerlError):
        asked = compose_settings("report", [f"runs=['{raced}']"])
        assert SCRIPT not in report(asked, tmp_path / "page", tmp_path / "none").read_text()
