"""The excitation programme: it stays on its floor, whatever the car, and shows what a car can do."""

import numpy as np
import pytest

from racerl.config import compose_settings
from racerl.errors import ConfigError
from racerl.record.manoeuvres import Manoeuvre
from racerl.record.record import Plan, slips
from racerl.record.simulate import Plant
from tests.record.conftest import drive, room_left

KINDS = {
    cls(speed=1.0, seconds=1.0, **dict.fromkeys(cls.__annotations__, 1)).kind for cls in Manoeuvre.__subclasses__()
}
TRANSIT = {"transit", "brake", "reverse"}
CARS = {
    "slippery": ["vehicle.friction=0.4"],
    "grippy": ["vehicle.friction=1.2"],
    "sluggish": ["vehicle.steering.time_constant=0.15", "vehicle.wheel_speed.time_constant=0.2"],
    "crooked": ["+vehicle/effect=[steering_offset,tyre_relaxation]"],
    "loose tail": ["vehicle.rear.p_Dy1=0.55"],
    "motor current": ["sim=motor_current", "step=0.001"],
    **{f"hidden {seed}": ["hidden.spread=0.3", f"hidden.seed={seed}", f"seed={seed}"] for seed in range(3)},
    "hidden and slippery": ["hidden.spread=0.3", "hidden.seed=5", "vehicle.friction=0.4"],
}
FEW = ("sluggish", "loose tail", "hidden and slippery")


@pytest.mark.parametrize("name", [n if n in FEW else pytest.param(n, marks=pytest.mark.slow) for n in CARS])
def test_the_car_stays_on_the_floor_and_is_excited(name):
    recording, log = drive("seconds=200", *CARS[name])
    assert room_left(recording) > 0.0
    driven = set(log["manoeuvre"]) - TRANSIT
    assert len(driven) >= 8
    assert recording.truth[:, 3].max() > 2.0


def test_a_car_that_turns_less_than_its_driver_knows_backs_up_and_stays(monkeypatch):
    advance = Plant.advance
    monkeypatch.setattr(Plant, "advance", lambda car, delta, omega: advance(car, min(max(delta, -0.28), 0.28), omega))
    settings = compose_settings("record", ["seconds=200"])
    recording = Plan.of(settings).drive()
    assert room_left(recording) > 0.0 and "reverse" in recording.doing


@pytest.mark.parametrize("floor", [(8.0, 12.0), (7.0, 7.0), (20.0, 15.0)])
def test_other_floors(floor):
    recording, _ = drive("seconds=200", f"floor=[{floor[0]},{floor[1]}]")
    assert room_left(recording, floor) > 0.0


def test_a_floor_too_small_to_turn_on_is_refused():
    with pytest.raises(ConfigError, match=r"floor = \[3.0, 8.0\]: this car needs"):
        Plan.of(compose_settings("record", ["floor=[3,8]"]))


def test_every_kind_happens_to_both_sides(programme):
    recording, log = programme
    assert room_left(recording) > 0.0
    assert set(log["manoeuvre"]) - TRANSIT == KINDS
    for kind in ("step_steer", "ramp_to_lock", "steering_chirp", "brake_in_turn", "power_in_turn", "flick", "circle"):
        steering = log.loc[log["manoeuvre"] == kind, "delta_ref"]
        assert steering.max() > 0.15 and steering.min() < -0.15, kind


def test_most_manoeuvres_are_driven_to_their_end(programme):
    _, log = programme
    doing = log["manoeuvre"].astype(str)
    piece = (doing != doing.shift()).cumsum()
    steps = log[doing == "step_steer"].groupby(piece)["t"].agg(lambda t: t.iloc[-1] - t.iloc[0])
    assert (steps > 0.9).mean() > 0.6


def test_slips_beyond_the_usual(programme):
    recording, _ = programme
    vehicle = Plan.of(compose_settings("record", [])).vehicle
    reached = slips(vehicle, recording.truth)
    moving = reached[reached["speed"] > 1.0]
    for name, angle in (("alpha_f", 0.3), ("alpha_r", 0.2), ("kappa", 0.3)):
        low, high = moving[name].quantile([0.01, 0.99])
        assert low < -angle and high > angle, name


def test_the_chirp_reaches_five_hertz(programme):
    _, log = programme
    doing = log["manoeuvre"].astype(str)
    power = {}
    for _, rows in log[doing == "steering_chirp"].groupby((doing != doing.shift()).cumsum()):
        if len(rows) > 300:
            steering = rows["delta_ref"] - rows["delta_ref"].mean()
            spectrum = np.abs(np.fft.rfft(steering)) ** 2
            frequency = np.fft.rfftfreq(len(rows), 0.01)
            for centre in (0.5, 1.0, 2.0, 4.0, 4.8, 10.0):
                band = (frequency > 0.8 * centre) & (frequency < 1.2 * centre)
                power[centre] = max(power.get(centre, 0.0), float(spectrum[band].sum() / spectrum.sum()))
    assert min(power[centre] for centre in (0.5, 1.0, 2.0, 4.0, 4.8)) > 0.02 > power[10.0]


def test_the_first_block_comes_again_at_the_end(programme):
    _, log = programme

    def commands(run):
        rows = log[(log["run"] == run) & ~log["manoeuvre"].isin(TRANSIT)]
        doing = rows["manoeuvre"].astype(str)
        first = (doing != doing.shift()) | (rows["t"].diff() > 0.015)
        return list(doing[first]), rows

    (first, early), (last, late) = commands(0), commands(log["run"].max())
    last = [kind for kind in last if kind != "rest"]
    assert first == last
    for kind in set(first):
        a, b = (rows.loc[rows["manoeuvre"] == kind, "delta_ref"].to_numpy() for rows in (early, late))
        # braking ends when a noisy speed says so: a sample or two earlier or later
        both = min(len(a), len(b))
        assert abs(len(a) - len(b)) <= 2 and np.mean(np.isclose(a[:both], b[:both])) > 0.98


def test_runs_last_about_half_a_minute(programme):
    _, log = programme
    seconds = log.groupby("run")["t"].agg(lambda t: t.iloc[-1] - t.iloc[0])
    assert seconds.iloc[1:-1].between(10.0, 60.0).all()
