"""What a sweep asks: `sweeps/*.yaml`, one question each, with arms, seeds, metrics, and the claims that it decides.

The runner and the report read the same file. A `./sweeps` beside the user comes before the packaged one.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from racerl import bounds
from racerl.documents import packaged, read_yaml
from racerl.errors import ConfigError, suggest
from racerl.registry import construct


@dataclass(frozen=True)
class Metric:
    """What is measured: its name in a sentence, its unit, how many of it 1 is, and the digits it is told with."""

    name: str
    unit: str
    scale: float = 1.0
    digits: int = 3

    @property
    def head(self) -> str:
        """Return it as the head of a column."""
        return f"{self.name} [{self.unit}]"


MODEL, TWIN = "model", "twin"  # cars
REQUIRED, OPTIONAL = ("question", "base", "arms", "seeds", "metrics"), ("claims", "cars", "twins")  # keys of a file
LISTING = ("question", "sweeps", "twins")  # keys of a file that stands for several sweeps
ARRIVALS = (10, 5, 3, 2)  # % over the time-optimal lap, that a training's examination comes down to
METRICS = {
    "lap_time": Metric("mean lap", "s"),
    "fastest": Metric("fastest valid lap", "s"),
    "e_off": Metric("E_off", "m s", digits=5),
    "crash_share": Metric("share of laps with a crash", "%", 100.0, 0),
    "valid_share": Metric("share of laps that never leave the track", "%", 100.0, 0),
    "off_track": Metric("furthest way off the track", "m"),
    "turn_in": Metric("lead of the steering over the track's curvature", "m"),
    "reward": Metric("training reward per step", "m", digits=4),
    **{f"to_{percent}": Metric(f"training to {percent} % over the optimum", "s", digits=0) for percent in ARRIVALS},
}
OF_TRAINING = ("reward", *(f"to_{percent}" for percent in ARRIVALS))  # of a training, not of the laps driven


@dataclass(frozen=True)
class Comparison:
    """A contrast between arms and the side of a limit that it must lie on, in one car.

    Σ w_k m(arm_k), w given (`contrast`) or those of the least-squares slope over numbers (`slope`), divided by the
    metric of the arm `relative_to`.
    """

    metric: str
    contrast: Mapping[str, float] = field(default_factory=dict)
    slope: Mapping[str, float] = field(default_factory=dict)
    car: str = TWIN
    relative_to: str | None = None
    above: float | None = None
    below: float | None = None
    within: float | None = None

    def __post_init__(self) -> None:
        if self.metric not in METRICS:
            raise ConfigError(f"unknown metric '{self.metric}'{suggest(self.metric, METRICS)}")
        if bool(self.contrast) == bool(self.slope):
            raise ConfigError("a test compares arms: give either contrast or slope, a mapping from arms to numbers")
        if len(self.limit) != 1:
            raise ConfigError("a test has one limit: above, below or within")
        ((side, limit),) = self.limit.items()
        bounds.number(side, limit, -1e6, 1e6)
        for where, numbers in (("contrast", self.contrast), ("slope", self.slope)):
            if not isinstance(numbers, Mapping):
                raise ConfigError(f"{where} = {numbers}: a mapping from arms to numbers is expected")
            for arm, number in numbers.items():
                bounds.number(f"{where}.{arm}", number, -1e6, 1e6)
        if self.slope and len(set(self.slope.values())) < 2:
            raise ConfigError(f"slope = {dict(self.slope)}: two different numbers at least are needed")

    @property
    def weights(self) -> dict[str, float]:
        """Weight of every arm."""
        if self.contrast:
            return {arm: float(weight) for arm, weight in self.contrast.items()}
        middle = sum(self.slope.values()) / len(self.slope)
        square = sum((x - middle) ** 2 for x in self.slope.values())
        return {arm: (x - middle) / square for arm, x in self.slope.items()}

    @property
    def limit(self) -> dict[str, float]:
        """Side and value of the limit."""
        limits = {"above": self.above, "below": self.below, "within": self.within}
        return {side: value for side, value in limits.items() if value is not None}

    @property
    def arms(self) -> set[str]:
        """Arms that it needs."""
        return {*self.weights, *([self.relative_to] if self.relative_to else [])}

    def holds(self, low: float, high: float) -> bool | None:
        """Return whether an interval lies on the claimed side, or on the other; None where it lies on both."""
        ((side, limit),) = self.limit.items()
        inside, outside = {
            "above": (low > limit, high < limit),
            "below": (high < limit, low > limit),
            "within": (-limit < low and high < limit, low > limit or high < -limit),
        }[side]
        return True if inside else False if outside else None


@dataclass(frozen=True)
class Claim:
    """What the paper says, by its number, and the tests that must all hold."""

    number: int
    says: str
    tests: tuple[Comparison, ...]


@dataclass(frozen=True)
class Sweep:
    """One question: arms, each the words for `racerl train` that set it apart from the base, and seeds."""

    name: str
    question: str
    base: tuple[str, ...]
    arms: Mapping[str, tuple[str, ...]]
    seeds: tuple[int, ...]
    metrics: tuple[str, ...]
    claims: tuple[Claim, ...]
    cars: tuple[str, ...] = (MODEL, TWIN)
    twins: tuple[str, ...] = ()  # cars in whose place of the twin its claims are judged, too


def folder() -> Path:
    """Return the folder of packaged sweeps."""
    return packaged("sweeps")


def names() -> list[str]:
    """Return the names of all sweeps that are there."""
    return sorted({path.stem for place in (Path("sweeps"), folder()) for path in place.glob("*.yaml")})


def read_sweeps(name: str) -> list[Sweep]:
    """Return the sweeps that a name stands for: itself, or those it lists; raise ConfigError or DocumentError."""
    content = read_yaml(_path(name))
    if "sweeps" not in content:
        return [_sweep(name, content)]
    for key in content:
        if key not in LISTING:
            raise ConfigError(f"sweeps/{name}.yaml: unknown key '{key}'{suggest(key, LISTING)}")
    listed, twins = _words(name, "sweeps", content["sweeps"]), tuple(_words(name, "twins", content.get("twins", [])))
    if not listed:
        raise ConfigError(f"sweeps/{name}.yaml: sweeps = []: one at least is needed")
    sweeps = [_sweep(each, read_yaml(_path(each))) for each in listed]
    return [replace(sweep, twins=twins or sweep.twins) for sweep in sweeps]


def _path(name: str) -> Path:
    for place in (Path("sweeps"), folder()):
        if Path(name).name == name and (place / f"{name}.yaml").is_file():
            return place / f"{name}.yaml"
    raise ConfigError(f"unknown sweep '{name}'{suggest(name, names())}; one of your own is sweeps/NAME.yaml")


def _sweep(name: str, content: Mapping[str, Any]) -> Sweep:
    for key in content:
        if key not in REQUIRED + OPTIONAL:
            raise ConfigError(f"sweeps/{name}.yaml: unknown key '{key}'{suggest(key, REQUIRED + OPTIONAL)}")
    for key in REQUIRED:
        if key not in content:
            raise ConfigError(f"sweeps/{name}.yaml: {key} is missing; give it a value")
    arms = content["arms"]
    if not isinstance(arms, Mapping) or not arms:
        raise ConfigError(f"sweeps/{name}.yaml: arms is a mapping from names to words for racerl train")
    for key in ("cars", "seeds"):
        if content.get(key) == []:
            raise ConfigError(f"sweeps/{name}.yaml: {key} = []: one at least is needed")
    sweep = Sweep(
        name=name,
        question=str(content["question"]),
        base=tuple(_words(name, "base", content["base"])),
        arms={str(arm): tuple(_words(name, f"arms.{arm}", words)) for arm, words in arms.items()},
        seeds=tuple(bounds.wholes(f"sweeps/{name}.yaml: seeds", content["seeds"], 0, 2**31 - 1)),
        metrics=tuple(_words(name, "metrics", content["metrics"])),
        claims=tuple(_claims(name, content.get("claims") or {})),
        cars=tuple(_words(name, "cars", content.get("cars", [MODEL, TWIN]))),
        twins=tuple(_words(name, "twins", content.get("twins", []))),
    )
    for metric in sweep.metrics:
        if metric not in METRICS:
            raise ConfigError(f"sweeps/{name}.yaml: unknown metric '{metric}'{suggest(metric, METRICS)}")
    for claim in sweep.claims:
        for arm in sorted(set().union(*(test.arms for test in claim.tests)) - set(sweep.arms)):
            raise ConfigError(f"sweeps/{name}.yaml: claim {claim.number}: no arm '{arm}'{suggest(arm, sweep.arms)}")
        for car in sorted({test.car for test in claim.tests} - {TWIN, *sweep.cars}):  # the twin need not be raced in
            raise ConfigError(f"sweeps/{name}.yaml: claim {claim.number}: no car '{car}'{suggest(car, sweep.cars)}")
    return sweep


def _claims(name: str, content: Any) -> Iterator[Claim]:
    if not isinstance(content, Mapping):
        raise ConfigError(f"sweeps/{name}.yaml: claims is a mapping from the paper's numbers to says and tests")
    for number, claim in content.items():
        where = f"sweeps/{name}.yaml: claims.{number}"
        if not isinstance(claim, Mapping) or set(claim) != {"says", "tests"}:
            raise ConfigError(f"{where}: says and tests are expected")
        if not isinstance(claim["tests"], list) or not claim["tests"]:
            raise ConfigError(f"{where}: tests is a list of one or more")
        tests = tuple(construct(Comparison, test, where) for test in claim["tests"])
        yield Claim(bounds.whole(f"{where}: number", number, 1, 1000), str(claim["says"]), tests)


def _words(name: str, key: str, value: Any) -> Sequence[str]:
    if not isinstance(value, list) or not all(isinstance(word, str) for word in value):
        raise ConfigError(f"sweeps/{name}.yaml: {key} = {value}: a list of words is expected")
    return value
