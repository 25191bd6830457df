"""Which file of a folder is the track: of a map set (`NAME_map.yaml`, its image, `NAME_centerline.csv`) the map."""

from pathlib import Path

from racerl.documents import read_yaml
from racerl.errors import ConfigError, DocumentError

SUFFIXES = (".csv", ".yaml", ".yml")
OTHERS = "others"  # track.others: further tracks, over which the cars of a training are spread, too
ALLOWED = "a centreline .csv, a map .yaml, or a folder that holds one"


def track_file(path: Path) -> Path:
    """Return the file that is the track, of a file or a folder; raise ConfigError where there is none, or several."""
    try:
        if path.is_dir():
            return _file_in(path)
        there = path.is_file()
    except OSError as error:  # too long to be a path
        raise ConfigError(f"{str(path)[:80]}: cannot be a file ({error.strerror}); give {ALLOWED}") from error
    if not there:
        raise ConfigError(f"{path}: no such file or folder in {Path.cwd()}; give {ALLOWED}")
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"{path}: is no track; give {ALLOWED}")
    return path


def _file_in(folder: Path) -> Path:
    tables = sorted(folder.glob("*.csv"))
    centrelines = [table for table in tables if "centerline" in table.name or "centreline" in table.name]
    maps = [file for file in sorted([*folder.glob("*.yaml"), *folder.glob("*.yml")]) if _is_map(file)]
    found = maps or centrelines or tables
    if not found:
        raise ConfigError(f"{folder}: holds no track; give {ALLOWED}")
    if len(found) > 1:
        raise ConfigError(
            f"{folder}: holds several tracks ({', '.join(file.name for file in found)}); give one of them"
        )
    return found[0]


def _is_map(file: Path) -> bool:
    try:
        return "image" in read_yaml(file)
    except DocumentError:
        return False
