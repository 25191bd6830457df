"""Configurations: Hydra composes `conf/`, and what it composes leaves here as a plain mapping.

A `./conf` beside the user shadows the packaged files. Overrides are Hydra's, with some conveniences: `+dr=X` and
`dr=X` mean the same, `track=` and `vehicle=` also take a file, `dr=posterior:RUN` takes a run, and a run folder may be
given without its key.
"""

import difflib
import json
import os
import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

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

from racerl.choices import choices, default_groups, optional_groups, own_keys, read_choice
from racerl.documents import conf_folder, read_yaml, require_finite
from racerl.errors import ConfigError, DocumentError, suggest
from racerl.run import WORDS
from racerl.track.folder import OTHERS, track_file

if TYPE_CHECKING:
    from racerl.env.adapters.gymnasium import RaceEnv, RaceVectorEnv

VERSION_BASE = "1.3"
LOG_ENDINGS = (".csv", ".csv.gz", ".parquet", ".db3", ".mcap", ".zip")
PLACES = ("out", "from", "run", "real")  # keys of one file or folder
MAPPING = "data"  # the group of which a file need not name every key
FILE_GROUPS = {"track": (".csv", ".yaml", ".yml"), "vehicle": (".yaml", ".yml"), "controller": (".yaml", ".yml")}
# where the words are others
SPOKEN = {"race": "evaluate", "refine": "train", "compare": "report compare", "close": "gap close"}
# keys that must be given, as a user gives them
ASKED = {
    "logs": "LOG…",
    "run": "RUN",
    "real": "LOG… real=FILE",
    "name": "SWEEP",
    "from": "from=RUN",
    "dr.cars": "dr=posterior:RUN",
}
PATHS = {  # positional keys that name files or folders, and what is allowed
    "logs": "drive logs: CSV, Parquet or a bag",
    "run": "a training run; for evaluate also a drive log, a raceline, paper:rl or paper:human, for export a vehicle",
    "runs": "finished runs",
    "drivers": "finished evaluate, drive or train runs, paper:rl or paper:human",
}
PARTS = {  # commands of two words, by the second, that a word beside such a key may be meant for
    "logs": {"close": "gap close", "plan": "gap plan"},
    "runs": {"compare": "report compare"},
}
POSTERIOR = "posterior:"  # in front of a run, as dr=posterior:RUN
PAPER = "paper:"  # in place of a path: the paper's own laps
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
    token = WORDS.set(tuple(arguments))

    def job(config: DictConfig) -> None:
        out = _shortest(Path(HydraConfig.get().runtime.output_dir))
        try:
            settings = _plain(command, config)
            _check_values(command, settings, list(HydraConfig.get().overrides.task))
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
    except (HydraException, OmegaConfBaseException, ValueError) as error:  # ValueError: options that exclude each other
        raise _translate(command, error) from error
    finally:
        WORDS.reset(token)
    if failures:
        raise failures[0]


def _shortest(path: Path) -> Path:
    """Return the path relative to the working directory when it lies inside."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def compose_settings(
    command: str, overrides: Sequence[str] = (), places: Mapping[str, Sequence[str]] | None = None
) -> Settings:
    """Return the composed settings of a command, for use from Python; `places` are files or folders by their key."""
    _register()
    words = _rewrite(command, list(overrides), None)
    words += [_bare_override(key, list(named)) for key, named in (places or {}).items()]
    try:
        settings = _plain(command, _compose(command, words))
    except (HydraException, OmegaConfBaseException, ValueError) as error:  # ValueError: a name where a list has numbers
        raise _translate(command, error) from error
    _check_values(command, settings, words)
    return settings


def composed(command: str) -> str:
    """Return all settings of a command, as `--cfg job` prints them."""
    _register()
    return OmegaConf.to_yaml(_compose(command, []))


def make_env(overrides: Sequence[str] = (), seed: int = 0) -> "RaceEnv":
    """Return one car as a Gymnasium environment, with the overrides of `racerl train` but several tracks."""
    from racerl.assemble import build_race
    from racerl.env.adapters.gymnasium import RaceEnv

    return RaceEnv(build_race(_of_one_track(overrides), cars=1, seeds=[seed]))


def make_vector_env(num_envs: int = 1, overrides: Sequence[str] = (), seed: int = 0) -> "RaceVectorEnv":
    """Return cars as a Gymnasium vector environment, with the overrides of `racerl train` but several tracks."""
    from racerl.assemble import build_race
    from racerl.env.adapters.gymnasium import RaceVectorEnv

    return RaceVectorEnv(build_race(_of_one_track(overrides), cars=num_envs, seeds=[seed]))


def _of_one_track(overrides: Sequence[str]) -> Settings:
    """Return the settings of `racerl train`; raise ConfigError for several tracks."""
    settings = compose_settings("train", overrides)
    if settings["track"].get(OTHERS):
        raise ConfigError("track=[…]: an environment has one track; make one for each")
    return settings


def _compose(command: str, overrides: Sequence[str]) -> DictConfig:
    """Return what Hydra composes, to be read only: the same words are composed once, until a file changes."""
    folders = {Path("conf").resolve(), conf_folder()}
    files = sorted(path for folder in folders for path in folder.rglob("*.y*ml") if path.is_file())
    found = _composed(command, tuple(overrides), tuple((str(path), path.stat().st_mtime_ns) for path in files))
    OmegaConf.clear_cache(found)  # of the time, which names output folders
    return found


@lru_cache(maxsize=256)
def _composed(command: str, overrides: tuple[str, ...], files: tuple[tuple[str, int], ...]) -> DictConfig:
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(conf_folder()), version_base=VERSION_BASE):
        return compose(command, list(overrides))


def _register() -> None:
    Plugins.instance().register(_UserFolder)


def spoken(command: str) -> str:
    """Return a command as a user types it."""
    return f"racerl {SPOKEN.get(command, command)}"


def _plain(command: str, config: DictConfig) -> Settings:
    if missing := sorted(str(key) for key in OmegaConf.missing_keys(config)):
        asked = f"write {spoken(command)} {ASKED[missing[0]]}" if missing[0] in ASKED else f"give {missing[0]}=…"
        raise ConfigError(f"{missing[0]} is missing; {asked}")
    settings: Settings = OmegaConf.to_container(config, resolve=True)  # type: ignore[assignment]
    _check_keys(command, settings)
    try:
        require_finite(settings, "config")
    except DocumentError as error:
        raise ConfigError(str(error).removeprefix("config: ")) from error
    return settings


def _rewrite(command: str, arguments: Sequence[str], positional: str | None) -> list[str]:
    """Turn the user's words into Hydra's."""
    options: list[str] = []  # ahead of the rest: Hydra takes the overrides in one block
    overrides: list[str] = []
    bare: list[str] = []
    groups = set(default_groups(command))
    filed = _filed([*arguments, *(f"{positional}={word}" for word in arguments if "=" not in word)])
    filed |= groups & {MAPPING}
    several = {"-m", "--multirun"} & {*arguments}
    words = iter(arguments)
    for word in words:
        if word.startswith("-"):
            if word.split("=")[0] not in OPTIONS:
                raise ConfigError(f"unknown option '{word}'{suggest(word, OPTIONS)}")
            options.append(word)
            if word.startswith("--config-dir="):
                _check_user_files(Path(word.partition("=")[2]))
            if word in VALUED:
                value = next(words, None)
                options += [] if value is None else [value]
                if word in ("--config-dir", "-cd") and value:
                    _check_user_files(Path(value))
        elif positional and not word.startswith("~") and ("=" not in word or _names_place(word)):
            bare.append(word)
        elif "=" not in word and not word.startswith("~"):
            raise ConfigError(f"'{word}' is no override; write key=value, for instance dr=friction_0.02")
        elif several and "," in word and word.partition("=")[0] in PLACES[2:]:
            overrides.append(word)  # one run for each
        elif "track" in groups and re.match(r"\+?track=\[", word):
            overrides += _several_tracks(command, word, filed)
        else:
            overrides += _rewrite_override(word, groups, filed)
    if bare and positional:
        given = _bare_override(positional, bare)
        overrides += _rewrite_override(f"{positional}={bare[0]}", groups, filed) if positional in groups else [given]
    return [*options, *overrides]


def _names_place(word: str) -> bool:
    """Return whether a word with a = is a folder's name, or a log's, rather than an override."""
    return _there(word, Path.is_dir) or (word.lower().endswith(LOG_ENDINGS) and _there(word))


def _names_file(word: str, group: str) -> bool:
    """Return whether an override gives a group a file."""
    key, _, value = word.partition("=")
    return key.lstrip("+") == group and value.lower().endswith(FILE_GROUPS[group])


def _filed(arguments: Sequence[str]) -> set[str]:
    """Return the groups whose keys are those of a file, by `vehicle=model.yaml` or by `vehicle.file=model.yaml`."""
    keys = {word.lstrip("+").partition("=")[0] for word in arguments}
    return {g for g in FILE_GROUPS if f"{g}.file" in keys or any(_names_file(word, g) for word in arguments)}


def _rewrite_override(word: str, groups: set[str], filed: Collection[str]) -> Iterator[str]:
    """Yield Hydra's words for one of the user's; of the groups `filed` a file, or who reads them, knows the keys."""
    key, _, value = word.partition("=")
    group = key.lstrip("+")
    if key in PLACES and not value.startswith(("'", '"')):
        yield f"{key}={quote(value)}"  # a path may hold what Hydra's grammar has for itself: commas, brackets, umlauts
        return
    if group in groups and value in ("null", "{}"):
        told = f"leave the word out for the usual one; single keys are {group}.KEY=…"
        raise ConfigError(f"{word}: a choice of conf/{group} is expected; {told}")
    if group in FILE_GROUPS and group in groups:
        _require_no_folder(group, value)
    if group == "dr" and value.startswith(POSTERIOR):
        run = value.removeprefix(POSTERIOR)
        _require_cars(run)
        yield "dr=posterior"
        yield f"dr.cars={quote(run)}"
    elif group in FILE_GROUPS and _names_file(word, group):
        _require_file(group, value)
        yield f"{group}=file"
        yield f"{group}.file={quote(value)}"
    elif group.partition(".")[0] in filed and "." in group and not key.startswith("~"):
        yield f"++{word.lstrip('+')}"  # Hydra does not know all its keys; whoever reads it does
    else:
        yield word.lstrip("+") if group in groups else word


def _several_tracks(command: str, word: str, filed: Collection[str]) -> Iterator[str]:
    """Yield Hydra's words for track=[a,b,c], names or files: the first is the track, the rest are its `others`."""
    given = _listed(word.partition("=")[2])
    if command not in ("train", "refine"):
        raise ConfigError(f"{word}: one track is expected; racerl train takes several")
    if not given or len({*given}) < len(given):
        raise ConfigError(f"{word}: different tracks are expected, as track=[l_shape,oval]")
    yield from _rewrite_override(f"track={given[0]}", {"track"}, filed)
    if len(given) > 1:
        yield f"++track.{OTHERS}=[{','.join(map(_other_track, given[1:]))}]"


def _other_track(name: str) -> str:
    """Return a further track, a name or a file, as Hydra's words for its settings; ConfigError where there is none."""
    if name in choices("track"):
        track = read_choice("track", name)
    elif _names_file(f"track={name}", "track"):
        _require_file("track", name)
        track = {"file": name}
    else:
        raise ConfigError(f"unknown track '{name}'{suggest(name, choices('track'))}")
    return "{" + ",".join(f"{key}:{_value(each)}" for key, each in track.items()) + "}"


def _value(value: Any) -> str:
    """Return what a file holds as Hydra's word."""
    if isinstance(value, list):
        return f"[{','.join(map(_value, value))}]"
    return quote(value) if isinstance(value, str) else json.dumps(value)


def _there(path: str, kind: Callable[[Path], bool] = Path.exists) -> bool:
    """Return whether there is such a file or folder; a word too long to be one is none."""
    try:
        return kind(Path(path))
    except OSError:
        return False


def _require_file(group: str, value: str) -> None:
    """Raise ConfigError where a group's file is neither here nor, as tracks may be, among the packaged ones."""
    if not _there(value, Path.is_file) and not (conf_folder() / group / value).is_file():
        raise ConfigError(
            f"{group} = {value}: no such file in {Path.cwd()}; give the path of one, or a name: "
            f"{', '.join(choices(group))}"
        )


def _require_no_folder(group: str, value: str) -> None:
    """Raise ConfigError where a group is given a folder: files in it are what it may be."""
    if value and _there(value, Path.is_dir) and value not in choices(group):
        endings = FILE_GROUPS[group]
        found = sorted(path for path in Path(value).iterdir() if path.name.lower().endswith(endings))
        cure = f"give a file in it, as {group}={found[0]}" if found else f"a file ends with {' or '.join(endings)}"
        raise ConfigError(f"{group} = {value}: is a folder; {cure}")


def _require_cars(run: str) -> None:
    """Raise ConfigError where a run holds no cars to draw from."""
    from racerl.vehicle.cars import CARS

    if not run or not _there(f"{run}/{CARS}", Path.is_file):
        raise ConfigError(
            f"dr={POSTERIOR}{run}: {CARS} is not there; give a run of racerl identify, or of racerl gap that changed "
            "the vehicle"
        )


def _bare_override(positional: str, bare: list[str]) -> str:
    for word in bare:
        if positional in PATHS and not word.startswith(PAPER) and not _there(word):
            near = difflib.get_close_matches(word, PARTS.get(positional, ()), n=1, cutoff=0.75)
            meant = f"; did you mean racerl {PARTS[positional][near[0]]}?" if near else ""
            raise ConfigError(f"{word}: no such file or folder in {Path.cwd()}; allowed are {PATHS[positional]}{meant}")
    if positional.endswith("s"):
        return f"{positional}=[{','.join(quote(word) for word in bare)}]"
    if len(bare) > 1:
        raise ConfigError(f"{' '.join(bare)}: one {positional} is expected; the rest as key=value")
    return f"{positional}={quote(bare[0])}"


def gather_words(command: str, arguments: Sequence[str], key: str) -> list[str]:
    """Return a user's words with those that are `racerl train`'s, which are no keys of the command, in one list.

    The list may have been begun by the user, or else by the configuration. Words inside a list need no quotes.
    """
    mine, base = own_keys(command), read_yaml(conf_folder() / f"{command}.yaml")
    lists = {name for name, value in base.items() if isinstance(value, list)}
    kept: list[str] = []
    begun: list[str] | None = None
    others: list[str] = []
    for word in arguments:
        name, equals, value = word.lstrip("+~").partition("=")
        if not equals or word.startswith("-"):
            kept.append(word)
        elif name == key:
            begun = _listed(value)
        elif name in lists and any("=" in each for each in _listed(value)):
            kept.append(f"{name}=[{','.join(map(quote, _listed(value)))}]")
        elif name.partition(".")[0] in mine:
            kept.append(word)
        else:
            others.append(word)
    if begun is None and not others:
        return kept
    return [*kept, f"{key}=[{','.join(map(quote, [*(base[key] if begun is None else begun), *others]))}]"]


def bare_words(arguments: Sequence[str]) -> Iterator[str]:
    """Yield the words that are neither an option, with its value, nor KEY=VALUE."""
    words = iter(arguments)
    for word in words:
        if word in VALUED:
            next(words, None)
        elif "=" not in word and not word.startswith(("-", "~")):
            yield word


def name_track(arguments: Sequence[str], known: Collection[str]) -> list[str]:
    """Return a user's words with the bare one as track=…: one of the names known, a file, or a folder that holds one.

    Raises ConfigError where that is none, or where there are several.
    """
    kept: list[str] = []
    bare: list[str] = []
    words = iter(arguments)
    for word in words:
        if word in VALUED:
            kept += [word, *([value] if (value := next(words, None)) else [])]
        elif word.startswith(("-", "~")) or ("=" in word and not _there(word)):
            kept.append(word)
        else:
            bare.append(word)
    if len(bare) > 1:
        raise ConfigError(f"{' '.join(bare)}: one track is expected; the rest as key=value")
    for word in bare:
        if known and word not in known and not _there(word):
            raise ConfigError(f"{word}: no track of that name, file or folder in {Path.cwd()}{suggest(word, known)}")
    return [*(f"track={word if word in known else track_file(Path(word))}" for word in bare), *kept]


def _listed(value: str) -> list[str]:
    """Return the words of `[a=1,b=[2,3]]`, split at the commas that are in no inner bracket or quotes."""
    inner = value.strip().removeprefix("[").removesuffix("]") if value.strip().startswith("[") else value
    words = re.findall(r"""(?:[^,\[\]'"]|\[[^\]]*\]|'[^']*'|"[^"]*")+""", inner)
    return [word.strip().strip("'\"") for word in words if word.strip()]


def quote(value: str) -> str:
    """Return a word in quotes that Hydra reads back as it is."""
    # backslashes count before a quote only; a dollar with a brace would stand for another key
    kept = re.sub(r"(\\*)('|$)", lambda found: 2 * found[1] + ("\\'" if found[2] else ""), value)
    return "'" + kept.replace("${", "\\${") + "'"


def _check_keys(command: str, settings: Settings) -> None:
    """Raise ConfigError for keys that a `+` or `~` override added or took away."""
    known = own_keys(command)
    for key in settings:
        if key not in known:
            raise _unknown_key(command, key, known)
    for key in sorted(known - set(settings) - optional_groups(command)):
        raise ConfigError(f"{key} was removed; it is needed, give {key}=…")


def _check_values(command: str, settings: Settings, overrides: Sequence[str]) -> None:
    """Raise ConfigError for a word where there was a number, or true or false."""
    given = [word.lstrip("+").partition("=")[0] for word in overrides if "=" in word and not word.startswith("~")]
    words = {key: value for key in given if isinstance(value := _at(settings, key), str)}
    if not words:
        return
    base: Any = read_yaml(conf_folder() / f"{command}.yaml")
    if any("." in key for key in words):  # what stands in a group's file
        groups = set(default_groups(command))
        chosen = [word for word in overrides if word.lstrip("+").partition("=")[0] in groups]
        base = OmegaConf.to_container(_compose(command, chosen), resolve=False)
    for key, value in words.items():
        if isinstance(usual := _at(base, key), int | float):
            expected = "true or false is expected" if isinstance(usual, bool) else "a number is expected"
            raise ConfigError(f"{key} = {value}: {expected}")


def _at(settings: Any, key: str) -> Any:
    """Return what stands under a dotted key; None where nothing does."""
    for name in key.split("."):
        settings = settings.get(name) if isinstance(settings, Mapping) else None
    return settings


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
        known = choices(group) if group else error.options or []
        made = "; racerl track add gives one of your own a name" if group == "track" else ""
        return ConfigError(f"unknown {group or 'config'} '{choice}'{suggest(choice, known)}{made}")
    if isinstance(error, OverrideParseException):
        return ConfigError(f"cannot read '{error.override}'; write key=value, with quotes around special characters")
    text = " ".join(str(error).split())
    if place := re.fullmatch(r"invalid literal for int\(\) with base 10: '(.*)'", text):
        whole = "give the list as a whole, as dr.parameters=[friction,mass]"
        return ConfigError(f"unknown key '….{place[1]}': what is before it is a list; {whole}")
    if several := re.match(r"Ambiguous value for argument '([^'=]+)=([^']*)'", text):
        cure = f"a list is {several[1]}=[{several[2]}], several runs need --multirun"
        if re.fullmatch(r"[-+]?\d+,\d+", several[2]):
            cure += f", and a decimal has a point, {several[2].replace(',', '.')}"
        return ConfigError(f"{several[1]} = {several[2]}: {cure}")
    if merged := re.fullmatch(r"Error merging override \+*([^=]+)\.([^.=]+)=.*", text):
        return ConfigError(f"unknown key '{merged[1]}.{merged[2]}': {merged[1]} has no keys; give it as a whole")
    key = re.search(
        r"(?:Could not override|Could not delete from config|Could not append to config)[^']*'([^']+)'", text
    )
    if key and "An item is already at" in text:
        return ConfigError(f"+{key[1]}: is there already; write {key[1]}=… without the +")
    if key:
        known = [*_keys(OmegaConf.to_container(_compose(command, []), resolve=False)), *default_groups(command)]
        return _unknown_key(command, key[1], known)
    return ConfigError(text)


def _unknown_key(command: str, key: str, known: Collection[str]) -> ConfigError:
    """Return what to say of a key that is not there: the nearest by its whole name or its last, and where all are."""
    group = key.partition(".")[0]
    if effect := re.fullmatch(r"vehicle(?:/effect|\.effects\.(\w+)(?:\..*)?)", key):
        known = choices("vehicle/effect")
        if effect[1] and effect[1] not in known:
            return ConfigError(f"unknown effect '{effect[1]}'{suggest(effect[1], known)}")
        last = key.rpartition(".")[2]
        name, told = effect[1] or "NAME", ""
        if effect[1] and last not in (effect[1], *(own := read_choice("vehicle/effect", effect[1]))):
            told = f"{name} has no '{last}'{suggest(last, own)}; "
        told += f"an effect is added by +vehicle/effect={name}, and racerl effects {name} has its parameters"
        return ConfigError(f"unknown key '{key}': {told}")
    if "." in key and optional_groups(command) & {group}:
        return ConfigError(f"unknown key '{key}' while {group} is the run's; give {group}=NAME or FILE with it")
    if having := _having(key, group) if group in default_groups(command) else []:
        verb = "has" if len(having) == 1 else "have"
        return ConfigError(f"unknown key '{key}'; {', '.join(having)} {verb} it. All keys: {spoken(command)} --cfg job")
    last, names = key.rpartition(".")[2], sorted(set(known))
    ends = difflib.get_close_matches(last, {name.rpartition(".")[2] for name in names}, n=3, cutoff=0.75)
    near = difflib.get_close_matches(key, names, n=3, cutoff=0.7)
    near += [name for end in ends for name in names if name.rpartition(".")[2] == end and name not in near]
    groups = ", ".join(sorted(default_groups(command)))
    told = f"did you mean {' or '.join(near[:3])}?" if near else f"its groups are {groups}." if groups else ""
    return ConfigError(f"unknown key '{key}'; {told} All keys: {spoken(command)} --cfg job")


def _having(key: str, group: str) -> list[str]:
    """Return the words that choose what has a key, as budget=evolution."""
    having = []
    for name in choices(group):
        with suppress(DocumentError, ConfigError):  # what is wrong with a file of the user's is told where it is chosen
            if key in _keys(read_choice(group, name), f"{group}."):
                having.append(f"{group}={name}")
    return having
