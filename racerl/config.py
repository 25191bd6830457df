"""Configurations: Hydra composes `conf/`, and what it composes leaves here as a plain mapping.

A `./conf` beside the user shadows the packaged files. Overrides are Hydra's, with three conveniences: `+dr=X` and
`dr=X` mean the same, `track=` and `vehicle=` also take a file, and a run folder may be given without its key.
"""

import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra import main as hydra_main
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.plugins import Plugins
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from racerl.assemble import build_race, conf_folder
from racerl.documents import read_yaml, require_finite
from racerl.env.adapters.gymnasium import RaceEnv, RaceVectorEnv
from racerl.errors import ConfigError, DocumentError, suggest

VERSION_BASE = "1.3"
FILE_GROUPS = {"track": (".csv", ".yaml", ".yml"), "vehicle": (".yaml", ".yml"), "controller": (".yaml", ".yml")}
VALUED = ("--cfg", "-c", "--info", "-i", "--package", "-p", "--config-dir", "-cd", "--config-name", "-cn")
OPTIONS = (*VALUED, "--multirun", "-m", "--resolve", "--hydra-help", "--help")
Settings = dict[str, Any]


class _UserFolder(SearchPathPlugin):
    """Puts ./conf before the packaged configurations."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        user = Path("conf").resolve()
        if user.is_dir() and user != conf_folder().resolve():
            _check_user_files(user)
            search_path.prepend("user", f"file://{user}")


def _check_user_files(folder: Path) -> None:
    """Raise ConfigError for a configuration that could make Hydra itself call something."""
    for path in sorted([*folder.rglob("*.yaml"), *folder.rglob("*.yml")]):
        try:
            content = read_yaml(path)
        except DocumentError as error:
            raise ConfigError(str(error)) from error
        keys = {key.rsplit(".", 1)[-1] for key in _keys(content)}
        if "_target_" in keys:
            raise ConfigError(f"{path}: holds the key '_target_', which names code to run; remove it")


def run_command(
    command: str, arguments: Sequence[str], task: Callable[[Settings, Path], None], positional: str | None = None
) -> None:
    """Compose `conf/<command>.yaml` with the user's arguments and call task(settings, output folder).

    Hydra's own options work (`--cfg job`, `-m`, `--info`). `positional` names the key that bare arguments fill: a
    folder, or a list of folders when it ends with "s". Raises ConfigError, in one line, for anything mistyped.
    """
    overrides = _rewrite(command, arguments, positional)

    failures: list[Exception] = []

    def job(config: DictConfig) -> None:
        out = _shortest(Path(HydraConfig.get().runtime.output_dir))
        try:
            settings = _plain(config)
            _check_keys(command, settings)
            task(settings, out)
        except Exception as error:  # raised below: Hydra would print its own lines about it
            failures.append(error)
        finally:
            if out.is_dir() and not any(out.iterdir()):
                out.rmdir()

    _register()
    os.environ["HYDRA_FULL_ERROR"] = "1"  # let exceptions through to us
    sys.argv = [f"racerl {command}", *overrides]
    try:
        hydra_main(str(conf_folder()), command, VERSION_BASE)(job)()
    except (HydraException, OmegaConfBaseException) as error:
        raise _translate(command, error) from error
    if failures:
        raise failures[0]


def _shortest(path: Path) -> Path:
    """Return the path relative to the working directory when it lies inside."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def compose_settings(command: str, overrides: Sequence[str] = ()) -> Settings:
    """Return the composed settings of a command, for use from Python."""
    _register()
    try:
        settings = _plain(_compose(command, _rewrite(command, list(overrides), None)))
    except (HydraException, OmegaConfBaseException) as error:
        raise _translate(command, error) from error
    _check_keys(command, settings)
    return settings


def make_env(overrides: Sequence[str] = (), seed: int = 0) -> RaceEnv:
    """Return one car as a Gymnasium environment, with the overrides of `racerl train`."""
    return RaceEnv(build_race(compose_settings("train", overrides), cars=1, seeds=[seed]))


def make_vector_env(num_envs: int = 1, overrides: Sequence[str] = (), seed: int = 0) -> RaceVectorEnv:
    """Return a batch of cars as a Gymnasium vector environment, with the overrides of `racerl train`."""
    return RaceVectorEnv(build_race(compose_settings("train", overrides), cars=num_envs, seeds=[seed]))


def _compose(command: str, overrides: list[str]) -> DictConfig:
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(conf_folder()), version_base=VERSION_BASE):
        return compose(command, overrides)


def _register() -> None:
    Plugins.instance().register(_UserFolder)


def _plain(config: DictConfig) -> Settings:
    missing = sorted(str(key) for key in OmegaConf.missing_keys(config))
    if missing:
        raise ConfigError(f"{missing[0]} is missing; give {missing[0]}=…")
    settings: Settings = OmegaConf.to_container(config, resolve=True)  # type: ignore[assignment]
    try:
        require_finite(settings, "config")
    except DocumentError as error:
        raise ConfigError(str(error).removeprefix("config: ")) from error
    return settings


def _rewrite(command: str, arguments: Sequence[str], positional: str | None) -> list[str]:
    """Turn the user's words into Hydra's."""
    overrides, bare = [], []
    groups = set(default_groups(command))
    words = iter(arguments)
    for word in words:
        if word.startswith("-"):
            if word.split("=")[0] not in OPTIONS:
                raise ConfigError(f"unknown option '{word}'{suggest(word, OPTIONS)}")
            overrides.append(word)
            if word.startswith("--config-dir="):
                _check_user_files(Path(word.partition("=")[2]))
            if word in VALUED:
                value = next(words, None)
                overrides += [] if value is None else [value]
                if word in ("--config-dir", "-cd") and value:
                    _check_user_files(Path(value))
        elif positional and not word.startswith("~") and ("=" not in word or Path(word).is_dir()):
            bare.append(word)
        elif "=" not in word and not word.startswith("~"):
            raise ConfigError(f"'{word}' is no override; write key=value, for instance dr=friction_0.02")
        else:
            overrides += _rewrite_override(word, groups)
    if bare and positional:
        overrides.append(_bare_override(positional, bare))
    return overrides


def _rewrite_override(word: str, groups: set[str]) -> Iterator[str]:
    key, _, value = word.partition("=")
    group = key.lstrip("+")
    if group in groups and value == "null":
        raise ConfigError(f"{word}: a choice of conf/{group} is expected; leave the word out for the usual one")
    if group in FILE_GROUPS and value.lower().endswith(FILE_GROUPS[group]):
        yield f"{group}=file"
        yield f"{group}.file={quote(value)}"
    else:
        yield word.lstrip("+") if group in groups else word


def _bare_override(positional: str, bare: list[str]) -> str:
    if positional.endswith("s"):
        return f"{positional}=[{','.join(quote(word) for word in bare)}]"
    if len(bare) > 1:
        raise ConfigError(f"{' '.join(bare)}: one {positional} is expected; the rest as key=value")
    return f"{positional}={quote(bare[0])}"


def quote(value: str) -> str:
    """Return a word in quotes that Hydra reads back as it is."""
    return "'" + value.replace("\\", "\\\\").replace("'", "\\'") + "'"


def default_groups(command: str) -> list[str]:
    """Return the groups that a command's configuration chooses from."""
    entries = read_yaml(conf_folder() / f"{command}.yaml").get("defaults", [])
    names = [next(iter(entry)) for entry in entries if isinstance(entry, Mapping)]
    return [name for name in names if not name.startswith("override ")]


def own_keys(command: str) -> set[str]:
    """Return the groups and keys that a command's configuration has."""
    base = read_yaml(conf_folder() / f"{command}.yaml")
    return {*default_groups(command), *(key for key in base if key != "defaults")} - {"hydra"}


def _check_keys(command: str, settings: Settings) -> None:
    """Raise ConfigError for keys that a `+` or `~` override added or took away."""
    base, known = read_yaml(conf_folder() / f"{command}.yaml"), own_keys(command)
    for key in settings:
        if key not in known:
            raise ConfigError(f"unknown key '{key}'{suggest(key, known)}")
    optional = {next(iter(e)) for e in base["defaults"] if isinstance(e, Mapping) and next(iter(e.values())) is None}
    for key in sorted(known - set(settings) - optional):
        raise ConfigError(f"{key} was removed; it is needed, give {key}=…")


def _keys(settings: Any, prefix: str = "") -> Iterator[str]:
    """Yield every key inside, dotted; lists are looked through."""
    if isinstance(settings, Mapping):
        for key, value in settings.items():
            yield f"{prefix}{key}"
            yield from _keys(value, f"{prefix}{key}.")
    elif isinstance(settings, list):
        for value in settings:
            yield from _keys(value, prefix)


def _translate(command: str, error: Exception) -> ConfigError:
    """Return Hydra's complaint as one line with the near choices."""
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        group, _, choice = error.missing_cfg_file.rpartition("/")
        return ConfigError(f"unknown {group or 'config'} '{choice}'{suggest(choice, error.options or [])}")
    if isinstance(error, OverrideParseException):
        return ConfigError(f"cannot read '{error.override}'; write key=value, with quotes around special characters")
    text = " ".join(str(error).split())
    key = re.search(
        r"(?:Could not override|Could not delete from config|Could not append to config)[^']*'([^']+)'", text
    )
    if key:
        known = [*_keys(OmegaConf.to_container(_compose(command, []), resolve=False)), *default_groups(command)]
        return ConfigError(f"unknown key '{key[1]}'{suggest(key[1], known)}")
    return ConfigError(text)
