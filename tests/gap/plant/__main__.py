"""Write logs of the blind test: python -m tests.gap.plant OUT --set single --sizes medium,large --noises 1 --limit 20.

OUT/logs/<case>.parquet are the logs, OUT/keys.json says what each hides. Cases that OUT holds already are left alone.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from tests.gap.plant.batch import batches, key, simulate
from tests.gap.plant.car import SLIPS, STRUCTURES
from tests.gap.plant.cases import SETS, Case, Choice
from tests.gap.plant.effects import ALL, SIZES
from tests.gap.plant.effects.base import STEP
from tests.gap.plant.families import MAGIC_FORMULA, TYRES
from tests.gap.plant.programmes import PROGRAMMES
from tests.gap.plant.sensors import SENSORS


def main(arguments: Sequence[str] | None = None) -> None:
    """Simulate the chosen cases and write them."""
    options = _parser().parse_args(arguments)
    cases = _chosen(options)
    keys_file, logs = options.out / "keys.json", options.out / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    keys = json.loads(keys_file.read_text()) if keys_file.exists() else {}
    missing = [case for case in cases if case.name not in keys]
    print(f"{len(cases)} cases, {len(missing)} to simulate")
    for batch in batches(missing, options.batch):
        started = time.monotonic()
        for case, log in zip(batch, simulate(batch), strict=True):
            log.to_parquet(logs / f"{case.name}.parquet", index=False)
        keys |= {case.name: key(case) for case in batch}
        keys_file.write_text(json.dumps(dict(sorted(keys.items())), indent=1))
        print(f"{len(batch)} × {batch[0].programme} in {time.monotonic() - started:.0f} s", flush=True)


def _chosen(options: argparse.Namespace) -> list[Case]:
    """The cases of the sets asked for; a limit takes those first whose opaque names come first."""
    choice = Choice(
        seed=options.seed,
        sizes=options.sizes,
        noises=options.noises,
        programmes=options.programmes,
        effects=options.effects,
        minutes=options.minutes,
        direction=options.direction,
        velocities=options.velocities,
        family=options.tyre,
        slip=options.slip,
        floor=options.floor,
        structure=options.structure,
        sensors=options.sensors,
        step=options.step,
    )
    cases = [case for name in options.set for case in SETS[name](choice)]
    return sorted(cases, key=lambda case: case.origin)[: options.limit]


def _parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.gap.plant", description=__doc__)
    parser.add_argument("out", type=Path, help="folder to write to")
    parser.add_argument("--set", type=_names(SETS), required=True, help=" ".join(SETS))
    parser.add_argument("--sizes", type=_names(SIZES), help=" ".join(SIZES))
    parser.add_argument("--noises", type=lambda text: tuple(float(x) for x in text.split(",")), help="factors: 0.5,1,3")
    parser.add_argument("--programmes", type=_names(PROGRAMMES), help=" ".join(PROGRAMMES))
    parser.add_argument("--effects", type=_names(ALL), help="names, comma-separated")
    parser.add_argument("--minutes", type=float, help="length of each log; the programme's own if not given")
    parser.add_argument("--direction", choices=("both", "one"), default="both", help="ways round in the race")
    parser.add_argument("--velocities", choices=("measured", "differentiated"), default="measured")
    parser.add_argument("--tyre", choices=TYRES, default=MAGIC_FORMULA, help="the tyres' family")
    parser.add_argument("--slip", choices=tuple(SLIPS), default="centre", help="whose speed slips are over")
    parser.add_argument("--floor", type=float, default=1.0, help="grip of the floor, times each car's own")
    parser.add_argument("--structure", choices=STRUCTURES, default="single_track", help="wheels and their loads")
    parser.add_argument("--sensors", choices=tuple(SENSORS), default="ideal", help="what they do beside noise")
    parser.add_argument("--step", type=_step, default=STEP, help="of the integration, in s; divides 1 ms")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit", type=int, help="at most so many cases")
    parser.add_argument("--batch", type=int, default=64, help="cars simulated side by side")
    return parser


def _step(text: str) -> float:
    """A time step, of which whole numbers are a sample and a command."""
    value = float(text)
    if not 1e-6 <= value <= STEP or abs(STEP / value - round(STEP / value)) > 1e-6:
        raise argparse.ArgumentTypeError(f"{text} s: a whole part of {STEP} s is expected")
    return value


def _names(known: Iterable[str]) -> Callable[[str], tuple[str, ...]]:
    """A parser of comma-separated names that must be among the known."""
    allowed = tuple(known)

    def parse(text: str) -> tuple[str, ...]:
        names = tuple(text.split(","))
        unknown = [name for name in names if name not in allowed]
        if unknown:
            raise argparse.ArgumentTypeError(f"no {', '.join(unknown)}; known: {', '.join(allowed)}")
        return names

    return parse


if __name__ == "__main__":
    main()
