"""Logs from files: tables (CSV, gzipped CSV, Parquet) and ROS 2 bags, through a layout of `conf/data/`.

Either kind becomes pieces: unbroken stretches with a base clock and every channel on its own samples. A piece is
sampled at one rate (straight lines between measurements, the previous value of commands), velocities are differentiated
where only poses are given, and the tracked point is moved to the centre of gravity. Out comes a checked `Log`.

Files may come from anybody: sizes are limited before anything is read, and every complaint is one line.
"""

import csv
import difflib
import gzip
import io
import itertools
import re
import warnings
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from racerl.data.agreement import DIFFERENTIATED, contradiction
from racerl.data.bag import Stream, is_bag, open_bag
from racerl.data.differentiate import velocities
from racerl.data.layout import COMMANDS, Layout, Source, read_layout, shipped
from racerl.data.log import (
    CHANNELS,
    JITTER,
    MOST_CUTS,
    OURS,
    POSE,
    VELOCITY,
    Log,
    complete_rows,
    run_changes,
    sample_time,
)
from racerl.data.topics import suited
from racerl.documents import as_frame, require_content
from racerl.errors import DocumentError, LogError, suggest

TABLES = (".csv", ".csv.gz", ".parquet")
MAX_BYTES = 512 * 1024 * 1024  # of a table, unpacked
MAX_HEADER_BYTES = 64 * 1024
MAX_COLUMNS = 1000
MAX_ROWS = 5_000_000
MAX_CELLS = 64_000_000  # rows times columns
BAG_RATE = 100.0  # Hz of a bag's log where the mapping names none
SLOW_POSE = 30.0  # Hz below which velocities from poses miss what a car does
CREEP, BEND = 1e-3, 1e-4  # m and rad between samples, below which nothing is told of a pose
EXACT = 1e-3  # of the way; by so little a reckoned pose leaves its heading, a measured one by its slip, lever or noise
EPOCH = 1e6  # s; later times are clock times, and counted from the first sample
SAME = 1e-6  # s within which two stamps are one; clock times are known to 2e-7 s
# a pose's sample is a spike when it lies further off the line between its neighbours than this acceleration and step,
# and a multiple of what is usual in the log, allow
SPIKES = {"x": (100.0, 0.005), "y": (100.0, 0.005), "yaw": (500.0, 0.01)}  # m/s², m; rad/s², rad
USUAL = 20.0
LOOKS = "; looks like"
TOLD, WIDEST = 8, 40  # columns that are not read, by name; characters of one
LEAP = 100.0  # m/s between two samples of a pose that no small car does
# a step of a pose is a jump, too, where it is longer than those beside it by more than this, and than cars speed up
JUMP, HARDEST = 0.05, 100.0  # m, m/s²
EVEN = 0.01  # of the sample time by which steps may differ where velocities are made from poses: 3 mm/s at 2 m/s
PAUSE = 1.0  # s without a new value, from which on a held channel is told of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Piece:
    """One unbroken stretch: its id in the file, the base clock in s and the channels on their own clocks."""

    run: Any
    t: Array
    streams: Mapping[str, Stream]


def load_logs(paths: Sequence[Path], mapping: Mapping[str, Any]) -> list[Log]:
    """Return one checked log per file, read through the composed `data` group; raise LogError or ConfigError."""
    layout = read_layout(mapping)
    return [load_log(Path(path), layout) for path in paths]


def load_given(settings: Mapping[str, Any]) -> list[Log]:
    """Return the logs that `settings["logs"]` names, read through `settings["data"]`."""
    given = settings["logs"]
    listed = given if isinstance(given, list | tuple) else [given]
    paths = [Path(str(path)) for path in listed if path not in (None, "")]
    if not paths:
        raise LogError("logs: none given; write the files of one layout, for instance drive.csv.gz")
    return load_logs(paths, settings["data"])


def load_measured(settings: Mapping[str, Any]) -> list[Log]:
    """Return the logs as `load_given`; raise LogError for poses that somebody made of wheel and steering command."""
    logs = load_given(settings)
    if reckoned := [log.name for log in logs if log.reckoned]:
        raise LogError(
            f"{', '.join(reckoned)}: the pose is reckoned from wheel and steering command and holds nothing of the "
            "tyres; record a measured one (motion capture, a particle filter); racerl data shows what the log holds"
        )
    return logs


def load_log(path: Path, layout: Layout) -> Log:
    """Read one file through a layout; raise LogError, one line, where that can't be."""
    if not path.exists():
        raise LogError(f"{path}: no such file; give a log ({', '.join(TABLES)}) or a ROS 2 bag (folder, .db3, .mcap)")
    if not path.is_dir():
        try:
            require_content(path)
        except DocumentError as error:
            raise LogError(str(error)) from error
    log = _read(path, layout)
    if layout.velocities != "auto" or log.reckoned or not (said := contradiction(log)):
        return log
    log = _read(path, replace(layout, velocities="poses"))
    line = f"its velocities {said}, so they are made from the poses; data.velocities=columns keeps them"
    return replace(log, remarks=(line, *log.remarks))


def _read(path: Path, layout: Layout) -> Log:
    if is_bag(path):
        with open_bag(path) as bag:
            layout, remarks = suited(path, bag.topics, layout)
            streams, more = bag.read(layout)
        streams = {name: streams[name] for name in _counting(streams, layout)}
        reckoned = _is_reckoned(streams)
        streams, spikes = _without_spikes(path.name, streams)
        pieces = _cut_streams(path.name, streams, layout)
        rate = min((streams[channel].rate for channel in POSE if channel in streams), default=SLOW_POSE)
        said = (*remarks, *more, *_pauses(streams), *_slow_pose(rate), *_spike_remark(spikes))
        log = _assemble(path.name, pieces, layout, layout.resample or BAG_RATE, said)
        return replace(log, reckoned=reckoned, wheelbase=layout.vehicle.wheelbase, shift=layout.shift)
    if layout.of_bag:
        raise LogError(f"{path}: is no bag, but its mapping names topics{_likely(_columns(read_table(path)))}")
    table, sources, remarks = _named(path, read_table(path), layout)
    if _as_it_is(table, layout):
        log = Log.from_table(path.name, table, remarks)
    else:
        pieces, more = _cut_table(path.name, table, sources, layout)
        log = _assemble(path.name, pieces, layout, layout.resample, (*remarks, *more))
    said = _slow_pose(1.0 / log.dt) if {*POSE} <= {*log.channels} else ()
    poses = table[["t", *(channel for channel in POSE if channel in table)]].dropna()
    clock = poses["t"].to_numpy()
    reckoned = _is_reckoned({channel: Stream(clock, poses[channel].to_numpy()) for channel in POSE if channel in poses})
    log = replace(log, remarks=(*log.remarks, *said), reckoned=reckoned)
    return replace(log, wheelbase=layout.vehicle.wheelbase, shift=layout.shift)


def read_table(path: Path) -> pd.DataFrame:
    """Read a table by its suffix; raise LogError for anything else, for a damaged file and for one too large."""
    name = path.name.lower()
    if not name.endswith(TABLES) or not path.is_file():
        raise LogError(f"{path}: is no log; allowed are {', '.join(TABLES)} and ROS 2 bags (folder, .db3, .mcap, .zip)")
    try:
        if name.endswith(".parquet"):
            return _read_parquet(path)
        return _read_csv(path, _read_gzip(path) if name.endswith(".gz") else _read_plain(path))
    except LogError:
        raise
    except (OSError, EOFError, zlib.error, ValueError, OverflowError, MemoryError, Warning, pa.ArrowException) as error:
        detail = " ".join(str(error).split())[:160] or type(error).__name__
        if ragged := re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", detail):
            told = f"line {ragged[2]} has {ragged[3]} numbers, those before it {ragged[1]}"
            raise LogError(f"{path}: {told}; mend or remove that line") from error
        raise LogError(f"{path}: cannot be read ({detail}); is the file complete?") from error


def _read_plain(path: Path) -> bytes:
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise LogError(f"{path}: {size} bytes, at most {MAX_BYTES} are read; cut the log")
    return path.read_bytes()


def _read_gzip(path: Path) -> bytes:
    with gzip.open(path) as stream:
        content = stream.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise LogError(f"{path}: more than {MAX_BYTES} bytes when unpacked; cut the log")
    return content


def _read_csv(path: Path, content: bytes) -> pd.DataFrame:
    text = _without_comments(content)
    header = text[: MAX_HEADER_BYTES + 1].split(b"\n", 1)[0]
    if len(header) > MAX_HEADER_BYTES or header.count(b",") >= MAX_COLUMNS:
        raise LogError(f"{path}: its first line is no header; at most {MAX_COLUMNS} columns are read")
    if b"\0" in text:
        raise LogError(f"{path}: holds zero bytes, so it is no text; is it another kind of file, or damaged?")
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        try:
            _require_commas(path, header.decode("utf-8-sig"))
            table = pd.read_csv(io.BytesIO(text), index_col=False, low_memory=False, skipinitialspace=True)
        except UnicodeDecodeError as error:
            raise LogError(f"{path}: is no UTF-8 text (byte {_unread(content, error)}); save it as UTF-8") from error
    return _limited(path, table)


def _without_comments(content: bytes) -> bytes:
    """Return a table's text without the lines with a # above its header, or a header that has one itself without it."""
    begin, last = 0, b""
    while content.startswith(b"#", begin) and 0 <= (end := content.find(b"\n", begin)) < MAX_HEADER_BYTES:
        begin, last = end + 1, content[begin:end]
    if last and re.match(rb"[\s\"]*[-+.\d]", content[begin : begin + WIDEST]):  # numbers already
        return last.lstrip(b"# ") + b"\n" + content[begin:]
    return content[begin:]


def _read_parquet(path: Path) -> pd.DataFrame:
    with pq.ParquetFile(path) as file:
        metadata = file.metadata
        cells = metadata.num_rows * metadata.num_columns
        size = sum(metadata.row_group(i).total_byte_size for i in range(metadata.num_row_groups))
        if cells > MAX_CELLS or metadata.num_columns > MAX_COLUMNS or size > MAX_BYTES:
            raise LogError(f"{path}: {metadata.num_rows} rows, {metadata.num_columns} columns; too large, cut the log")
        return _limited(path, as_frame(file.read(use_threads=False)))


def _require_commas(path: Path, header: str) -> None:
    """Raise LogError for other separators, and a column that is there twice, which would be renamed in silence."""
    if "," not in header and (other := next((sign for sign in ";\t" if sign in header), None)):
        sign = "';'" if other == ";" else "tabs"
        raise LogError(f"{path}: its columns are parted by {sign}; write commas between them, and points in numbers")
    cells = next(csv.reader([header], skipinitialspace=True), [])
    _require_once(path, [cell.strip() for cell in cells if cell.strip()])  # those without a name get one


def _require_once(path: Path, columns: Iterable[str]) -> None:
    """Raise LogError for a column that is there twice."""
    if doubled := [name for name, count in Counter(columns).items() if count > 1]:
        raise LogError(f"{path}: has the column '{doubled[0]}' twice; rename one")


def _unread(content: bytes, error: UnicodeDecodeError) -> int:
    """Return the first byte of a file that is no UTF-8; the error may count from a part of it."""
    try:
        content.decode()
    except UnicodeDecodeError as whole:
        return whole.start
    return error.start


def _limited(path: Path, table: pd.DataFrame) -> pd.DataFrame:
    if not 2 <= len(table) <= MAX_ROWS:
        raise LogError(f"{path}: holds {len(table)} rows; allowed are 2 … {MAX_ROWS}")
    table.columns = [str(column).strip() for column in table.columns]
    _require_once(path, table.columns)
    return table


def _columns(table: pd.DataFrame) -> list[str]:
    return [str(column) for column in table.columns]


def _likely(columns: Sequence[str]) -> str:
    """Return LOOKS data=… for the packaged mapping that fits best, else what to do."""
    best, most = "", 0
    for name, layout in shipped():
        named = [source.column for sources in layout.channels.values() for source in sources]
        fitting = sum(column in columns for column in named or CHANNELS)
        if not layout.of_bag and layout.time.column in columns and fitting > most:
            best, most = name, fitting
    return f"{LOOKS} data={best}" if best else "; write a mapping of its columns (see conf/data/dart.yaml)"


def _named(
    path: Path, table: pd.DataFrame, layout: Layout
) -> tuple[pd.DataFrame, Mapping[str, Source], tuple[str, ...]]:
    """Return the rows that count, with t, run and the channels in their units; where these are from; remarks."""
    have = _columns(table)
    if layout.time.column not in have:
        likely = _likely(have)
        near = suggest(layout.time.column, have, most=1) if not likely.startswith(LOOKS) else ""
        times = [name for name in have if re.fullmatch(r"(time|t|stamp|timestamp|sec|secs|seconds)", name.lower())]
        cure = f"; data.time.column={times[0]} takes that one" if times and not likely.startswith(LOOKS) else likely
        raise LogError(f"{path}: has no time column '{layout.time.column}'{near}{cure}")
    plain = {name: (Source(column=name, hold=name in COMMANDS),) for name in CHANNELS if name in have}
    sources = layout.channels or plain
    chosen = {name: next((s for s in several if s.column in have), None) for name, several in sources.items()}
    found = {name: source for name, source in chosen.items() if source is not None}
    if not found:
        raise LogError(f"{path}: has none of the columns that its mapping names{_likely(have)}")
    remarks = []
    for name in (name for name in chosen if name not in found):
        alike = difflib.get_close_matches(sources[name][0].column, have, n=1, cutoff=0.6) if layout.channels else []
        remarks.append(f"no column for {name}: untestable" + (f"; did you mean {alike[0]}?" if alike else ""))
    if not layout.channels:
        remarks += _passed_over(have, layout)
    found = {name: found[name] for name in _counting(found, layout)}
    keep = np.ones(len(table), dtype=bool)
    for column, value in layout.require.items():
        if column not in have:
            raise LogError(f"{path}: data.require names the column '{column}', which it lacks{suggest(column, have)}")
        flag = pd.api.types.is_bool_dtype(table[column])
        keep &= _numeric(path, table[column].astype("float64") if flag else table[column]) == value
    if not keep.all():
        remarks.append(f"{(~keep).sum()} rows left out by data.require ({', '.join(layout.require)})")
    rows = table[keep]
    if len(rows) < 2:
        raise LogError(f"{path}: data.require leaves {len(rows)} of {len(table)} rows; check its values")
    t = layout.time.scale * _seconds(path, rows[layout.time.column])
    named: dict[str, Any] = {"t": t}
    if layout.run is not None and layout.run in have:
        named["run"] = rows[layout.run].to_numpy()
    for name, source in found.items():
        values = source.convert(_numeric(path, rows[source.column]))
        if np.isfinite(values).any():
            named[name] = _going_on(values, named.get("run")) if source.hold else values
        else:
            remarks.append(f"{name} is no number in any row: untestable")
    if not any(name in CHANNELS for name in named):
        raise LogError(f"{path}: holds no number in any column that its mapping names")
    return pd.DataFrame(named), found, tuple(remarks)


def _going_on(values: Array, run: Array | None) -> Array:
    """Return a held channel whose last value counts until the next one of its run."""
    known = pd.Series(values).where(np.isfinite(values))
    return (known.ffill() if run is None else known.groupby(run, sort=False, dropna=False).ffill()).to_numpy()


def _passed_over(have: Sequence[str], layout: Layout) -> Iterator[str]:
    """Say which columns carry no channel's name, where that may be why a channel is missing."""
    plain = {name.replace("_", ""): name for name in CHANNELS if name not in have}
    read, told = {*CHANNELS, *layout.require, layout.time.column, layout.run, *OURS}, []
    for name in have:
        if name not in read:
            near = difflib.get_close_matches(re.sub(r"[\W_]", "", name.lower()), plain, n=1, cutoff=0.75)
            short = " ".join(name.split())[:WIDEST]
            told.append(f"{short} ({plain[near[0]]}?)" if near else short)
    if told and plain:
        more = f" and {len(told) - TOLD} more" if len(told) > TOLD else ""
        yield f"columns that no channel is called after are not read: {', '.join(told[:TOLD])}{more}"


def _counting(channels: Iterable[str], layout: Layout) -> list[str]:
    """Return the channels that are read: without velocities where these are made from the poses."""
    names = list(channels)
    made = layout.velocities == "poses" and set(names) >= set(POSE)
    return [name for name in names if not (made and name in VELOCITY)]


def _seconds(path: Path, column: pd.Series) -> Array:
    """Return a column of times as numbers: dates become seconds."""
    if pd.api.types.is_numeric_dtype(column):
        return _numeric(path, column)
    try:
        dates = pd.to_datetime(column, utc=True, format="ISO8601")
    except (ValueError, TypeError, OverflowError):
        return _numeric(path, column)  # which says what is wrong
    return np.where(dates.isna(), np.nan, dates.astype("datetime64[ns, UTC]").astype("int64") * 1e-9)


def _numeric(path: Path, column: pd.Series) -> Array:
    if not pd.api.types.is_numeric_dtype(column) or pd.api.types.is_bool_dtype(column):
        odd = np.flatnonzero(column.notna() & pd.to_numeric(column, errors="coerce").isna())
        where = f" (row {odd[0] + 1}: {str(column.iloc[odd[0]])[:WIDEST]!r})" if len(odd) else ""
        raise LogError(f"{path}: column '{column.name}' is not numeric{where}; is it another file or a broken line?")
    if pd.api.types.is_complex_dtype(column):
        raise LogError(f"{path}: column '{column.name}' holds complex numbers; give real ones")
    return column.to_numpy(dtype=np.float64, na_value=np.nan)


def _as_it_is(table: pd.DataFrame, layout: Layout) -> bool:
    """Return whether the rows can stand as they are: nothing to resample, move or differentiate."""
    moved = any(shift != 0.0 and name in table for name, shift in layout.shift.items())
    derived = all(name in table for name in POSE) and not all(name in table for name in VELOCITY)
    framed = any((layout.frame.forward, layout.frame.left, layout.frame.yaw))
    return not (layout.resample or moved or derived or framed or table["t"].max() > EPOCH)


def _cut_table(
    name: str, table: pd.DataFrame, sources: Mapping[str, Source], layout: Layout
) -> tuple[list[Piece], tuple[str, ...]]:
    """Cut a table at run changes, pauses, missing values and jumps back in time."""
    channels = [column for column in table if column in CHANNELS]
    complete, remarks = complete_rows(name, table)
    rows = table[complete]
    sample_time(name, rows)
    t = rows["t"].to_numpy()
    steps = np.diff(t)
    missing = np.diff(np.flatnonzero(complete)) > 1
    cut = (steps > layout.gap) | (steps <= 0) | missing
    if "run" in rows:
        cut |= run_changes(name, rows)
    if cut.mean() > MOST_CUTS:
        raise LogError(f"{name}: {cut.mean():.0%} of its steps jump in time; raise data.gap = {layout.gap:g} s?")
    values = {channel: rows[channel].to_numpy() for channel in channels}
    runs = rows["run"].to_numpy() if "run" in rows else None
    pieces, spikes = [], 0
    for start, stop in _spans(cut):
        streams = {
            c: Stream(t[start:stop] + layout.shift.get(c, 0.0), v[start:stop], sources[c].hold)
            for c, v in values.items()
        }
        streams, count = _without_spikes(name, streams)
        spikes += count
        pieces.append(Piece(None if runs is None else runs[start], t[start:stop], streams))
    return pieces, (*remarks, *_spike_remark(spikes))


def _slow_pose(rate: float) -> tuple[str, ...]:
    """Say so when poses come too seldom, so many times a second, for velocities made from them."""
    if rate >= SLOW_POSE:
        return ()
    return (f"the pose comes {rate:.0f} times per second, too seldom for the velocities made from it; 40 are needed",)


def _pauses(streams: Mapping[str, Stream]) -> Iterator[str]:
    """Say where a held channel goes without a new value for long: a car left to itself does not do what it says."""
    for channel, stream in streams.items():
        if stream.hold and (pauses := np.diff(stream.t)[np.diff(stream.t) > PAUSE]).size:
            told = f"{len(pauses)} times, {pauses.max():.1f} s at most" if len(pauses) > 1 else f"{pauses[0]:.1f} s"
            yield f"{channel} pauses ({told}); its last value is taken to hold"


def _is_reckoned(streams: Mapping[str, Stream]) -> bool:
    """Return whether the pose always moves exactly along its heading (before, after or halfway), as no car's does."""
    if not all(channel in streams and np.array_equal(streams[channel].t, streams["x"].t) for channel in POSE):
        return False
    x, y, yaw = (streams[channel].value for channel in POSE)
    dx, dy, turn = np.diff(x), np.diff(y), np.diff(np.unwrap(yaw))
    told = (np.hypot(dx, dy) > CREEP) & (np.abs(turn) > BEND)
    if told.sum() < 50:
        return False
    aside = [
        np.abs(dy * np.cos(yaw[:-1] + share * turn) - dx * np.sin(yaw[:-1] + share * turn))
        / np.hypot(dx, dy).clip(CREEP)
        for share in (0.0, 0.5, 1.0)
    ]
    return min(float(np.median(way[told])) for way in aside) < EXACT


def _spike_remark(spikes: int) -> tuple[str, ...]:
    return (f"samples that stuck out of the pose, now on the line between their neighbours: {spikes}",)[:spikes]


def _cut_streams(name: str, streams: Mapping[str, Stream], layout: Layout) -> list[Piece]:
    """Cut a bag at the pauses of its clock: the pose's stamps, or those of the first channel it has."""
    base = next((streams[channel].t for channel in POSE if channel in streams), None)
    base = next(iter(streams.values())).t if base is None else base
    if len(base) < 2:
        raise LogError(f"{name}: holds {len(base)} samples of its clock; at least two are needed")
    moved = {c: stream._replace(t=stream.t + layout.shift.get(c, 0.0)) for c, stream in streams.items()}
    return [Piece(None, base[start:stop], moved) for start, stop in _spans(np.diff(base) > layout.gap)]


def _spans(cut: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Yield (first, last + 1) of each stretch between cuts; `cut[i]` lies between rows i and i + 1."""
    edges = [0, *(np.flatnonzero(cut) + 1).tolist(), len(cut) + 1]
    yield from itertools.pairwise(edges)


def _assemble(name: str, pieces: list[Piece], layout: Layout, rate: float | None, remarks: tuple[str, ...] = ()) -> Log:
    """Sample the pieces, differentiate, move to the centre of gravity and check."""
    channels = list(pieces[0].streams)
    derive = all(channel in channels for channel in POSE) and not all(channel in channels for channel in VELOCITY)
    shortest = layout.savgol.window if derive else 2
    origin = min(float(piece.t[0]) for piece in pieces)
    said = list(remarks)
    if origin > EPOCH:
        said.append(f"t counts from {origin:.3f} s")
        pieces = [_since(origin, piece) for piece in pieces]
    pieces, leaps = _without_leaps(name, pieces, layout.gap)
    said += leaps
    if derive and not rate and (rate := _even_rate(name, pieces)):
        said.append(f"sampled at {rate:.4g} Hz, for its times are uneven and velocities are made from its poses")
    expected = sum((piece.t[-1] - piece.t[0]) * rate + 1 for piece in pieces) if rate else 0
    if expected > MAX_ROWS:
        raise LogError(f"{name}: {expected:.3g} rows at data.resample = {rate:g} Hz; at most {MAX_ROWS} are made")
    dt = 1.0 / rate if rate else _median_step(pieces)
    tables, short = [], 0
    for number, piece in enumerate(pieces):
        t = _grid(piece.t, rate) if rate else piece.t
        if len(t) < shortest:
            short += len(piece.t)
            continue
        rows = {channel: _sample(stream, t, channel, layout.gap) for channel, stream in piece.streams.items()}
        if derive:
            v = velocities(rows["x"], rows["y"], rows["yaw"], dt, layout.savgol.window, layout.savgol.order)
            rows.update({channel: value for channel, value in zip(VELOCITY, v, strict=True) if channel not in channels})
        tables.append(pd.DataFrame({"t": t, "run": number, **_to_centre(rows, layout)}))
    if not tables:
        raise LogError(f"{name}: no run has {shortest} samples; lower data.savgol.window or raise data.gap")
    if short:
        said.append(f"{short} rows left out: runs shorter than {shortest} samples")
    if derive:
        said.append(f"{DIFFERENTIATED}, Savitzky–Golay window {layout.savgol.window}")
    ids = [pieces[int(table["run"].iloc[0])].run for table in tables]
    if all(isinstance(i, int | np.integer) for i in ids) and len(set(ids)) == len(ids):
        tables = [table.assign(run=i) for table, i in zip(tables, ids, strict=True)]
    return Log.from_table(name, pd.concat(tables, ignore_index=True), tuple(said))


def _median_step(pieces: Sequence[Piece]) -> float:
    steps = np.concatenate([np.diff(piece.t) for piece in pieces])
    return float(np.median(steps)) if len(steps) else 1.0  # s


def _even_rate(name: str, pieces: Sequence[Piece]) -> float | None:
    """Return the rate in Hz to sample pieces at whose times are uneven; None where they are even.

    Raises LogError where most steps are no sample time.
    """
    dt = _median_step(pieces)
    off = np.concatenate([np.abs(np.diff(piece.t) - dt) for piece in pieces]) / dt
    if (share := float((off > JITTER).mean()) if len(off) else 0.0) > MOST_CUTS:
        raise LogError(
            f"{name}: {share:.0%} of its steps are not its usual {dt:.4g} s, and velocities are made from its poses; "
            "give the rate that it was sampled at: data.resample=50"
        )
    return 1.0 / dt if (off > EVEN).any() else None


def _since(origin: float, piece: Piece) -> Piece:
    """Return the piece with times from `origin` on, to the microsecond, which is what clock times are good for."""
    streams = {name: stream._replace(t=np.round(stream.t - origin, 6)) for name, stream in piece.streams.items()}
    return replace(piece, t=np.round(piece.t - origin, 6), streams=streams)


def _grid(t: Array, rate: float) -> Array:
    count = int(np.floor((t[-1] - t[0]) * rate + 1e-6)) + 1
    return np.asarray(t[0] + np.arange(count) / rate)


def _sample(stream: Stream, t: Array, channel: str, gap: float) -> Array:
    """Return a channel at the times t; NaN where it has no sample near enough."""
    if len(stream.t) == 0:
        return np.full(len(t), np.nan)
    if len(stream.t) == len(t) and np.array_equal(stream.t, t):
        return np.unwrap(stream.value) if channel == "yaw" else stream.value
    inside = np.clip(t, stream.t[0], stream.t[-1])
    t = np.where(np.abs(inside - t) < SAME, inside, t)
    before = np.searchsorted(stream.t, t + SAME, side="right") - 1
    if stream.hold:
        return np.where((before >= 0) & (t <= stream.t[-1] + gap), stream.value[np.maximum(before, 0)], np.nan)
    value = np.unwrap(stream.value) if channel == "yaw" else stream.value
    line = np.interp(t, stream.t, value, left=np.nan, right=np.nan)
    after = np.minimum(before + 1, len(stream.t) - 1)
    wide = stream.t[after] - stream.t[np.maximum(before, 0)] > gap
    return np.where(wide & (np.abs(stream.t[np.maximum(before, 0)] - t) > SAME), np.nan, line)


def _without_spikes(name: str, streams: Mapping[str, Stream]) -> tuple[dict[str, Stream], int]:
    """Drop single samples that stick out of a pose, as flipped bits and swapped markers make them."""
    kept, count = dict(streams), 0
    for channel, limits in SPIKES.items():
        if channel in streams and len(streams[channel].t) > 4:
            stream = streams[channel]
            keep = ~_spikes(stream.t, np.unwrap(stream.value) if channel == "yaw" else stream.value, *limits)
            kept[channel] = stream._replace(t=stream.t[keep], value=stream.value[keep])
            count += int((~keep).sum())
            if (~keep).sum() > max(3, 0.01 * len(keep)):
                raise LogError(f"{name}: {(~keep).sum()} of {len(keep)} samples of {channel} are spikes; it is damaged")
    return kept, count


def _spikes(t: Array, value: Array, acceleration: float, slack: float) -> NDArray[np.bool_]:
    before, after = np.diff(t)[:-1], np.diff(t)[1:]
    line = (value[:-2] * after + value[2:] * before) / (before + after)
    off = np.abs(value[1:-1] - line)
    limit = acceleration * before * after / 2 + slack + USUAL * float(np.median(off))
    # beside a lasting leap two samples stick out alike; beside a spike its neighbours stick out half as much
    beside = np.maximum(np.concatenate([[0.0], off[:-1]]), np.concatenate([off[1:], [0.0]]))
    return np.concatenate([[False], (off > limit) & (off > 1.5 * beside), [False]])


def _without_leaps(name: str, pieces: list[Piece], gap: float) -> tuple[list[Piece], tuple[str, ...]]:
    """Cut the pieces where the position jumps as no car does; raise LogError when that is more than an exception."""
    if not all(channel in pieces[0].streams for channel in ("x", "y")):
        return pieces, ()
    whole, leaps = [], 0
    for piece in pieces:
        x, y = (_sample(piece.streams[channel], piece.t, channel, gap) for channel in ("x", "y"))
        way, dt = np.hypot(np.diff(x), np.diff(y)), np.diff(piece.t)
        beside = np.maximum(np.concatenate([[np.inf], way[:-1]]), np.concatenate([way[1:], [np.inf]]))
        # the slack lets positions be measured by a millimetre at any rate
        leap = (way > LEAP * dt + 1e-3) | (way > beside + JUMP + HARDEST * dt**2)
        leaps += int(leap.sum())
        whole += [replace(piece, t=piece.t[start:stop]) for start, stop in _spans(leap)]
    if leaps > max(10, 0.01 * sum(len(piece.t) for piece in pieces)):
        raise LogError(
            f"{name}: the position jumps by more than {LEAP:g} m/s at {leaps} rows; is its unit another one, "
            "or the file damaged?"
        )
    return whole, (f"the position jumps at {leaps} rows; runs are split there",) if leaps else ()


def _to_centre(rows: dict[str, Array], layout: Layout) -> dict[str, Array]:
    """Move poses and velocities from the tracked point to the centre of gravity, heading first.

    With the tracked point at (a, b) in the car's frame: p_cog = p − R(ψ)(a, b), v_cog = v − r × (a, b).
    """
    a, b, turn = layout.frame.forward, layout.frame.left, layout.frame.yaw
    if not any((a, b, turn)):
        return rows
    moved = dict(rows)
    if all(channel in rows for channel in POSE):
        yaw = rows["yaw"] + turn
        moved["yaw"] = yaw
        moved["x"] = rows["x"] - (a * np.cos(yaw) - b * np.sin(yaw))
        moved["y"] = rows["y"] - (a * np.sin(yaw) + b * np.cos(yaw))
    if all(channel in rows for channel in VELOCITY):
        v_x, v_y, r = rows["v_x"], rows["v_y"], rows["yaw_rate"]
        # the measured axes are turned by −turn against the car's
        v_x, v_y = v_x * np.cos(turn) + v_y * np.sin(turn), -v_x * np.sin(turn) + v_y * np.cos(turn)
        moved["v_x"], moved["v_y"] = v_x + b * r, v_y - a * r
    return moved
