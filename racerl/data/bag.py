"""ROS 2 bags: the topics that a layout names, decoded by `rosbags` into one stream of samples per channel.

A bag is a folder, a `.db3` (sqlite3), a `.mcap`, or a `.zip` with one of these. Message definitions that a bag
carries are never used, since decoders are generated from them: types are looked up in `racerl.data.messages`.

A damaged bag must not hang or fill the memory. So sizes and counts are limited, a database is checked before it is
read, and the chunks of an MCAP file are unpacked once under a limit before the reader sees them. A third of the bags
with a flipped byte decode all the same: stamps, orientations and numbers are checked after decoding.
"""

import bisect
import contextlib
import importlib
import sqlite3
import struct
import tempfile
import time
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from racerl.data.layout import Layout, Source
from racerl.data.messages import typestore
from racerl.data.topics import Topic, found
from racerl.documents import read_yaml, require_content
from racerl.errors import DocumentError, LogError, RacerlError, suggest

STORAGES = (".db3", ".mcap")
MAX_BYTES = 4 * 1024**3  # of a bag's storage files together
MAX_UNPACKED = 1024**3  # of a zip
MAX_RATIO, SMALL = 200, 16 * 1024**2  # of its size, by which a zip that is not small may grow
MAX_CHUNK = 256 * 1024**2  # of an MCAP chunk, unpacked
MAX_FILES = 64
MAX_MESSAGES = 5_000_000
MAX_MESSAGE_BYTES = 1024**2
MAX_CHECK_S = 60.0  # for the check of a database
BAD_SHARE = 0.01  # of a channel's samples that may be implausible before the bag counts as damaged
NORM = 0.02  # by which an orientation's length may differ from one
CLOCK = 3600.0  # s that a message's own stamp may differ from the bag's, relative to their median difference


class Stream(NamedTuple):
    """One channel on its own clock: stamps in s, increasing, and values."""

    t: NDArray[np.float64]
    value: NDArray[np.float64]
    hold: bool = False

    @property
    def rate(self) -> float:
        """Samples per second, pauses left out; 0 for a single one."""
        steps = np.diff(self.t)
        return 1.0 / float(np.mean(steps[steps < 5.0 * np.median(steps)])) if len(steps) else 0.0


def is_bag(path: Path) -> bool:
    """Return whether a path is to be read as a bag."""
    return path.is_dir() or path.suffix.lower() in (*STORAGES, ".zip")


@dataclass(frozen=True)
class Bag:
    """A bag whose storage has been checked, open to be read."""

    path: Path
    files: tuple[Path, ...]
    topics: tuple[Topic, ...]

    def read(self, layout: Layout) -> tuple[dict[str, Stream], tuple[str, ...]]:
        """Return the layout's channels that the bag has, and remarks."""
        return _decode(self, layout)


@contextlib.contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag; raise LogError, one line, for a damaged one, also while it is read."""
    with contextlib.ExitStack() as stack:
        files = tuple(file for file in _storage_files(path, stack) if _check_storage(path, file))
        try:
            files = tuple(sorted(files, key=_begin))  # names do not tell: bag_10 comes before bag_2
            yield Bag(path, files, _topics(files))
        except RacerlError:
            raise
        except MemoryError as error:
            raise LogError(f"{path}: does not fit into memory; cut the bag") from error
        except Exception as error:  # on damaged bytes the decoder may raise anything
            detail = " ".join(str(error).split())[:160] or type(error).__name__
            raise LogError(f"{path}: cannot be decoded ({detail}); is the bag complete?") from error


def _begin(file: Path) -> int:
    """Return when the first message of a storage file was received, in ns."""
    from rosbags.rosbag2 import Reader

    with Reader(file) as reader:
        return int(reader.start_time)


def _topics(files: tuple[Path, ...]) -> tuple[Topic, ...]:
    """Return the topics of all files together, by name."""
    from rosbags.rosbag2 import Reader

    counts: dict[tuple[str, str], int] = {}
    for file in files:
        with Reader(file) as reader:
            for connection in reader.connections:
                key = (connection.topic, connection.msgtype)
                counts[key] = counts.get(key, 0) + connection.msgcount
    return tuple(Topic(*key, count) for key, count in sorted(counts.items()))


def _storage_files(path: Path, stack: contextlib.ExitStack) -> list[Path]:
    if path.suffix.lower() == ".zip" and path.is_file():
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="racerl-bag-")))
        _unpack(path, folder)
    else:
        folder = path
    if folder.is_dir():
        files = sorted(file for file in folder.iterdir() if file.suffix.lower() in STORAGES and file.is_file())
        _check_metadata(path, folder)
    else:
        files = [folder]
    if not files and (tables := sorted(path.glob("*.parquet"))):
        raise LogError(f"{path}: is a folder without .db3 or .mcap files; give the log in it, as {tables[0]}")
    if not 1 <= len(files) <= MAX_FILES:
        raise LogError(f"{path}: holds {len(files)} .db3 or .mcap files; a bag has 1 … {MAX_FILES}")
    size = sum(file.stat().st_size for file in files)
    if size > MAX_BYTES:
        raise LogError(f"{path}: {size} bytes, at most {MAX_BYTES} are read; split the bag")
    return files


def _unpack(path: Path, folder: Path) -> None:
    """Unpack the storage files and the metadata of a zip, by their bare names, under a limit."""
    try:
        most = left = min(MAX_UNPACKED, max(SMALL, MAX_RATIO * path.stat().st_size))
        with zipfile.ZipFile(path) as archive:
            wanted = [m for m in archive.infolist() if m.filename.lower().endswith((*STORAGES, "metadata.yaml"))]
            names = [Path(member.filename.replace("\\", "/")).name for member in wanted]
            if not wanted or len(wanted) > MAX_FILES or len(set(names)) < len(names):
                raise LogError(f"{path}: holds {len(wanted)} files of bags; a zip of one bag is read")
            for member, name in zip(wanted, names, strict=True):
                with archive.open(member) as source, (folder / name).open("wb") as target:
                    while block := source.read(min(left + 1, 1 << 20)):
                        left -= len(block)
                        if left < 0:
                            raise LogError(f"{path}: more than {most} bytes when unpacked; split the bag")
                        target.write(block)
    except LogError:
        raise
    except OSError as error:
        raise LogError(f"{path}: cannot be unpacked ({error.strerror or error}); is it complete?") from error
    except Exception as error:  # zipfile raises struct, zlib, unicode, runtime and its own errors on damaged bytes
        raise LogError(f"{path}: is a damaged zip ({' '.join(str(error).split())[:120]}); copy it again") from error


def _check_metadata(path: Path, folder: Path) -> None:
    """Raise LogError when the bag says it is compressed; its other facts are read from the storage itself."""
    if not (folder / "metadata.yaml").is_file():
        return
    try:
        facts = read_yaml(folder / "metadata.yaml").get("rosbag2_bagfile_information")
    except DocumentError:
        return
    mode = str(facts.get("compression_mode") or "none").lower() if isinstance(facts, Mapping) else "none"
    if mode != "none":
        raise LogError(f"{path}: is compressed by {mode}; convert it first: ros2 bag convert, without compression")


def _check_storage(path: Path, file: Path) -> bool:
    """Raise LogError for a storage file that is damaged or would not fit; return True."""
    try:
        require_content(file)
        if file.suffix.lower() == ".db3":
            _check_database(path, file)
        else:
            _check_mcap(path, file)
    except LogError:
        raise
    except DocumentError as error:
        raise LogError(str(error)) from error
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror or error}); check the path") from error
    except Exception as error:  # struct, sqlite3, lz4 and zstd errors
        detail = " ".join(str(error).split())[:120] or type(error).__name__
        raise LogError(f"{path}: is damaged ({detail}); copy it again") from error
    return True


def _check_database(path: Path, file: Path) -> None:
    deadline = time.monotonic() + MAX_CHECK_S
    with contextlib.closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        database.set_progress_handler(lambda: time.monotonic() > deadline, 100_000)
        verdict = database.execute("PRAGMA quick_check(1)").fetchone()[0]
        if verdict != "ok":
            raise LogError(f"{path}: is damaged ({' '.join(str(verdict).split())[:120]}); copy it again")
        count, longest = database.execute("SELECT count(*), max(length(data)) FROM messages").fetchone()
        texts = database.execute("SELECT count(*), max(length(name)) FROM topics").fetchone()
    if count > 20 * MAX_MESSAGES or (longest or 0) > MAX_CHUNK or texts[0] > 10_000 or (texts[1] or 0) > 10_000:
        raise LogError(f"{path}: {count} messages of up to {longest} bytes; too many, split the bag")


def _check_mcap(path: Path, file: Path) -> None:
    """Walk the records of an MCAP file: opcode (1 byte), length (8), content; unpack each chunk under a limit."""
    size, total, indexed = file.stat().st_size, 0, set()
    with file.open("rb") as stream:
        whole, begin = stream.read(8) == b"\x89MCAP0\r\n", 0
        while whole:
            begin, head = stream.tell(), stream.read(9)
            if head[:1] == b"\x02":  # footer
                return
            if len(head) < 9:
                break
            length = int.from_bytes(head[1:], "little")
            if length > size - stream.tell():
                break
            if head[0] == 0x06:
                total += _chunk_size(path, stream.read(length))
            elif head[0] == 0x08:
                start = stream.read(24)[16:]
                if start in indexed:
                    raise LogError(f"{path}: its index names a chunk twice, so it is damaged; copy it again")
                indexed.add(start)
                stream.seek(length - 24, 1)
            else:
                if head[0] in (0x03, 0x04) and length > MAX_MESSAGE_BYTES:
                    break
                stream.seek(length, 1)
            if total > MAX_BYTES:
                raise LogError(f"{path}: more than {MAX_BYTES} bytes when unpacked; split the bag")
    told = f"is cut short or damaged at byte {begin}"
    raise LogError(f"{path}: {told}; copy it again, or where its recorder was cut off: mcap recover {file.name}")


def _chunk_size(path: Path, content: bytes) -> int:
    """Return a chunk's size; raise LogError when it is not what the chunk says or beyond the limit."""
    # start and end time (8, 8), size unpacked (8), checksum (4), compression (4 + n), size packed (8), records
    size, _, named = struct.unpack_from("<QII", content, 16)
    if size > MAX_CHUNK:
        raise LogError(f"{path}: a chunk of {size} bytes, at most {MAX_CHUNK} are read; write smaller chunks")
    compression, records = content[32 : 32 + named], content[40 + named :]
    if compression == b"zstd":
        zstd = _zstd()
        unpacked = len(zstd.ZstdDecompressor().decompress(records, max_length=size + 1))
    elif compression == b"lz4":
        import lz4.frame

        unpacked = len(lz4.frame.LZ4FrameDecompressor().decompress(records, max_length=size + 1))
    else:
        unpacked = len(records)
    if unpacked != size:
        raise LogError(f"{path}: a chunk unpacks to {unpacked} bytes instead of {size}; the file is damaged")
    return int(size)


def _zstd() -> Any:
    try:
        return importlib.import_module("compression.zstd")  # Python 3.14
    except ImportError:
        return importlib.import_module("backports.zstd")


class _Samples:
    """What has been decoded of one topic: stamps and, per channel, values."""

    def __init__(self, sources: Mapping[str, Source]) -> None:
        self.sources = sources
        self.received: list[float] = []
        self.stamped: list[float] = []
        self.values: dict[str, list[float]] = {channel: [] for channel in sources}


def _decode(bag: Bag, layout: Layout) -> tuple[dict[str, Stream], tuple[str, ...]]:
    from rosbags.rosbag2 import Reader

    path = bag.path
    chosen, remarks = _choose(bag, layout)
    for file in bag.files:
        with Reader(file) as reader:
            wanted = [connection for connection in reader.connections if connection.topic in chosen]
            count = sum(connection.msgcount for connection in wanted)
            if count > MAX_MESSAGES:
                raise LogError(f"{path}: {count} messages on the mapped topics, at most {MAX_MESSAGES}; split the bag")
            for connection, received, raw in _bounded(path, reader.messages(wanted) if wanted else iter(())):
                _append(path, chosen[connection.topic], connection, received, raw)
    streams: dict[str, Stream] = {}
    sources = []
    for topic, samples in chosen.items():
        fresh = dict(_streams(path, topic, samples, layout.time.stamp, remarks))
        streams |= fresh
        sources += [_source(topic, fresh)] if fresh else []
    if not streams:
        raise LogError(f"{path}: its mapped topics hold no message")
    ordered = {channel: streams[channel] for channel in layout.channels if channel in streams}
    return ordered, (f"from {'; '.join(sources)}", *remarks)


def _source(topic: str, streams: Mapping[str, Stream]) -> str:
    """Return which channels a topic gives, and how often."""
    return f"{topic} at {next(iter(streams.values())).rate:.0f} Hz: {', '.join(streams)}"


def _bounded(path: Path, messages: Iterator[Any]) -> Iterator[Any]:
    for number, message in enumerate(messages):
        if number >= MAX_MESSAGES:
            raise LogError(f"{path}: more than {MAX_MESSAGES} messages on the mapped topics; split the bag")
        yield message


def _choose(bag: Bag, layout: Layout) -> tuple[dict[str, _Samples], list[str]]:
    """Return the topics to read, each with the channels it feeds; raise LogError for types that are not known."""
    sources, kinds = found(layout, bag.topics), {topic.name: topic.kind for topic in bag.topics}
    topics: dict[str, dict[str, Source]] = {}
    for channel, source in sources.items():
        topics.setdefault(source.topic, {})[channel] = source
    for topic in topics:
        if kinds[topic] not in typestore().fielddefs:
            raise LogError(f"{bag.path}: {topic} is of the type {kinds[topic]}, which is not known here; leave it out")
    remarks = [f"no topic for {channel}: untestable" for channel in layout.channels if channel not in sources]
    return {topic: _Samples(channels) for topic, channels in topics.items()}, remarks


def _append(path: Path, samples: _Samples, connection: Any, received: int, raw: bytes) -> None:
    if len(raw) > MAX_MESSAGE_BYTES:
        raise LogError(f"{path}: a message of {len(raw)} bytes on {connection.topic}; the bag is damaged")
    message = typestore().deserialize_cdr(raw, connection.msgtype)
    samples.received.append(received * 1e-9)
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    # many a node publishes its commands with an empty stamp
    stamped = stamp.sec + stamp.nanosec * 1e-9 if stamp is not None else 0.0
    samples.stamped.append(stamped or received * 1e-9)
    for channel, source in samples.sources.items():
        samples.values[channel].append(_number(path, message, channel, source))


def _number(path: Path, message: Any, channel: str, source: Source) -> float:
    """Return a message's field as a number; an orientation gives the heading, NaN when it is none."""
    value = message
    for name in source.field.split("."):
        if name.startswith("_") or not hasattr(value, name):
            known = [key for key in getattr(value, "__dataclass_fields__", {}) if not key.startswith("_")]
            raise LogError(f"{path}: {source.topic} has no field '{source.field}' ('{name}'){suggest(name, known)}")
        value = getattr(value, name)
    if all(hasattr(value, axis) for axis in "xyzw"):
        x, y, z, w = value.x, value.y, value.z, value.w
        if not abs((x * x + y * y + z * z + w * w) ** 0.5 - 1.0) < NORM:
            return float("nan")
        return float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise LogError(f"{path}: {source.topic}, field '{source.field}' for {channel} is no number; name a deeper one")
    return float(value)


def _in_order(t: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the most stamps that never fall, (K,): what lies before or beyond its neighbours is damaged."""
    if (np.diff(t) >= 0).all():
        return np.arange(len(t))
    last: list[float] = []  # the lowest stamp that a sequence of each length can end with
    at: list[int] = []
    before = np.full(len(t), -1)
    for i, stamp in enumerate(t.tolist()):
        place = bisect.bisect_right(last, stamp)
        before[i] = at[place - 1] if place else -1
        last[place : place + 1], at[place : place + 1] = [stamp], [i]
    kept = [at[-1]]
    while before[kept[-1]] >= 0:
        kept.append(int(before[kept[-1]]))
    return np.array(kept[::-1])


def _streams(path: Path, topic: str, samples: _Samples, stamp: str, remarks: list[str]) -> Iterator[tuple[str, Stream]]:
    """Yield the channels of a topic, checked: stamps of one clock and increasing, finite values."""
    received, t = np.array(samples.received), np.array(samples.stamped if stamp == "header" else samples.received)
    if not len(t):
        remarks.append(f"{topic} holds no message: untestable")
        return
    with np.errstate(all="ignore"):
        values = {c: samples.sources[c].convert(np.array(raw)) for c, raw in samples.values.items()}
        empty = [channel for channel, value in values.items() if np.isnan(value).all()]
        remarks += [f"{channel} on {topic} is no number in any message: untestable" for channel in empty]
        values = {channel: value for channel, value in values.items() if channel not in empty}
        late = t - received
        good = np.isfinite(t) & (np.abs(late - np.median(late)) < CLOCK)
        for value in values.values():
            good &= np.isfinite(value)
    order = np.flatnonzero(good)
    order = order[_in_order(t[order])]
    bad = len(t) - len(order)
    order = order[np.diff(t[order], prepend=-np.inf) > 0]  # of the same stamp the first counts
    if bad > max(1.0, BAD_SHARE * len(t)):
        raise LogError(
            f"{path}: {bad} of {len(t)} messages on {topic} have an impossible stamp, orientation or number; "
            "the bag is damaged, or its stamps are: data.time.stamp=received"
        )
    if bad:
        remarks.append(f"{bad} of {len(t)} messages on {topic} left out: impossible stamp, orientation or number")
    for channel, value in values.items():
        yield channel, Stream(t[order], value[order], samples.sources[channel].hold)
