"""What conf/ offers: the groups and keys of a command, the choices of a group.

Reads files alone, so that completion and errors need not compose anything.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from racerl.documents import conf_folder, read_yaml


def default_groups(command: str) -> list[str]:
    """Return the groups that a command's configuration chooses from."""
    entries = read_yaml(conf_folder() / f"{command}.yaml").get("defaults", [])
    names = [next(iter(entry)) for entry in entries if isinstance(entry, Mapping)]
    return [name for name in names if not name.startswith("override ") and name != "hydra"]


def optional_groups(command: str) -> set[str]:
    """Return the groups that a command takes from elsewhere where none is chosen."""
    defaults = read_yaml(conf_folder() / f"{command}.yaml").get("defaults", [])
    return {name for e in defaults if isinstance(e, Mapping) for name, choice in e.items() if choice is None}


def own_keys(command: str) -> set[str]:
    """Return the groups and keys that a command's configuration has."""
    base = read_yaml(conf_folder() / f"{command}.yaml")
    return {*default_groups(command), *(key for key in base if key != "defaults")}


def choices(group: str) -> list[str]:
    """Return the names in a group, those of a ./conf here included; a group that stands for files has none of them."""
    return sorted({path.stem for folder in _folders(group) for path in folder.glob("*.yaml")} - {"file"})


def read_choice(group: str, name: str) -> dict[str, Any]:
    """Return what the file of one of a group's `choices` says, that in ./conf before the packaged one."""
    return read_yaml(next(file for folder in _folders(group) if (file := folder / f"{name}.yaml").is_file()))


def _folders(group: str) -> tuple[Path, Path]:
    return Path("conf") / group, conf_folder() / group
