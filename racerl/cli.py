"""The command line: Typer in front, Hydra's grammar behind. Heavy modules load only when a command runs."""

import logging
import math
import re
import shlex
import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racerl import __version__, completion
from racerl.choices import choices, own_keys
from racerl.errors import ConfigError, RacerlError, RunError, refused
from racerl.interruption import behind, listen

if TYPE_CHECKING:
    from racerl.config import Settings
    from racerl.data.topics import UnmappedBag

app = typer.Typer(
    name="racerl",
    help="Racing policies for small cars, from the logs of your own car.",
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # Rich's own markup would swallow words in brackets
    context_settings={"help_option_names": ["-h", "--help"]},
)
PAIRS = 12  # named on the terminal; the page names all
GO_ON = ("train", "refine", "sweep", "gap", "close", "rerun")  # where they were when they were interrupted
HYDRA = {"allow_extra_args": True, "ignore_unknown_options": True}


def _words(metavar: str, *commands: str, others: Callable[[], list[str]] = list) -> Any:
    """Return a command's words: what its usage calls them, and the commands whose groups complete them."""
    complete = completion.overrides(*commands, others=others)
    return typer.Argument(metavar=metavar, autocompletion=complete, show_default=False)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"racerl {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Racing policies for small cars, from the logs of your own car."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command(context_settings=HYDRA)
def train(overrides: Annotated[list[str] | None, _words("[GROUP=CHOICE | KEY=VALUE]...", "train")] = None) -> None:
    """Train a policy: racerl train +dr=friction_0.02 out=outputs/train/first

    Groups: vehicle track sim obs action dr algo budget tracking. `--cfg job` shows all settings, `-m` runs several.

    A policy follows its car's new model, another track or randomization: racerl train from=RUN vehicle=model.yaml
    """
    if any(word.lstrip("+").startswith("from=") for word in overrides or []):
        _run("refine", overrides, _refine)
    else:
        _run("train", overrides, _train)


@app.command(context_settings=HYDRA)
def evaluate(arguments: Annotated[list[str] | None, _words("RUN [KEY=VALUE]...", "evaluate", "race")] = None) -> None:
    """Race a trained policy: racerl evaluate outputs/train/first laps=20

    Drives flying laps per seed; writes metrics.json and trajectories.parquet. A recorded drive is scored the same way,
    or a raceline: racerl evaluate drive.csv.gz track=l_shape

    Rivals race in the world of racerl train: racerl evaluate controller=mpc car=twin
    """
    if any(re.match(r"\+*controller[=./]", word) for word in arguments or []):
        _run("race", arguments, _race)
    else:
        _run("evaluate", arguments, _evaluate, positional="run")


@app.command(context_settings=HYDRA)
def record(overrides: Annotated[list[str] | None, _words("[GROUP=CHOICE | KEY=VALUE]...", "record")] = None) -> None:
    """Drive a simulated car and write a drive log: racerl record drive=programme out=outputs/record/first

    Groups: car vehicle sim track drive. Writes log.parquet, with the sensors' noise, and vehicle.yaml, what was driven.
    """
    _run("record", overrides, _record)


@app.command(context_settings=HYDRA)
def drive(overrides: Annotated[list[str] | None, _words("[GROUP=CHOICE | KEY=VALUE]...", "drive")] = None) -> None:
    """Drive the simulated car yourself: racerl drive sim=motor_current out=outputs/drive/first

    Keyboard or gamepad; practice, then a counted session. Groups: car vehicle track sim. Writes log.parquet, and of the
    counted laps what racerl evaluate writes. Without a display: input=script.
    """
    _run("drive", overrides, _drive)


@app.command(context_settings=HYDRA)
def optimum(overrides: Annotated[list[str] | None, _words("[GROUP=CHOICE | KEY=VALUE]...", "optimum")] = None) -> None:
    """Find the time-optimal lap: racerl optimum track=l_shape vehicle=f1tenth out=outputs/optimum/first

    Groups: vehicle track sim action. Writes optimum.json, raceline.csv (TUM format) and trajectory.parquet.
    """
    _run("optimum", overrides, _optimum)


@app.command(context_settings=HYDRA)
def track(
    arguments: Annotated[
        list[str] | None,
        _words("[TRACK] [KEY=VALUE]...", "track", others=lambda: ["add", *choices("track")]),
    ] = None,
) -> None:
    """Check and show a track: racerl track oval, or racerl track maps/spa

    TRACK is a name, a centreline .csv, a map .yaml, or a folder that holds one, such as an F1TENTH map set. Checks its
    unit, bends, edges and walls for a car (groups: vehicle action). Writes track.json and track.svg. Where it is in
    cm: scale=0.01.

    racerl track add FOLDER|CSV gives it a name (racerl track add --help).
    """
    from racerl.config import name_track

    _run("track", name_track(arguments or [], choices("track")), _track)


@app.command("track add", context_settings=HYDRA, hidden=True)
def track_add(arguments: Annotated[list[str] | None, _words("FOLDER|CSV [KEY=VALUE]...", "track")] = None) -> None:
    """Check a track and give it a name: racerl track add maps/spa name=spa

    From then on track=spa is a track of every command that is run here: conf/track/spa.yaml and spa.csv say so. Nothing
    is written over. FOLDER is an F1TENTH map set (NAME_map.yaml, its image, NAME_centerline.csv). Keys are racerl
    track's; reverse=true races it the other way round.
    """
    from racerl.config import name_track

    words = name_track(arguments or [], ())
    if not any(word.startswith(("track=", "track.file=")) for word in words) and not {"--cfg", "-c"} & {*words}:
        raise ConfigError("which track? write racerl track add FOLDER, or racerl track add centreline.csv")
    _run("track", words, _track_add)


@app.command(context_settings=HYDRA)
def report(
    arguments: Annotated[
        list[str] | None, _words("[RUN]... [KEY=VALUE]...", "report", others=lambda: ["compare"])
    ] = None,
) -> None:
    """Draw the report: racerl report [RUN...]

    Writes one self-contained report.html about the runs and sweeps given, or about all under outputs/.

    racerl report compare A B sets two drivers side by side (racerl report compare --help).
    """
    _run("report", arguments, _report, positional="runs")


@app.command("report compare", context_settings=HYDRA, hidden=True)
def report_compare(arguments: Annotated[list[str] | None, _words("A B [KEY=VALUE]...", "compare")] = None) -> None:
    """Set two drivers side by side: racerl report compare outputs/evaluate/mine paper:human

    Each is a finished evaluate or drive run, a training run (its newest race), or the paper's own lap: paper:rl,
    paper:human. Draws lines with marks at equal times, speed, delta time and steering; writes report.html.
    """
    _run("compare", arguments, _compare, positional="drivers")


@app.command(context_settings=HYDRA)
def show(arguments: Annotated[list[str] | None, _words("RUN... [KEY=VALUE]...", "show")] = None) -> None:
    """Drive the fastest laps once more, side by side: racerl show outputs/train/first paper:human

    Writes report.html, to play and scrub in a browser, and laps.gif (or file=laps.mp4). A driver is a finished
    evaluate or drive run, a training run (its newest race), paper:rl or paper:human.
    """
    _run("show", arguments, _show, positional="drivers")


@app.command(context_settings=HYDRA)
def data(arguments: Annotated[list[str] | None, _words("LOG... [KEY=VALUE]...", "data")] = None) -> None:
    """Show what logs hold: racerl data drive.csv.gz, or racerl data bag.mcap data=f1tenth

    Channels, rates, noise, coverage, and a warning for every trap seen; writes data.json and report.html. A bag needs
    no data= where a shipped mapping fits its topics; where none does, they are listed with a mapping to start from.
    """
    _run("data", arguments, partial(_data, arguments or []), positional="logs")


@app.command()
def effects(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", autocompletion=completion.effects)] = None,
) -> None:
    """List the physical effects that can be added to a car, or explain one: racerl effects tyre_relaxation"""
    from racerl.vehicle import catalogue

    console = _console()
    if name is None:
        _print_lines(console, *(f"{known:<28}{catalogue.entry(known).title}" for known in catalogue.names()))
        return
    entry = catalogue.entry(name)
    lines = [entry.title, *(f"{aspect}: {text}" for aspect, text in entry.aspects.items())]
    for parameter, known_of in entry.parameters.items():
        bounds = f"{known_of.low:g} … {known_of.high:g} {known_of.unit}".rstrip()
        lines.append(f"Parameter {parameter}: {known_of.meaning}, {bounds}")
    lines.append(f"Add it with +vehicle/effect={name}, change it with vehicle.effects.{name}.{parameter}=…")
    _print_lines(console, *lines)


@app.command(context_settings=HYDRA)
def identify(arguments: Annotated[list[str] | None, _words("LOG... [KEY=VALUE]...", "identify")] = None) -> None:
    """Find a car's parameters in driving logs: racerl identify drive.csv.gz out=outputs/identify/first

    Groups: data vehicle method. Writes model.yaml, which every command takes as vehicle=, cars.parquet, which training
    takes as dr=posterior:RUN, identification.json and report.html. fit=false only scores the vehicle.
    """
    _run("identify", arguments, partial(_identify, arguments or []), positional="logs")


@app.command(context_settings=HYDRA)
def gap(
    arguments: Annotated[
        list[str] | None, _words("LOG... [KEY=VALUE]...", "gap", others=lambda: ["plan", "close"])
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results; the same as out=…")] = None,
) -> None:
    """Find what the real car does and the model does not: racerl gap drive.csv.gz out=outputs/gap/first

    Locates the gap, names the missing effect, adds it and proves it on held-out windows. Groups: data vehicle. Writes
    verdict.json, model.yaml, which every command takes as vehicle=, and report.html.

    racerl gap plan LOG... only says which effects the log could tell apart, and what to drive next; racerl gap close
    LOG... real=FILE says what naming the effects is worth to a policy (each has a --help of its own).
    """
    words = arguments or []
    _run("gap", [*words, *([f"out={out}"] if out else [])], partial(_gap, words), positional="logs")


@app.command("gap plan", context_settings=HYDRA, hidden=True)
def gap_plan(arguments: Annotated[list[str] | None, _words("[LOG]... [KEY=VALUE]...", "gap")] = None) -> None:
    """Say which effects a log could tell apart, and what to drive next: racerl gap plan drive.csv.gz vehicle=published

    Without a log, it says so of the excitation programme that racerl record drives. Keys are racerl gap's. Writes
    plan.json and separability.svg.
    """
    words = arguments or []
    given = any("=" not in word for word in words)
    _run("gap", words if given else ["logs=[]", *words], _plan, positional="logs")


@app.command("gap close", context_settings=HYDRA, hidden=True)
def gap_close(
    arguments: Annotated[list[str] | None, _words("LOG... real=FILE [KEY=VALUE]...", "train")] = None,
) -> None:
    """Find what naming is worth to a policy: racerl gap close drive.csv.gz real=car.yaml train=[algo=imitation]

    Trains three policies, on the refitted vehicle, on the one with the effects found and on the car itself, and races
    all three in that car. In place of logs: the folder of a finished racerl gap. real: a vehicle file or name.
    gap=[WORDS] are racerl gap's, train=[WORDS] and all words that are no keys here racerl train's: budget=smoke. Own
    keys: trainings (seeds of the policies) laps seeds threads out. Writes close.json.
    """
    from racerl.config import gather_words

    _run("close", gather_words("close", arguments or [], "train"), _close, positional="logs")


@app.command(context_settings=HYDRA)
def export(arguments: Annotated[list[str] | None, _words("RUN [KEY=VALUE]...", "export")] = None) -> None:
    """Write a policy, or a vehicle, for other programs: racerl export outputs/train/first

    policy.onnx and policy.h (C99, no library): what the car sees in its units in, references out. card.json says what
    goes in and out, and by how much the files differ from the policy. pip install -e '.[export]'

    A vehicle, racerl export model.yaml: its body and side forces as F1TENTH's gym and ForzaETH's race stack take them.
    `vehicle=` reads either form as well.
    """
    _run("export", arguments, _export, positional="run")


@app.command(context_settings=HYDRA)
def rerun(arguments: Annotated[list[str] | None, _words("RUN [KEY=VALUE]...", "rerun")] = None) -> None:
    """Do a finished run again and compare: racerl rerun outputs/train/first

    From its own configuration, below out=; says which files came out otherwise, in what, and what has changed of
    machine and software. Exit status 1 where any differs. Writes rerun.json.
    """
    _run("rerun", arguments, _rerun, positional="run")


@app.command(context_settings=HYDRA)
def sweep(
    arguments: Annotated[
        list[str] | None, _words("SWEEP [GROUP=CHOICE | KEY=VALUE]...", "sweep", "train", others=completion.sweeps)
    ] = None,
) -> None:
    """Train and race every arm of an ablation: racerl sweep ablations

    One process per training, as many at once as there are cores; finished ones are passed over, interrupted ones go
    on. Own groups and keys: engine seeds cars twins laps starts threads out; other words are racerl train's, for
    instance budget=smoke.
    """
    from racerl.config import bare_words, gather_words
    from racerl.sweep.definition import names, read_sweeps

    words = arguments or []
    named = [*bare_words(words), *(word.removeprefix("name=") for word in words if word.startswith("name="))]
    if not named:
        raise ConfigError(f"which sweep? There are {', '.join(names())}: racerl sweep ablations")
    read_sweeps(named[0])  # before anything heavy
    _run("sweep", gather_words("sweep", words, "words"), _sweep, positional="name")


@app.command(context_settings=HYDRA)
def tune(
    arguments: Annotated[
        list[str] | None,
        _words("[CONTROLLER] [GROUP=CHOICE | KEY=VALUE]...", "tune", others=partial(choices, "controller")),
    ] = None,
) -> None:
    """Find a controller's numbers by driving the model: racerl tune mpc trials=60

    Writes controller.yaml, which racerl evaluate takes as controller=FILE, and tune.json. Needs Optuna: in your clone,
    pip install -e '.[tune]'
    """
    _run("tune", arguments, _tune, positional="controller")


@app.command(context_settings=HYDRA)
def bench(
    arguments: Annotated[
        list[str] | None, _words("BENCHMARK [KEY=VALUE]...", "bench", others=partial(choices, "benchmark"))
    ] = None,
) -> None:
    """Measure how fast racerl is on this machine: racerl bench identify

    Writes bench.json: seconds and ratios taken in one run, with threads, CPU and git sha.
    """
    from racerl.config import bare_words

    words = arguments or []
    if not [*bare_words(words)] and not any(word.startswith(("-", "benchmark=")) for word in words):
        raise ConfigError(f"which benchmark? There are {', '.join(choices('benchmark'))}: racerl bench identify")
    _run("bench", arguments, _bench, positional="benchmark")


def _run(
    command: str,
    arguments: list[str] | None,
    task: Callable[["Settings", Path], None],
    positional: str | None = None,
) -> None:
    from racerl.config import run_command

    def logged(settings: "Settings", out: Path) -> None:
        # Hydra has set up logging of its own before the job
        logging.basicConfig(format="%(levelname)s: %(message)s", level=logging.WARNING, force=True)
        try:
            task(settings, out)
        except BaseException as error:
            if behind(error):
                how = "continues" if command in GO_ON else "begins again"
                typer.echo(f"interrupted; the same command with out={out} {how}")
            raise

    try:
        run_command(command, arguments or [], logged, positional)
    except BaseException as error:
        if stop := behind(error):  # as shells have it; Typer takes any for Ctrl-C
            raise typer.Exit(128 + getattr(stop, "number", signal.SIGINT)) from None
        raise


def _train(settings: "Settings", out: Path) -> None:
    from racerl.train.train import train

    _show_training(train, settings, out)


def _refine(settings: "Settings", out: Path) -> None:
    from racerl.train.onward import train_onward

    _show_training(train_onward, settings, out)


def _show_training(stage: Callable[..., dict[str, Any]], settings: "Settings", out: Path) -> None:
    from racerl.console import Bar, training_remark
    from racerl.train.session import Progress

    console = _console()
    announced = False

    def show(progress: Progress) -> None:
        nonlocal announced
        if not announced:
            announced = True
            _print_lines(console, f"training into {out}")
        if progress.stage != bar.title:
            bar.begin(progress.stage)
        left = (progress.total_steps - progress.steps) / progress.steps_per_s if progress.steps_per_s else None
        bar.show(min(1.0, progress.steps / progress.total_steps), training_remark(progress), left)

    with Bar(console, "train") as bar:
        facts = stage(settings, out, show)
    best = facts["best"]
    lap = f"{best['mean_lap_s']:.3f} s" if best["mean_lap_s"] else "none"
    if before := facts.get("before"):
        _print_lines(console, _followed(before, facts["clean_after_s"]))
    _print_lines(
        console,
        f"{facts['steps']:,} steps in {facts['seconds']:.0f} s; best policy: mean lap {lap}, "
        f"{best['valid_laps']} of {best['laps']} laps clean",
    )
    if facts["nan_cars"]:
        console.print(f"warning: the simulation failed (NaN) for {facts['nan_cars']} cars, which were started over")
    _print_lines(console, f"policy in {out}", f"next: racerl evaluate {_quoted(out)}")


def _followed(before: dict[str, Any], clean_after: float | None) -> str:
    """Return how a policy drove when it came into a new world, and after how long it drove there without fault."""
    came = f"as it came {before['valid_laps']} of {before['laps']} laps were clean"
    if clean_after is None:
        return f"{came}, no examination since found all of them clean"
    return came if not clean_after else f"{came}, all of them after {clean_after:.0f} s"


def _evaluate(settings: "Settings", out: Path) -> None:
    from racerl.evaluate.evaluate import evaluate

    _show_laps(evaluate, settings, out)


def _show_laps(stage: Callable[..., dict[str, Any]], settings: "Settings", out: Path) -> None:
    from racerl.console import Bar
    from racerl.evaluate.outcome import METRICS

    console = _console()
    with Bar(console, "evaluate") as bar:
        metrics = stage(settings, out, bar.show)
    _print_metrics(console, metrics)
    _print_lines(console, f"results in {out / METRICS}", f"next: racerl report {_quoted(out)}")


def _race(settings: "Settings", out: Path) -> None:
    from racerl.evaluate.rivals import race

    _show_laps(race, settings, out)


def _tune(settings: "Settings", out: Path) -> None:
    from racerl.console import Bar
    from racerl.tune.tune import CONTROLLER, tune

    console, trials = _console(), settings["trials"]
    with Bar(console, "tune") as bar:
        facts = tune(
            settings, out, lambda done, best: bar.show(done / trials, f"trial {done}: {best:.3f} s per valid lap")
        )
    best = facts["best"]
    _print_lines(
        console,
        f"{best['seconds_per_valid_lap']:.3f} s per valid lap, {best['valid_laps']} of {best['laps']} valid "
        f"(first trial: {facts['trials'][0]['seconds_per_valid_lap']:.3f} s)",
        f"controller in {out / CONTROLLER}",
        f"next: racerl evaluate controller={_quoted(out / CONTROLLER)}",
    )


def _record(settings: "Settings", out: Path) -> None:
    from racerl.console import Bar
    from racerl.data.log import runs_told
    from racerl.record.record import record

    console = _console()
    seconds = settings["seconds"]
    with Bar(console, "record") as bar:
        facts = record(settings, out, lambda share: bar.show(share, f"{share * seconds:.0f} of {seconds:g} s driven"))
    log = out / settings["file"]
    _print_lines(
        console,
        f"{facts['rows']:,} rows in {runs_told(facts['runs'])} in {log}: "
        f"up to {facts['speed_max']:.1f} m/s, "
        f"slip angles {facts['alpha_f_low']:.2f} … {facts['alpha_f_high']:.2f} rad in front and "
        f"{facts['alpha_r_low']:.2f} … {facts['alpha_r_high']:.2f} rad at the rear, "
        f"slip ratios {facts['kappa_low']:.2f} … {facts['kappa_high']:.2f} (1 % quantiles)",
        f"next: racerl data {_quoted(log)}",
    )


def _drive(settings: "Settings", out: Path) -> None:
    from racerl.drive.drive import LOG, drive

    console = _console()
    metrics = drive(settings, out)
    driven = (out / LOG).exists()
    lines = [f"the drive is in {out / LOG}" if driven else "nothing was driven"]
    if metrics:
        _print_metrics(console, metrics)
        if metrics["optimum_s"] is None:
            lines.append("racerl optimum, with the same vehicle, track, sim and action, finds the time-optimal lap")
    elif driven:
        lines.append("no counted lap was driven, so none is scored")
    following = f"report {_quoted(out)}" if metrics else f"data {_quoted(out / LOG)}" if driven else "drive"
    _print_lines(console, "; ".join(lines), f"next: racerl {following}")


def _identify(words: Sequence[str], settings: "Settings", out: Path) -> None:
    from racerl.console import Bar
    from racerl.identify.identify import MODEL, identify
    from racerl.report.identification_page import draw_identification

    console = _console()
    with Bar(console, "identify") as bar:
        facts = identify(settings, out, bar.show)
    _print_identification(console, facts)
    page = draw_identification(out)
    lines = [*_log_remarks(facts), *(f"warning: {warning}" for warning in facts["warnings"])]
    lines += facts["open"]["says"] if facts["fitted"] else []
    written = f"vehicle in {out / MODEL}, report in {page}" if facts["fitted"] else f"report in {page}"
    _print_lines(console, *lines, written, f"next: {_following(facts['verdict']['next'], words, out / MODEL)}")


def _following(command: str, words: Sequence[str], model: Path) -> str:
    """Return the next command: LOG and VEHICLE are those of a user's words that it takes, MODEL is the file."""
    kept = {"logs", "data", "vehicle", "step"} & own_keys(command.split()[1])  # of `gap plan` as of `gap`
    roots = [re.split(r"[./=]", word.lstrip("+~"))[0] if "=" in word else "logs" for word in words]
    mine = shlex.join(word for word, root in zip(words, roots, strict=True) if root in kept)
    places = {"LOG": mine, "VEHICLE": mine, "MODEL": _quoted(model)}
    return re.sub("|".join(places), lambda place: places[place[0]], command).rstrip()


def _quoted(path: Path) -> str:
    """Return a path as a shell reads it back."""
    return shlex.quote(str(path))


def _print_lines(console: Any, *lines: str) -> None:
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True)


def _gap(words: Sequence[str], settings: "Settings", out: Path) -> None:
    from racerl.console import Bar
    from racerl.gap.diagnose import MODEL, gap
    from racerl.report.gap_page import draw_gap

    console = _console()
    with Bar(console, "gap") as bar:
        facts = gap(settings, out, lambda what, share: bar.show(share, what))
    page = draw_gap(out)
    _print_verdict(console, facts)
    following = "racerl train vehicle=MODEL"
    if facts["contradictions"]:  # columns are mended first
        following = "racerl data LOG"
    elif facts["verdict"] in ("ambiguous", "under_excited"):
        following = "racerl gap plan LOG"
    following = _following(following, words, out / MODEL)
    _print_lines(console, f"vehicle in {out / MODEL}, report in {page}", f"next: {following}")


def _close(settings: "Settings", out: Path) -> None:
    from rich.table import Table

    from racerl.config import compose_settings
    from racerl.console import Bar
    from racerl.train.close import RESULT, close

    console = _console()
    with Bar(console, "close") as bar:
        facts = close(settings, out, compose_settings, bar.show)
    table = Table(
        "policy", "seed", "trained [s]", "mean lap [s]", "fastest [s]", "E_off [m s]", "crashes", "valid laps"
    )
    for kind, policy in facts["policies"].items():
        for row in policy["trainings"]:
            times = ["none" if row[k] is None else f"{row[k]:.3f}" for k in ("mean_lap_s", "fastest_valid_lap_s")]
            valid = f"{row['valid_laps']} of {row['laps']}"
            seconds = f"{row['training_s']:.0f}"
            table.add_row(
                kind, str(row["seed"]), seconds, *times, f"{row['e_off']:.5f}", f"{row['crash_share']:.0%}", valid
            )
    console.print(table)
    effects = ", ".join(facts["effects"])
    lines = [f"trained with {effects}: {_recovered(facts, 'new', 'recovered')}"]
    if "refined" in facts["policies"]:
        lines.append(f"refined with {effects}: {_recovered(facts, 'refined', 'recovered_by_refining')}")
    _print_lines(console, *lines, f"numbers in {out / RESULT}")


def _recovered(facts: dict[str, Any], kind: str, key: str) -> str:
    """Return what share of the oracle's gain a kind of policy has, in lap time, E_off and crashes."""
    told = {"mean_lap_s": "lap time", "e_off": "E_off", "crash_share": "crashes"}
    gained = []
    for measure, share in facts[key].items():
        missing = [each for each in ("old", kind, "oracle") if facts["policies"][each][measure] is None]
        why = f"{' and '.join(missing)} finished no lap in a training" if missing else "the oracle gains nothing"
        ci95 = facts[f"{key}_ci95"][measure]
        sure = f"{ci95[0]:.0%} … {ci95[1]:.0%}" if ci95 else "the trainings scatter by more than the oracle gains"
        gained.append(f"{told[measure]}: " + (why if share is None else f"{share:.0%} of the oracle's gain ({sure})"))
    return "; ".join(gained)


def _plan(settings: "Settings", out: Path) -> None:
    from racerl.config import compose_settings
    from racerl.console import Bar
    from racerl.documents import write_text
    from racerl.gap.plan import PLAN, plan
    from racerl.report.figures import separability

    console = _console()
    with Bar(console, "plan") as bar:
        facts = plan(settings, out, compose_settings, lambda what, share: bar.show(share, what))
    write_text(out / "separability.svg", separability.draw(facts))
    dark = [name for name, effect in facts["effects"].items() if not effect["shows"]]
    lines = [", ".join(f"{log['name']}, {log['seconds']:.0f} s" for log in facts["logs"])]
    lines += [f"{len(dark)} of {len(facts['effects'])} effects would not show at their usual size: {', '.join(dark)}"]
    lines += [f"alike: {' and '.join(row['effects'])} (cosine {row['cosine']:+.3f})" for row in facts["alike"][:PAIRS]]
    lines += [f"drive next: {row['drive']} (for {', '.join(row['for'])})" for row in facts["next"]]
    lines += [f"warning: {remark}" for remark in facts["remarks"]]
    _print_lines(console, *lines, f"numbers in {out / PLAN}, picture in {out / 'separability.svg'}")


def _print_verdict(console: Any, facts: dict[str, Any]) -> None:
    from racerl.gap.sentences import likely, opening, unseen

    lines = [*opening(facts), f"verdict: {facts['verdict']}: {facts['reason']}"]
    lines += [f"how likely: {said}"] if (said := likely(facts)) else []
    if residual := facts["residual"]:
        share = f"{residual['explained']:.0%} of the excess on held-out windows"
        lines.append(f"offered instead: a learned residual, {residual['vehicle']}, which takes {share}")
    if facts["next_manoeuvre"]:
        lines.append(f"drive next: {facts['next_manoeuvre']}")
    if gap := facts["gap"]:
        lines.append(
            f"gap over the noise: {gap['unfitted']:.2f} as configured, {gap['before']:.2f} refitted"
            + (f", {gap['after']:.2f} with the effects found" if facts["effects"] or facts["helped"] else "")
        )
    lines += [said] if (said := unseen(facts)) else []
    lines += [*_log_remarks(facts), *(f"warning: {remark}" for remark in facts["remarks"])]
    _print_lines(console, *lines)


def _log_remarks(facts: dict[str, Any]) -> list[str]:
    return [f"{log['name']}: {remark}" for log in facts["logs"] for remark in log["remarks"]]


def _sweep(settings: "Settings", out: Path) -> None:
    from racerl.config import compose_settings
    from racerl.console import Board
    from racerl.report.sweep_page import draw_sweep
    from racerl.sweep import conclusions
    from racerl.sweep.sweep import sweep
    from racerl.sweep.tables import RESULTS

    console = _console()
    with Board(console) as board:
        facts = sweep(settings, out, compose_settings, board.show)
    _print_lines(console, *conclusions.lines(facts))
    _print_lines(console, f"numbers in {out / RESULTS}, report in {draw_sweep(out)}")
    if failed := facts["failed"]:
        words = "; ".join(f"{name}: {line}" for name, line in failed.items())
        planned = facts["jobs"]["planned"]
        raise RunError(f"{len(failed)} of {planned} jobs failed, the same command tries them again: {words}")


def _rerun(settings: "Settings", out: Path) -> None:
    from racerl.config import compose_settings
    from racerl.rerun import RESULT, rerun

    console = _console()
    facts = rerun(settings, out, compose_settings)
    lines = [f"differs: {each['file']}: {each['what']}" for each in facts["differences"]]
    told = "all files came out the same" if facts["same"] else f"{len(lines)} files came out otherwise"
    lines += [f"changed: {line}" for line in facts["changed"]]
    _print_lines(console, f"{told}; {len(facts['files'])} compared", *lines, f"numbers in {out / RESULT}")
    if not facts["same"]:
        raise typer.Exit(1)


def _export(settings: "Settings", out: Path) -> None:
    if Path(str(settings["run"])).is_file():
        _export_vehicle(settings, out)
        return
    from racerl.deploy.export import CARD, HEADER, ONNX, export

    card = export(settings, out)
    parity = card["parity"]
    differences = [f"{name} {parity[name]:.1g}" for name in ("onnxruntime", "c") if parity[name] is not None]
    _print_lines(
        _console(),
        f"{card['policy']}: {len(card['sees'])} numbers seen, {card['rate_hz']:g} times a second",
        f"differs from the policy by at most {', '.join(differences)} rad or m/s ({parity['observations']:,} tried)",
        f"{out / ONNX}, {out / HEADER}; what goes in and out: {out / CARD}",
    )


def _export_vehicle(settings: "Settings", out: Path) -> None:
    from racerl.deploy.vehicle import GYM, PACEJKA, export_vehicle

    told = export_vehicle(settings, out)
    lines = [f"{out / GYM} for F1TENTH's gym, {out / PACEJKA} for ForzaETH's race stack"]
    if told["lacking"]:
        lines.insert(0, f"warning: neither knows {', '.join(told['lacking'])}, so what they drive is another car")
    _print_lines(_console(), *lines)


def _bench(settings: "Settings", out: Path) -> None:
    from racerl.bench.bench import RESULT, bench
    from racerl.config import compose_settings
    from racerl.console import Bar
    from racerl.documents import write_text
    from racerl.report.figures import blind_test, cost

    console = _console()
    with Bar(console, "bench") as bar:
        facts = bench(settings, out, compose_settings, bar.show)
    console.print_json(data=facts)
    written = [out / RESULT]
    gap = facts.get("gap", {})
    pictures = {
        "cost": cost.draw(facts),
        "detection": blind_test.draw_detection(gap.get("detection", [])),
        "confusion": blind_test.draw_confusion(gap.get("confusion", {})),
    }
    for name, picture in pictures.items():
        if picture:
            written.append(out / f"{name}.svg")
            write_text(written[-1], picture)
    _print_lines(console, f"numbers in {' and '.join(map(str, written))}")


def _optimum(settings: "Settings", out: Path) -> None:
    from racerl.console import Bar
    from racerl.optimum.optimum import DISTINCT, RACELINE, optimum

    console = _console()
    with Bar(console, "optimum") as bar:
        facts = optimum(settings, out, bar.show)
    held = facts["held"]
    lines = [
        f"{facts['time_s']:.3f} s with free commands, {held['time_s']:.3f} s with commands held for "
        f"{held['period_s']:.4f} s; found in {facts['seconds']:.0f} s"
    ]
    if len(facts["ways"]) > 1:
        told = [f"{way['time_s']:.3f} s with up to {math.degrees(way['sideslip_rad']):.0f}°" for way in facts["ways"]]
        lines.append(
            f"this car has {len(told)} ways round, each faster than all near it: {', '.join(told)} of side slip"
        )
    if held["time_s"] < (1 - DISTINCT) * facts["time_s"]:
        lines.append(
            "warning: held commands led to another, faster way round: the free commands' time is no bound here"
        )
    _print_lines(console, *lines, f"raceline in {out / RACELINE}")


def _print_identification(console: Any, facts: dict[str, Any]) -> None:
    from rich.table import Table
    from rich.text import Text

    from racerl.report.identification_page import UNITS, factor, headline, measure, spread

    _print_lines(console, headline(facts))
    fitted, title = facts["fitted"], f"error of {facts['horizon']}-sample rollouts (RMSE)"
    compared = ("before", "identified", "factor") if fitted else ("given vehicle",)
    table = Table("channel", "unit", *compared, "first value held", title=title)
    for name, row in facts["verdict"]["channels"].items():
        errors = [measure(row[key]) for key in (("before", "after") if fitted else ("after",))]
        factors = [Text(factor(row), style="red" if row["grew"] else "")] if fitted else []
        table.add_row(name, UNITS[name], *errors, *factors, measure(row["still"]))
    console.print(table)
    if not fitted:
        return
    table = Table("parameter", "value", "95 % interval", "unit", "before", "from the data alone")
    for name, p in facts["parameters"].items():
        interval = f"{p['ci95'][0]:.4g} … {p['ci95'][1]:.4g}"
        table.add_row(name, f"{p['value']:.4g}", interval, p["unit"], f"{p['start']:.4g}", spread(p))
    console.print(table)


def _print_metrics(console: Any, metrics: dict[str, Any]) -> None:
    from rich.table import Table

    def text(key: str, digits: int) -> str:
        return "none" if metrics[key] is None else f"{metrics[key]:.{digits}f}"

    over = metrics["mean_over_optimum"]
    table = Table(
        "fastest valid [s]",
        "mean [s]",
        "over optimum",
        "settled [s]",
        "std [s]",
        "E_off [m s]",
        "crashes",
        "laps",
        title=metrics["label"],
    )
    table.add_row(
        text("fastest_valid_lap_s", 3),
        text("mean_lap_s", 3),
        f"{over:+.1%}" if over is not None else "unknown" if metrics["mean_lap_s"] else "none",
        text("settled_lap_s", 3),
        text("std_lap_s", 3),
        text("e_off", 5),
        f"{metrics['crash_share']:.0%}",
        str(metrics["laps"]),
    )
    console.print(table)
    if metrics["nan_cars"]:
        console.print(f"warning: the simulation failed (NaN) for {metrics['nan_cars']} cars; counted as crashes")


def _track(settings: "Settings", out: Path) -> None:
    from racerl.report.track import show_track

    _print_track(show_track(settings, out), out)


def _track_add(settings: "Settings", out: Path) -> None:
    from racerl.report.track import add_track

    facts, written = add_track(settings, out)
    _print_track(facts, out)
    files = " and ".join(map(str, written))
    _print_lines(_console(), f"{files}: track={written[0].stem}", f"next: racerl train track={written[0].stem}")


def _print_track(facts: dict[str, Any], out: Path) -> None:
    from racerl.report.track import PICTURE, headline

    odd = [f"problem: {line}" for line in facts["problems"]] + [f"warning: {line}" for line in facts["warnings"]]
    _print_lines(_console(), f"{facts['track']}: {headline(facts)}", *odd, f"picture in {out / PICTURE}")


def _report(settings: "Settings", out: Path) -> None:
    from racerl.report.report import report

    page = report(settings, out)
    _console().print(f"report in {page}", highlight=False, soft_wrap=True)


def _compare(settings: "Settings", out: Path) -> None:
    from racerl.report.compare import compare

    page = compare(settings, out)
    _console().print(f"report in {page}", highlight=False, soft_wrap=True)


def _show(settings: "Settings", out: Path) -> None:
    from racerl.report.show import show

    page = show(settings, out)
    _print_lines(_console(), f"{out / settings['file']}; to play and scrub: {page}")


def _data(words: Sequence[str], settings: "Settings", out: Path) -> None:
    from racerl.data.log import VELOCITY
    from racerl.data.survey import survey
    from racerl.data.topics import UnmappedBag
    from racerl.report.log_page import draw_logs

    console = _console()
    try:
        facts = survey(settings, out)
    except UnmappedBag as bag:
        _print_topics(console, bag)
        raise
    for log in facts["logs"]:
        _print_log(console, log)
    _print_lines(console, *(f"warning: {warning}" for warning in facts["warnings"]))
    lines, following = [f"report in {draw_logs(out)}"], "racerl identify LOG"
    if any(log["contradictions"] for log in facts["logs"]):
        lines.append(
            "mend first what contradicts the poses: a mapping in conf/data gives columns their units and signs"
        )
        following = "racerl data LOG"
    elif any(set(VELOCITY) & set(log["missing"]) for log in facts["logs"]):
        lines.append("neither a whole pose (x, y, yaw) nor velocities: its motion cannot be fitted; name their columns")
        following = "racerl data LOG"
    _print_lines(console, *lines, f"next: {_following(following, words, out)}")


def _print_topics(console: Any, bag: "UnmappedBag") -> None:
    from rich.table import Table

    table = Table("topic", "type", "messages")
    for topic in bag.topics:
        table.add_row(topic.name, topic.kind, f"{topic.messages:,}")
    console.print(table)
    if bag.draft:
        _print_lines(console, bag.draft)


def _print_log(console: Any, log: dict[str, Any]) -> None:
    from rich.table import Table

    from racerl.data.log import runs_told

    title = f"{log['name']}: {log['seconds']:.1f} s in {runs_told(len(log['runs']))} at {log['rate_hz']:g} Hz"
    table = Table("channel", "unit", "least", "greatest", "noise", "new per s", title=title)
    for name, channel in log["channels"].items():
        noise = "–" if channel["noise"] is None else f"{channel['noise']:.2g}"
        row = (channel["unit"], f"{channel['min']:.3f}", f"{channel['max']:.3f}", noise, f"{channel['updates_hz']:.0f}")
        table.add_row(name, *row)
    console.print(table)
    lines = [f"not in the log: {', '.join(log['missing'])}"] if log["missing"] else []
    lines += [*log["remarks"], *(f"warning: {warning}" for warning in log["warnings"])]
    _print_lines(console, *lines)


def _console() -> Any:
    from rich.console import Console

    return Console(markup=False)  # brackets are units, and parts of paths


def main() -> None:
    """Run the command line; a user's mistake ends with one line and exit code 2."""
    listen()
    try:
        with completion.for_bash():
            code = app(completion.as_commands(sys.argv[1:]), standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort) as error:  # Typer's own, where nothing had begun
        raise SystemExit(128 + getattr(behind(error), "number", signal.SIGINT)) from None
    except Exception as error:
        # Typer's own complaints are not exported as one class; all of them can format themselves
        complaint = error.format_message() if hasattr(error, "format_message") else None
        if isinstance(error, OSError):
            complaint = refused(error)
        if complaint is None and not isinstance(error, RacerlError):
            raise
        sys.stderr.write(f"racerl: {' '.join((complaint or str(error)).split())}\n")
        raise SystemExit(2) from None
    raise SystemExit(code if isinstance(code, int) else 0)


if __name__ == "__main__":
    main()
