"""The command line: Typer in front, Hydra's grammar behind. Heavy modules load only when a command runs."""

import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racerl import __version__
from racerl.errors import ConfigError, RacerlError, RunError

if TYPE_CHECKING:
    from racerl.config import Settings
    from racerl.data.topics import UnmappedBag

app = typer.Typer(
    name="racerl",
    help="Learn racing policies for small cars that work on the real car.",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
PAIRS = 12  # named on the terminal; the page names all
HYDRA = {"allow_extra_args": True, "ignore_unknown_options": True}


def _complete(incomplete: str) -> list[str]:
    """Complete `group=choice` from the files under conf/."""
    folder = Path(__file__).parent / "conf"
    folder = folder if folder.is_dir() else folder.parent.parent / "conf"
    plus = "+" if incomplete.startswith("+") else ""
    word = incomplete.lstrip("+")
    group, equals, _ = word.partition("=")
    if not equals:
        groups = sorted(path.name for path in folder.iterdir() if path.is_dir() and path.name != "hydra")
        return [f"{plus}{name}=" for name in groups if name.startswith(word)]
    choices = sorted(path.stem for path in (folder / group).glob("*.yaml")) if group.isidentifier() else []
    return [f"{plus}{group}={name}" for name in choices if f"{group}={name}".startswith(word)]


def _complete_effect(incomplete: str) -> list[str]:
    """Complete the name of an effect."""
    folder = Path(__file__).parent / "vehicle" / "effects"
    names = sorted(path.stem for path in folder.glob("*.py") if not path.stem.startswith("_"))
    return [name for name in names if name.startswith(incomplete)]


Overrides = Annotated[
    list[str] | None,
    typer.Argument(metavar="[GROUP=CHOICE | KEY=VALUE]...", autocompletion=_complete, show_default=False),
]
Run = Annotated[
    list[str] | None,
    typer.Argument(metavar="RUN [KEY=VALUE]...", autocompletion=_complete, show_default=False),
]
Runs = Annotated[
    list[str] | None,
    typer.Argument(metavar="[RUN]... [KEY=VALUE]...", autocompletion=_complete, show_default=False),
]


Benchmarks = Annotated[
    list[str] | None,
    typer.Argument(metavar="BENCHMARK [KEY=VALUE]...", autocompletion=_complete, show_default=False),
]
Sweeps = Annotated[
    list[str] | None,
    typer.Argument(metavar="SWEEP [GROUP=CHOICE | KEY=VALUE]...", autocompletion=_complete, show_default=False),
]
Controllers = Annotated[
    list[str] | None,
    typer.Argument(metavar="[CONTROLLER] [GROUP=CHOICE | KEY=VALUE]...", autocompletion=_complete, show_default=False),
]
Logs = Annotated[
    list[str] | None,
    typer.Argument(metavar="LOG... [KEY=VALUE]...", autocompletion=_complete, show_default=False),
]


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
    """Learn racing policies for small cars that work on the real car."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command(context_settings=HYDRA)
def train(overrides: Overrides = None) -> None:
    """Train a policy: racerl train +dr=friction_0.02 out=outputs/train/first

    Groups: vehicle track sim obs action dr algo budget. `--cfg job` shows all settings, `-m` runs several.
    """
    _run("train", overrides, _train)


@app.command(context_settings=HYDRA)
def evaluate(arguments: Run = None) -> None:
    """Race a trained policy: racerl evaluate outputs/train/first laps=20

    Drives flying laps per seed; writes metrics.json and trajectories.parquet. A recorded drive is scored the same way:
    racerl evaluate drive.csv.gz track=l_shape

    Rivals race in the world of racerl train: racerl evaluate controller=mpc car=twin
    """
    if any(word.lstrip("+").startswith("controller") for word in arguments or []):
        _run("race", arguments, _race)
    else:
        _run("evaluate", arguments, _evaluate, positional="run")


@app.command(context_settings=HYDRA)
def record(overrides: Overrides = None) -> None:
    """Drive a simulated car and write a drive log: racerl record drive=programme out=outputs/record/first

    Groups: car vehicle sim track drive. Writes log.parquet, with the sensors' noise, and vehicle.yaml, what was driven.
    """
    _run("record", overrides, _record)


@app.command(context_settings=HYDRA)
def drive(overrides: Overrides = None) -> None:
    """Drive the simulated car yourself: racerl drive sim=motor_current out=outputs/drive/first

    Keyboard or gamepad; practice, then a counted session. Groups: car vehicle track sim. Writes log.parquet, and of the
    counted laps what racerl evaluate writes. Without a display: input=script.
    """
    _run("drive", overrides, _drive)


@app.command(context_settings=HYDRA)
def optimum(overrides: Overrides = None) -> None:
    """Find the time-optimal lap: racerl optimum track=l_shape vehicle=f1tenth out=outputs/optimum/first

    Groups: vehicle track sim action. Writes optimum.json, raceline.csv (TUM format) and trajectory.parquet.
    """
    _run("optimum", overrides, _optimum)


@app.command(context_settings=HYDRA)
def report(arguments: Runs = None) -> None:
    """Draw the report: racerl report [RUN...]

    Writes one self-contained report.html about the runs and sweeps given, or about all under outputs/.

    racerl report compare A B sets two drivers side by side: evaluate, drive or training runs, paper:rl, paper:human.
    """
    words = arguments or []
    if words[:1] == ["compare"]:
        _run("compare", words[1:], _compare, positional="drivers")
    else:
        _run("report", words, _report, positional="runs")


@app.command(context_settings=HYDRA)
def data(arguments: Logs = None) -> None:
    """Show what logs hold: racerl data drive.csv.gz, or racerl data bag.mcap data=f1tenth

    Channels, rates, noise, coverage, and a warning for every trap seen; writes data.json and report.html. A bag needs
    no data= where a shipped mapping fits its topics; where none does, they are listed with a mapping to start from.
    """
    _run("data", arguments, _data, positional="logs")


@app.command()
def effects(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", autocompletion=_complete_effect)] = None,
) -> None:
    """List the physical effects that can be added to a car, or explain one: racerl effects tyre_relaxation"""
    from racerl.vehicle import catalogue

    console = _console()
    if name is None:
        for known in catalogue.names():
            console.print(f"{known:<28}{catalogue.entry(known).title}", highlight=False, soft_wrap=True, markup=False)
        return
    entry = catalogue.entry(name)
    lines = [entry.title, *(f"{aspect}: {text}" for aspect, text in entry.aspects.items())]
    for parameter, known_of in entry.parameters.items():
        bounds = f"{known_of.low:g} … {known_of.high:g} {known_of.unit}".rstrip()
        lines.append(f"Parameter {parameter}: {known_of.meaning}, {bounds}")
    lines.append(f"Add it with +vehicle/effect={name}, change it with vehicle.effects.{name}.{parameter}=…")
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False)


@app.command(context_settings=HYDRA)
def identify(arguments: Logs = None) -> None:
    """Find a car's parameters in driving logs: racerl identify drive.csv.gz out=outputs/identify/first

    Groups: data vehicle method. Writes model.yaml, which every command takes as vehicle=, identification.json and
    report.html. fit=false only scores the vehicle.
    """
    _run("identify", arguments, _identify, positional="logs")


@app.command(context_settings=HYDRA)
def gap(
    arguments: Logs = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results; the same as out=…")] = None,
) -> None:
    """Find what the real car does and the model does not: racerl gap drive.csv.gz out=outputs/gap/first

    Locates the gap, names the missing effect, adds it and proves it on held-out windows. Groups: data vehicle. Writes
    verdict.json, model.yaml, which every command takes as vehicle=, and report.html.

    racerl gap plan drive.csv.gz only says which effects the log could tell apart, and what to drive next;
    without a log, it says so of the excitation programme that racerl record drives.
    racerl gap close drive.csv.gz real=FILE (or the folder of a finished racerl gap) trains without and with what was
    found, and races both, and a policy that knew, in the car of that file.
    """
    words = [*(arguments or []), *([f"out={out}"] if out else [])]
    if words[:1] == ["close"]:
        _run("close", words[1:], _close, positional="logs")
    elif words[:1] == ["plan"]:
        given = any("=" not in word for word in words[1:])
        _run("gap", words[1:] if given else ["logs=[]", *words[1:]], _plan, positional="logs")
    else:
        _run("gap", words, _gap, positional="logs")


@app.command(context_settings=HYDRA)
def sweep(arguments: Sweeps = None) -> None:
    """Train and race every arm of an ablation: racerl sweep ablations

    One process per training, as many at once as there are cores; finished ones are passed over, interrupted ones go
    on. Own groups and keys: engine seeds cars laps starts threads out; other words are racerl train's: budget=smoke.
    """
    words = arguments or []
    if not any("=" not in word or word.startswith("name=") for word in words):
        from racerl.sweep.definition import names

        raise ConfigError(f"which sweep? There are {', '.join(names())}: racerl sweep ablations")
    _run("sweep", _sweep_words(words), _sweep, positional="name")


@app.command(context_settings=HYDRA)
def tune(arguments: Controllers = None) -> None:
    """Find a controller's numbers by driving the model: racerl tune mpc trials=60

    Writes controller.yaml, which racerl evaluate takes as controller=FILE, and tune.json. Needs racerl[tune].
    """
    words = arguments or []
    _run("tune", [word if "=" in word or word.startswith("-") else f"controller={word}" for word in words], _tune)


@app.command(context_settings=HYDRA)
def bench(arguments: Benchmarks = None) -> None:
    """Measure how fast racerl is on this machine: racerl bench identify

    Writes bench.json: seconds and ratios taken in one run, with threads, CPU and git sha.
    """
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
        task(settings, out)

    run_command(command, arguments or [], logged, positional)


def _train(settings: "Settings", out: Path) -> None:
    from racerl.console import Bar, training_remark
    from racerl.train.session import Progress
    from racerl.train.train import train

    console = _console()
    announced = False

    def show(progress: Progress) -> None:
        nonlocal announced
        if not announced:
            announced = True
            console.print(f"training into {out}", highlight=False, soft_wrap=True)
        left = (progress.total_steps - progress.steps) / progress.steps_per_s if progress.steps_per_s else None
        bar.show(min(1.0, progress.steps / progress.total_steps), training_remark(progress), left)

    try:
        with Bar(console, "train") as bar:
            facts = train(settings, out, show)
    except KeyboardInterrupt:
        console.print(f"interrupted; the same command with out={out} continues", highlight=False, soft_wrap=True)
        raise
    best = facts["best"]
    lap = f"{best['mean_lap_s']:.3f} s" if best["mean_lap_s"] else "none"
    console.print(
        f"{facts['steps']:,} steps in {facts['seconds']:.0f} s; best policy: mean lap {lap}, "
        f"{best['valid_laps']} of {best['laps']} laps clean",
        highlight=False,
        soft_wrap=True,
    )
    if facts["nan_cars"]:
        console.print(f"warning: the simulation failed (NaN) for {facts['nan_cars']} cars, which were started over")
    console.print(f"policy in {out}; race it with: racerl evaluate {out}", highlight=False, soft_wrap=True)


def _evaluate(settings: "Settings", out: Path) -> None:
    from racerl.evaluate.evaluate import evaluate

    _show_laps(evaluate, settings, out)


def _show_laps(stage: Callable[..., dict[str, Any]], settings: "Settings", out: Path) -> None:
    from racerl.console import Bar
    from racerl.evaluate.outcome import METRICS

    console = _console()
    with Bar(console, "evaluate") as bar:
        metrics = stage(settings, out, lambda done, total: bar.show(done / total, f"lap {done} of {total}"))
    _print_metrics(console, metrics)
    console.print(f"results in {out / METRICS}; draw them with: racerl report {out}", highlight=False, soft_wrap=True)


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
    lines = [
        f"{best['seconds_per_valid_lap']:.3f} s per valid lap, {best['valid_laps']} of {best['laps']} valid "
        f"(first trial: {facts['trials'][0]['seconds_per_valid_lap']:.3f} s)",
        f"controller in {out / CONTROLLER}; race it with: racerl evaluate controller={out / CONTROLLER}",
    ]
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def _record(settings: "Settings", out: Path) -> None:
    from racerl.console import Bar
    from racerl.record.record import record

    console = _console()
    seconds = settings["seconds"]
    with Bar(console, "record") as bar:
        facts = record(settings, out, lambda share: bar.show(share, f"{share * seconds:.0f} of {seconds:g} s driven"))
    console.print(
        f"{facts['rows']:,} rows in {facts['runs']} runs in {out / settings['file']}: "
        f"up to {facts['speed_max']:.1f} m/s, "
        f"slip angles {facts['alpha_f_low']:.2f} … {facts['alpha_f_high']:.2f} rad in front and "
        f"{facts['alpha_r_low']:.2f} … {facts['alpha_r_high']:.2f} rad at the rear, "
        f"slip ratios {facts['kappa_low']:.2f} … {facts['kappa_high']:.2f} (1 % quantiles)",
        highlight=False,
        soft_wrap=True,
    )


def _drive(settings: "Settings", out: Path) -> None:
    from racerl.drive.drive import LOG, drive

    console = _console()
    metrics = drive(settings, out)
    driven = (out / LOG).exists()
    lines = [f"the drive is in {out / LOG}" if driven else "nothing was driven"]
    if metrics:
        _print_metrics(console, metrics)
        lines.append(f"draw it with: racerl report {out}")
    elif driven:
        lines.append("no counted lap was driven, so none is scored")
    console.print("; ".join(lines), highlight=False, soft_wrap=True)


def _identify(settings: "Settings", out: Path) -> None:
    from racerl.console import Bar
    from racerl.identify.identify import MODEL, identify
    from racerl.report.identification_page import draw_identification

    console = _console()
    with Bar(console, "identify") as bar:
        facts = identify(settings, out, lambda what, share: bar.show(share, what))
    _print_identification(console, facts)
    page = draw_identification(out)
    lines = [f"warning: {warning}" for warning in facts["warnings"]]
    if facts["fitted"]:
        lines.append(f"vehicle in {out / MODEL}; drive it with: racerl train vehicle={out / MODEL}")
    for line in [*lines, f"report in {page}"]:
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def _gap(settings: "Settings", out: Path) -> None:
    from racerl.console import Bar
    from racerl.gap.diagnose import MODEL, gap
    from racerl.report.gap_page import draw_gap

    console = _console()
    with Bar(console, "gap") as bar:
        facts = gap(settings, out, lambda what, share: bar.show(share, what))
    page = draw_gap(out)
    _print_verdict(console, facts)
    for line in (f"vehicle in {out / MODEL}; drive it with: racerl train vehicle={out / MODEL}", f"report in {page}"):
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def _close(settings: "Settings", out: Path) -> None:
    from rich.table import Table

    from racerl.config import compose_settings
    from racerl.console import Bar
    from racerl.train.close import RESULT, close

    console = _console()
    with Bar(console, "close") as bar:
        facts = close(settings, out, compose_settings, bar.show)
    table = Table("policy", "seed", "mean lap [s]", "fastest [s]", "E_off [m s]", "crashes", "valid laps")
    for kind, policy in facts["policies"].items():
        for row in policy["trainings"]:
            times = ["none" if row[k] is None else f"{row[k]:.3f}" for k in ("mean_lap_s", "fastest_valid_lap_s")]
            valid = f"{row['valid_laps']} of {row['laps']}"
            table.add_row(kind, str(row["seed"]), *times, f"{row['e_off']:.5f}", f"{row['crash_share']:.0%}", valid)
    console.print(table)
    told = {"mean_lap_s": "lap time", "e_off": "E_off", "crash_share": "crashes"}
    gained = []
    for measure, share in facts["recovered"].items():
        missing = [kind for kind, policy in facts["policies"].items() if policy[measure] is None]
        why = f"{' and '.join(missing)} finished no lap in a training" if missing else "the oracle gains nothing"
        ci95 = facts["recovered_ci95"][measure]
        sure = f"{ci95[0]:.0%} … {ci95[1]:.0%}" if ci95 else "the trainings scatter by more than the oracle gains"
        gained.append(f"{told[measure]}: " + (why if share is None else f"{share:.0%} of the oracle's gain ({sure})"))
    line = f"with {', '.join(facts['effects'])}: {'; '.join(gained)}; numbers in {out / RESULT}"
    console.print(line, highlight=False, soft_wrap=True)


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
    for line in [*lines, f"numbers in {out / PLAN}, picture in {out / 'separability.svg'}"]:
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def _print_verdict(console: Any, facts: dict[str, Any]) -> None:
    lines = [f"verdict: {facts['verdict']}: {facts['reason']}"]
    for effect in facts["effects"]:
        for name, p in effect["parameters"].items():
            interval = f"{p['ci95'][0]:.4g} … {p['ci95'][1]:.4g}"
            lines.append(f"  {effect['name']}.{name} = {p['value']:.4g} {p['unit']} ({interval})")
    if facts["ambiguous_with"]:
        lines.append(f"not to be told from: {', '.join(facts['ambiguous_with'])}")
    if residual := facts["residual"]:
        share = f"{residual['explained']:.0%} of the excess on held-out windows"
        lines.append(f"offered instead: a learned residual, {residual['vehicle']}, which takes {share}")
    if facts["next_manoeuvre"]:
        lines.append(f"drive next: {facts['next_manoeuvre']}")
    if gap := facts["gap"]:
        lines.append(
            f"gap over the noise: {gap['unfitted']:.2f} as configured, {gap['before']:.2f} refitted, "
            f"{gap['after']:.2f} with the effects found"
        )
    for remark in facts["remarks"]:
        lines.append(f"warning: {remark}")
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def _sweep_words(arguments: list[str]) -> list[str]:
    """Return the words with those that are racerl train's gathered under one key."""
    from racerl.config import own_keys, quote

    mine = own_keys("sweep")
    others = [
        word
        for word in arguments
        if "=" in word
        and not word.startswith("-")
        and word.lstrip("+~").partition("=")[0].partition(".")[0] not in mine
    ]
    quoted = ",".join(map(quote, others))
    kept = [word for word in arguments if word not in others]
    return [*kept, f"words=[{quoted}]"] if others else kept


def _sweep(settings: "Settings", out: Path) -> None:
    from racerl.config import compose_settings
    from racerl.console import Board
    from racerl.report.sweep_page import draw_sweep
    from racerl.sweep.sweep import RESULTS, sweep

    console = _console()
    try:
        with Board(console) as board:
            facts = sweep(settings, out, compose_settings, board.show)
    except KeyboardInterrupt:
        console.print("interrupted; the same command goes on", highlight=False)
        raise
    for claim in facts["claims"]:
        console.print(f"claim {claim['claim']}: {claim['verdict']}: {claim['says']}", highlight=False, soft_wrap=True)
    console.print(f"numbers in {out / RESULTS}, report in {draw_sweep(out)}", highlight=False, soft_wrap=True)
    if failed := facts["failed"]:
        words = "; ".join(f"{name}: {line}" for name, line in failed.items())
        planned = facts["jobs"]["planned"]
        raise RunError(f"{len(failed)} of {planned} jobs failed, the same command tries them again: {words}")


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
    console.print(f"numbers in {' and '.join(map(str, written))}", highlight=False, soft_wrap=True)


def _optimum(settings: "Settings", out: Path) -> None:
    from racerl.console import Bar
    from racerl.optimum.optimum import RACELINE, optimum

    console = _console()
    with Bar(console, "optimum") as bar:
        facts = optimum(settings, out, bar.show)
    held = facts["held"]
    console.print(
        f"{facts['time_s']:.3f} s with free commands, {held['time_s']:.3f} s with commands held for "
        f"{held['period_s']:.4f} s; found in {facts['seconds']:.0f} s",
        highlight=False,
    )
    console.print(f"raceline in {out / RACELINE}", highlight=False, soft_wrap=True)


def _print_identification(console: Any, facts: dict[str, Any]) -> None:
    from rich.table import Table

    from racerl.report.identification_page import error_rows, spread

    rows = [row for row in error_rows(facts) if row[1] == str(facts["horizon"])]
    table = Table("vehicle", *rows[0][2], title=f"error of {facts['horizon']}-sample rollouts (RMSE; m/s, rad/s, rad)")
    for label, _, channels in rows:
        table.add_row(label, *("diverged" if value is None else f"{value:.4f}" for value in channels.values()))
    console.print(table)
    if not facts["fitted"]:
        return
    table = Table("parameter", "value", "95 % interval", "unit", "before", "from the data alone")
    for name, p in facts["parameters"].items():
        interval = f"{p['ci95'][0]:.4g} … {p['ci95'][1]:.4g}"
        table.add_row(name, f"{p['value']:.4g}", interval, p["unit"], f"{p['start']:.4g}", spread(p))
    console.print(table)
    pairs = [" and ".join(pair["parameters"]) for pair in facts["not_separable"]]
    if pairs:
        more = f"; and {len(pairs) - PAIRS} more pairs" if len(pairs) > PAIRS else ""
        shown = f"{'; '.join(pairs[:PAIRS])}{more}"
        console.print(f"not separable (correlation above 0.95): {shown}", highlight=False, markup=False)


def _print_metrics(console: Any, metrics: dict[str, Any]) -> None:
    from rich.table import Table

    def text(key: str, digits: int) -> str:
        return "none" if metrics[key] is None else f"{metrics[key]:.{digits}f}"

    over = metrics["mean_over_optimum"]
    table = Table(
        "fastest valid [s]",
        "mean [s]",
        "over optimum",
        "std [s]",
        "E_off [m s]",
        "crashes",
        "laps",
        title=metrics["label"],
    )
    table.add_row(
        text("fastest_valid_lap_s", 3),
        text("mean_lap_s", 3),
        "unknown" if over is None else f"{over:+.1%}",
        text("std_lap_s", 3),
        text("e_off", 5),
        f"{metrics['crash_share']:.0%}",
        str(metrics["laps"]),
    )
    console.print(table)
    if metrics["optimum_s"] is None and metrics["controller"] != "recorded":
        console.print(
            "for the time-optimal lap beside it: racerl optimum, with the same vehicle, track, sim and action"
        )
    if metrics["nan_cars"]:
        console.print(f"warning: the simulation failed (NaN) for {metrics['nan_cars']} cars; counted as crashes")


def _report(settings: "Settings", out: Path) -> None:
    from racerl.report.report import report

    page = report(settings, out)
    _console().print(f"report in {page}", highlight=False, soft_wrap=True)


def _compare(settings: "Settings", out: Path) -> None:
    from racerl.report.compare import compare

    page = compare(settings, out)
    _console().print(f"report in {page}", highlight=False, soft_wrap=True)


def _data(settings: "Settings", out: Path) -> None:
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
    for warning in facts["warnings"]:
        console.print(f"warning: {warning}", highlight=False, soft_wrap=True, markup=False)
    console.print(f"report in {draw_logs(out)}", highlight=False, soft_wrap=True)


def _print_topics(console: Any, bag: "UnmappedBag") -> None:
    from rich.markup import escape
    from rich.table import Table

    table = Table("topic", "type", "messages")
    for topic in bag.topics:
        table.add_row(escape(topic.name), escape(topic.kind), f"{topic.messages:,}")
    console.print(table)
    if bag.draft:
        console.print(bag.draft, highlight=False, soft_wrap=True, markup=False)


def _print_log(console: Any, log: dict[str, Any]) -> None:
    from rich.markup import escape
    from rich.table import Table

    title = f"{log['name']}: {log['seconds']:.1f} s in {len(log['runs'])} runs at {log['rate_hz']:g} Hz"
    table = Table("channel", "unit", "least", "greatest", "noise", "new per s", title=escape(title))
    for name, channel in log["channels"].items():
        noise = "–" if channel["noise"] is None else f"{channel['noise']:.2g}"
        row = (channel["unit"], f"{channel['min']:.3f}", f"{channel['max']:.3f}", noise, f"{channel['updates_hz']:.0f}")
        table.add_row(name, *row)
    console.print(table)
    lines = [f"not in the log: {', '.join(log['missing'])}"] if log["missing"] else []
    lines += [*log["remarks"], *(f"warning: {warning}" for warning in log["warnings"])]
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def _console() -> Any:
    from rich.console import Console

    return Console()


def main() -> None:
    """Run the command line; a user's mistake ends with one line and exit code 2."""
    try:
        code = app(standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort):
        raise SystemExit(130) from None
    except Exception as error:
        # Typer's own complaints are not exported as one class; all of them can format themselves
        complaint = error.format_message() if hasattr(error, "format_message") else None
        if complaint is None and not isinstance(error, RacerlError):
            raise
        sys.stderr.write(f"racerl: {' '.join((complaint or str(error)).split())}\n")
        raise SystemExit(2) from None
    raise SystemExit(code if isinstance(code, int) else 0)


if __name__ == "__main__":
    main()
