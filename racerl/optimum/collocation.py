"""The minimum-time lap by direct collocation along the corridor.

With the motion ds/dt, dz/dt of `along`, over the line's arc length:  dz/ds = dz/dt dt/ds,  T = ∫ dt/ds ds → min.

Radau points, two to an interval; commands are constant over an interval. The lap is periodic.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from racerl.env.actions import Action, half_range, middle
from racerl.errors import OptimumError
from racerl.interruption import not_swallowed
from racerl.optimum.along import DELTA, OMEGA, V_X, V_Y, XI, YAW_RATE, N, motion, scales
from racerl.optimum.corridor import Corridor, Stretch
from racerl.vehicle.vehicle import Vehicle

ORDER = 2  # collocation points per interval
MOST_TURN = 1.0  # rad, |ξ|; with 1.4 laps that slide sideways through a hairpin are found, slower local minima
GRIP_USED = 0.3  # of the weight, by the first guess in the tightest turn
SLOWEST = 0.2  # of the first guess's speed
LEAST_SHARE = 0.05  # of the corridor's width, left by `room`
MOST_ITERATIONS = 500  # usual are 25 to 320; a limit in time would make a busy machine fail

Array = NDArray[np.float64]
Guess = Callable[[Array, Array], tuple[Array, Array]]
"""From shares of the lap of points (M,) and intervals (N,) to states (Z, M) and scaled commands (2, N)."""


@dataclass(frozen=True)
class Solution:
    """A lap over the points of its mesh; the last point is the first again."""

    vehicle: Vehicle
    action: Action
    stretch: Stretch  # of the points, M = ORDER·N
    states: Array  # (Z, M)
    commands: Array  # (2, N), scaled to ± 1
    durations: Array  # (N,), s

    @property
    def time(self) -> float:
        """The lap time in s."""
        return float(self.durations.sum())

    @property
    def ends(self) -> Array:
        """Times at the ends of the intervals, (N + 1,) from 0, in s."""
        return np.concatenate([[0.0], np.cumsum(self.durations)])

    @property
    def times(self) -> Array:
        """Times at the points, (M,) in s."""
        share = self.stretch.s / self.stretch.s[-1] * len(self.durations)
        return np.interp(share, np.arange(len(self.ends)), self.ends)

    @property
    def cartesian(self) -> Array:
        """The car's states at the points, (S, M), yaw unwrapped."""
        z, line = self.states, self.stretch
        place = [line.x - z[N] * np.sin(line.yaw), line.y + z[N] * np.cos(line.yaw), line.yaw + z[XI]]
        return np.stack([*place, *z[V_X : len(self.vehicle.states) - 1]])

    @property
    def references(self) -> Array:
        """Steering reference in rad and drive reference in m/s or A over the intervals' middles, (2, N)."""
        drive = self.commands[1] * half_range(self.action) + middle(self.action)
        if self.action.integrated:
            ends = self.states[-1, ORDER - 1 :: ORDER]
            drive = (ends + np.roll(ends, 1)) / 2
        return np.stack([self.commands[0] * self.action.steering_max, drive])

    @property
    def largest_sideslip(self) -> float:
        """The greatest angle between nose and course, in rad."""
        return float(np.abs(np.arctan2(self.states[V_Y], self.states[V_X])).max())

    @property
    def turn(self) -> float:
        """What a lap adds to the yaw, a multiple of 2π."""
        return float(2 * np.pi * np.round((self.stretch.yaw[-1] - self.stretch.yaw[0]) / (2 * np.pi)))

    @property
    def guess(self) -> Guess:
        """Return this lap as the first guess for another mesh."""
        length, count = self.stretch.s[-1], len(self.durations)
        known = np.concatenate([[0.0], self.stretch.s / length])

        def guess(points: Array, intervals: Array) -> tuple[Array, Array]:
            table = np.column_stack([self.states[:, -1], self.states])
            states = np.stack([np.interp(points, known, row) for row in table])
            return states, self.commands[:, np.minimum((intervals * count).astype(int), count - 1)]

        return guess


class Collocation:
    """The problem on one mesh, `room` metres inside the boundaries and with v_x up to `fastest` m/s."""

    def __init__(
        self,
        vehicle: Vehicle,
        action: Action,
        corridor: Corridor,
        intervals: int,
        room: float = 0.0,
        fastest: float = np.inf,
    ) -> None:
        self.vehicle, self.action, self.intervals = vehicle, action, intervals
        self.room, self.fastest = room, fastest
        self.integrated = action.integrated
        self.step = corridor.length / intervals
        tau = np.array(casadi.collocation_points(ORDER, "radau"))
        s = ((np.arange(intervals)[:, None] + tau) * self.step).ravel()
        self.stretch = corridor.at(s)
        self.shares = s / corridor.length
        self.scale = scales(vehicle, action)
        self._interval = self._make_interval(tau)

    def guess(self, sliding: float) -> Guess:
        """Return a lap along the line at one speed, with this sideslip in rad in the tightest turn, less in others."""
        tightest = max(1e-3, float(np.abs(self.stretch.curvature).max()))
        speed = min(float(np.clip(np.sqrt(GRIP_USED * 9.81 / tightest), 0.5, 20.0)), self.fastest)

        def guess(points: Array, intervals: Array) -> tuple[Array, Array]:
            kappa = np.interp(points, self.shares, self.stretch.curvature)
            sideslip = -sliding * kappa / tightest
            states = np.zeros((len(self.scale), len(points)))
            states[XI], states[V_X], states[V_Y] = -sideslip, speed * np.cos(sideslip), speed * np.sin(sideslip)
            states[YAW_RATE], states[OMEGA] = speed * kappa, speed
            most = 0.9 * self.action.steering_max
            states[DELTA] = np.clip(np.arctan(float(self.vehicle.wheelbase) * kappa), -most, most)
            if self.integrated:
                states[-1] = speed
            commands = np.zeros((2, len(intervals)))
            commands[0] = np.interp(intervals, points, states[DELTA]) / self.action.steering_max
            if not self.integrated and self.action.drive_mode == "wheel_speed":
                commands[1] = (speed - middle(self.action)) / half_range(self.action)
            return states, commands

        return guess

    def solve(self, guess: Guess) -> Solution:
        """Return the lap that ipopt finds from a guess; raise OptimumError when it finds none."""
        count, Z = self.intervals, len(self.scale)
        points, commands = casadi.MX.sym("Z", Z, ORDER * count), casadi.MX.sym("U", 2, count)
        ends = points[:, ORDER - 1 :: ORDER]
        begins = casadi.horzcat(ends[:, -1], ends[:, :-1])
        defects, durations = self._interval.map(count)(
            begins, points, commands, self.stretch.curvature.reshape(count, ORDER).T
        )
        unknowns = casadi.vertcat(casadi.vec(points), casadi.vec(commands))
        low, high = self._bounds()
        first, first_commands = guess(self.shares, np.arange(count) / count)
        start = np.concatenate([(first / self.scale[:, None]).T.ravel(), first_commands.T.ravel()])
        found = minimise(casadi.sum2(durations), unknowns, casadi.vec(defects), start, low, high)
        states, u = found[: Z * ORDER * count].reshape(-1, Z).T, found[Z * ORDER * count :].reshape(-1, 2).T
        seconds = np.array(casadi.Function("t", [unknowns], [durations])(found)).ravel()
        return Solution(self.vehicle, self.action, self.stretch, states * self.scale[:, None], u, seconds)

    def _make_interval(self, tau: Array) -> Any:
        """Return (z_0, Z (Z, ORDER), u, κ (ORDER,)) → (defects, seconds) of one interval, all scaled."""
        z_0, points = casadi.SX.sym("z0", len(self.scale)), casadi.SX.sym("Z", len(self.scale), ORDER)
        u, kappa = casadi.SX.sym("u", 2), casadi.SX.sym("k", ORDER)
        C, _, B = casadi.collocation_coeff(list(tau))
        slopes = casadi.horzcat(z_0, points) @ C
        defects, seconds = [], 0
        for j in range(ORDER):
            rate, slowness = self._rate(points[:, j] * self.scale, u, kappa[j])
            defects.append(self.step * rate / self.scale - slopes[:, j])
            seconds += self.step * B[j] * slowness
        inputs = [z_0, points, u, kappa]
        return casadi.Function("interval", inputs, [casadi.vertcat(*defects), seconds], {"cse": True})

    def _rate(self, z: Any, u: Any, kappa: Any) -> tuple[Any, Any]:
        """Return dz/ds and dt/ds."""
        speed, rows = motion(self.vehicle, self.action, z, u, kappa)
        return casadi.vertcat(*rows) / speed, 1 / speed

    def _bounds(self) -> tuple[Array, Array]:
        low = np.full((len(self.scale), len(self.shares)), -np.inf)
        high = -low
        # where the corridor is narrower than the room asked for, its middle is left
        middle_n, half = (self.stretch.high + self.stretch.low) / 2, (self.stretch.high - self.stretch.low) / 2
        half = np.maximum(half - self.room, LEAST_SHARE * half)
        low[N], high[N] = middle_n - half, middle_n + half
        low[XI], high[XI] = -MOST_TURN, MOST_TURN
        low[V_X] = SLOWEST * self.guess(0.0)(self.shares[:1], self.shares[:1])[0][V_X]
        high[V_X] = self.fastest
        low[DELTA], high[DELTA] = -self.action.steering_max, self.action.steering_max
        low[OMEGA] = 0.0
        if self.integrated:
            low[-1], high[-1] = self.action.drive_min, self.action.drive_max
        commands = np.ones(2 * self.intervals)
        scaled = [(bound / self.scale[:, None]).T.ravel() for bound in (low, high)]
        return np.concatenate([scaled[0], -commands]), np.concatenate([scaled[1], commands])


def minimise(
    cost: Any, unknowns: Any, equal: Any, start: Array, low: Array, high: Array, positive: Any = None
) -> Array:
    """Return the unknowns of least cost with `equal` = 0, `positive` ≥ 0 and bounds; OptimumError when ipopt fails."""
    options: dict[str, Any] = {
        "ipopt.print_level": 0,
        "print_time": False,
        "ipopt.sb": "yes",
        "ipopt.max_iter": MOST_ITERATIONS,
        "ipopt.tol": 1e-6,
    }
    constraints = casadi.vertcat(equal, casadi.MX(0, 1) if positive is None else positive)
    greatest = np.concatenate([np.zeros(equal.numel()), np.full(constraints.numel() - equal.numel(), np.inf)])
    problem: Any = {"x": unknowns, "f": cost, "g": constraints}
    solver = casadi.nlpsol("lap", "ipopt", problem, options)
    with not_swallowed():
        result = solver(x0=np.clip(start, low, high), lbx=low, ubx=high, lbg=0.0, ubg=greatest)
    stats = solver.stats()
    if not stats["success"]:
        raise OptimumError(
            f"no time-optimal lap found: ipopt says {stats['return_status']} after {stats['iter_count']} iterations; "
            "can the car turn as tightly as the track does?"
        )
    return np.array(result["x"]).ravel()
