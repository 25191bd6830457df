"""Reading and writing small documents: atomic on the way out, bounded and inert on the way in.

A file is written to a temporary name beside its target, flushed to disk and renamed, so a reader sees the old
content or the new, never half of it. What is read may come from a stranger: sizes are limited, YAML aliases are
refused (they can blow a small file up to gigabytes), and no reader can run code.
"""

import contextlib
import errno
import fcntl
import hashlib
import io
import json
import math
import os
import stat
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from racerl.errors import DocumentError

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

MAX_TEXT_BYTES = 8 * 1024 * 1024
MAX_YAML_BYTES = 1024 * 1024
DIGEST = hashlib.sha256().digest_size  # bytes
JUST_BEGUN = 1.0  # s, in which a file may not be locked yet


def packaged(name: str) -> Path:
    """Return a folder that comes with the package: inside a wheel, or beside the package in a checkout."""
    package = Path(str(files("racerl")))
    return package / name if (package / name).is_dir() else package.parent / name


def conf_folder() -> Path:
    """Return the folder of packaged configurations."""
    return packaged("conf")


def user_cache(name: str) -> Path:
    """Return the folder of that name in the user's cache of racerl."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "racerl" / name


@contextlib.contextmanager
def alone(lock: Path) -> Iterator[None]:
    """Hold a lock file against other processes; the death of its owner releases it. Raises OSError.

    It goes at the end, so what it guards must be written by then, and looked for again by whoever waited.
    """
    with lock.open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file atomically: temporary name, fsync, rename."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as stream:
            with contextlib.suppress(OSError):  # a file system without locks
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def as_frame(table: "pa.Table") -> "pd.DataFrame":
    """Return what was read from Parquet; what its writer noted about it may be damaged or made up, and is left out."""
    return table.replace_schema_metadata(None).to_pandas(use_threads=False, ignore_metadata=True)


def write_sealed(path: Path, content: bytes, about: str = "") -> None:
    """Write a file atomically with a digest in front, of its content and of what it is `about`."""
    write_bytes(path, _digest(content, about) + content)


def read_sealed(path: Path, limit: int, about: str = "") -> bytes:
    """Return what was written so; raise DocumentError where it is no longer whole, or is about something else."""
    sealed = read_bytes(path, limit + DIGEST)
    if sealed[:DIGEST] != _digest(sealed[DIGEST:], about):
        raise DocumentError(f"{path}: its content is not what was written")
    return sealed[DIGEST:]


def _digest(content: bytes, about: str) -> bytes:
    return hashlib.sha256(about.encode() + content).digest()


def sweep(folder: Path) -> None:
    """Remove what killed processes were writing anywhere in a folder; what is being written is locked, and left."""
    for path in folder.rglob(".*.tmp"):
        with contextlib.suppress(OSError), path.open("rb") as left:
            if time.time() - path.stat().st_mtime > JUST_BEGUN:
                fcntl.flock(left, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()


def write_text(path: Path, content: str) -> None:
    """Write a text file atomically as UTF-8."""
    write_bytes(path, content.encode())


def write_json(path: Path, content: Any) -> None:
    """Write JSON atomically; NaN and infinity are refused (they are not JSON)."""
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def write_yaml(path: Path, content: Mapping[str, Any]) -> None:
    """Write plain YAML atomically, keys in their order."""
    write_text(path, yaml.safe_dump(dict(content), sort_keys=False))


def write_parquet(path: Path, table: "pd.DataFrame") -> None:
    """Write a table atomically as Parquet, without its index."""
    stream = io.BytesIO()
    table.to_parquet(stream, index=False)
    write_bytes(path, stream.getvalue())


def require_content(path: Path) -> None:
    """Raise DocumentError for what is no file with something in it: for libraries that would read pipes and devices."""
    try:
        facts = path.stat()
    except OSError as error:
        raise DocumentError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    if not stat.S_ISREG(facts.st_mode):
        raise DocumentError(f"{path}: is a pipe, a device or a folder; give a file")
    if not facts.st_size:  # as the kernel's own files look, which may never end
        raise DocumentError(f"{path}: cannot be read (it is empty); give a file with something in it")


def content_hash(path: Path) -> str:
    """Return a hash of what a file holds."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read_bytes(path: Path, limit: int) -> bytes:
    """Read a file of at most `limit` bytes; raise DocumentError otherwise, and for what never ends: pipes, devices."""
    try:
        facts = path.stat()
        if not stat.S_ISREG(facts.st_mode) and not stat.S_ISDIR(facts.st_mode):
            raise DocumentError(f"{path}: is a pipe or a device; give a file")
        if facts.st_size > limit:
            raise DocumentError(f"{path}: {facts.st_size} bytes, at most {limit} are read; is this the right file?")
        if stat.S_ISDIR(facts.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        # without waiting for anybody, should it have become a pipe meanwhile
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as stream:
            return stream.read(os.fstat(stream.fileno()).st_size)  # no more: a file of the kernel's may never end
    except OSError as error:
        raise DocumentError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except ValueError as error:  # a zero byte in the path
        raise DocumentError(f"{str(path)!r}: is no path ({error})") from error


def read_text(path: Path, limit: int = MAX_TEXT_BYTES) -> str:
    """Read a UTF-8 text file of at most `limit` bytes; raise DocumentError otherwise."""
    try:
        return io.TextIOWrapper(io.BytesIO(read_bytes(path, limit)), encoding="utf-8-sig").read()
    except UnicodeDecodeError as error:
        raise DocumentError(f"{path}: not a text file (byte {error.start} is not UTF-8)") from error


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is not allowed")


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object; NaN and infinity are refused."""
    try:
        content = json.loads(read_text(path), parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise DocumentError(f"{path}: not valid JSON ({error}); write it again") from error
    if not isinstance(content, dict):
        raise DocumentError(f"{path}: holds a {type(content).__name__}, an object was expected")
    require_finite(content, str(path))
    return content


class _InertLoader(yaml.SafeLoader):
    """SafeLoader without aliases and doubled keys; also reads 1e-3 as a number, as YAML 1.2 does."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.events.AliasEvent):
            event = self.peek_event()
            raise yaml.constructor.ConstructorError(None, None, "aliases are not allowed", event.start_mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        seen = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                raise yaml.constructor.ConstructorError(None, None, f"'{key.value}' is there twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _construct_float_like(loader: yaml.SafeLoader, node: Any) -> Any:
    text = loader.construct_scalar(node)
    if node.style is not None:  # in quotes it is a text
        return text
    try:
        return float(text) if any(c.isdigit() for c in text) and "_" not in text else text
    except ValueError:
        return text


_InertLoader.add_constructor("tag:yaml.org,2002:str", _construct_float_like)


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML mapping of at most 1 MiB, without tags, aliases or non-finite numbers."""
    text = read_text(path, MAX_YAML_BYTES)
    try:
        content = yaml.load(io.StringIO(text), Loader=_InertLoader)  # noqa: S506 (a SafeLoader)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        detail = " ".join(str(error).split()) or type(error).__name__
        raise DocumentError(f"{path}: not valid YAML ({detail})") from error
    if not isinstance(content, dict):
        raise DocumentError(f"{path}: holds a {type(content).__name__}, a mapping was expected")
    require_finite(content, str(path))
    return content


def require_finite(content: Any, where: str) -> None:
    """Raise DocumentError when a number anywhere inside is NaN, infinite or too large to be computed with."""
    if isinstance(content, Mapping):
        for key, value in content.items():
            require_finite(value, f"{where}: {key}")
    elif isinstance(content, (list, tuple)):
        for value in content:
            require_finite(value, where)
    elif isinstance(content, float) and not math.isfinite(content):
        raise DocumentError(f"{where} is {content}; give a finite number")
    elif isinstance(content, int) and abs(content) > sys.float_info.max:
        raise DocumentError(f"{where} is beyond ± 1e308; give a smaller number")


def inside(folder: Path, name: str) -> Path:
    """Resolve `name` inside `folder`; raise DocumentError for a path that escapes it."""
    target = (folder / name).resolve()
    if not target.is_relative_to(folder.resolve()):
        raise DocumentError(f"{name}: leads out of {folder}; use a file inside that folder")
    return target
