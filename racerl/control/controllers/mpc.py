"""Model-predictive control in real time: one linearised step towards the optimal commands at every control period.

The plan of the period before is moved on, its first state becomes the car's, predicted to when a command given now will
act, and one Gauss–Newton step is taken (the real-time iteration), damped by `damping` h/2 |Δw|² in scaled steps. Where
neither solver finds the step, the car is driven slowly along the line, and so is a car that has just started: that
drive is the first plan.
"""

from collections import deque
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from racerl import bounds
from racerl.control.controllers import Known
from racerl.control.horizon import Horizon, Path, Weights
from racerl.control.stage_qp import ROWS, Problem, StageQp
from racerl.env.actions import outputs
from racerl.env.race import Race
from racerl.errors import ConfigError
from racerl.optimum.along import V_X, XI, YAW_RATE, LineFrame, N
from racerl.optimum.corridor import Corridor
from racerl.vehicle.delay import delayed
from racerl.vehicle.ops import TORCH
from racerl.vehicle.vehicle import COMMAND, GRAVITY, STATE

FIRST_STEPS = 10  # from the first plan
LARGEST_STEP = 1.0  # of any state, in its scale; a longer one is cut short, for the linearisation does not reach so far
SLACK = 1e-3  # curvature of the cost in the slack, which keeps the problem strictly convex
# of the drive along the line, where there is no plan: grip used, speeds in m/s, gains of n in rad/m, of ξ, of r in s
GRIP, SLOWEST, FASTEST = 0.25, 0.8, 3.0
GAINS = (1.0, 1.2, 0.1)
SIGHT = 1.5  # m ahead that it slows down for
LONGEST = 0.02  # s, of a step of the prediction

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mpc:
    """The controller's settings."""

    # least and greatest of what racerl tune looks for
    SEARCH: ClassVar[dict[str, tuple[float, float]]] = {
        "q_sideslip": (1e-4, 1.0),
        "q_steering": (1e-4, 1.0),
        "q_drive": (1e-5, 0.1),
        "q_boundary": (10.0, 1000.0),
        "room": (0.005, 0.1),
        "turn": (0.7, 1.3),
        "damping": (0.1, 10.0),
    }
    delay: float  # s, from measurement to command
    nodes: int
    horizon: float  # s
    q_sideslip: float  # 1/(rad² s)
    q_steering: float  # 1/(rad² s)
    q_drive: float  # s/m²
    q_boundary: float  # 1/(m s)
    room: float  # m, kept to the boundaries
    turn: float  # rad, the largest heading against the line
    damping: float
    compiled: bool = True

    def __post_init__(self) -> None:
        bounds.number("controller.delay", self.delay, 0.0, 0.2, "s")
        bounds.whole("controller.nodes", self.nodes, 5, 400)
        bounds.number("controller.horizon", self.horizon, 0.2, 10.0, "s")
        for name in ("q_sideslip", "q_steering", "q_drive", "q_boundary", "room", "turn"):
            bounds.number(f"controller.{name}", getattr(self, name), 0.0, 1e5)
        bounds.number("controller.damping", self.damping, 1e-6, 1e4)

    def prepare(self, known: Known) -> "Pilot":
        """Return the controller for a car and its track."""
        if known.action.drive_mode != "wheel_speed":
            raise ConfigError(
                f"controller = mpc: commands wheel speeds, not {known.action.drive_mode}; use sim=default"
            )
        return Pilot(self, known)


class Plan:
    """One car's plan: the path ahead, and the commands that were given, newest first."""

    def __init__(self, path: Path, given: deque[tuple[float, float]]) -> None:
        self.path, self.given = path, given


class Pilot:
    """The controller at work."""

    name = "MPC"

    def __init__(self, settings: Mpc, known: Known) -> None:
        self.settings, self.known = settings, known
        self.corridor = Corridor(known.track)
        weights = Weights(
            sideslip=settings.q_sideslip,
            steering=settings.q_steering,
            drive=settings.q_drive,
            boundary=settings.q_boundary,
            room=settings.room,
            turn=settings.turn,
        )
        vehicle, action = known.vehicle, known.action
        self.horizon = Horizon(
            vehicle, action, self.corridor, weights, settings.nodes, settings.horizon, settings.compiled
        )
        self.qp = StageQp(settings.nodes, self.horizon.states, 2)
        # when the commands given now act, and for how many periods those before matter
        delays = {name: float(value) + settings.delay for name, value in vehicle.delays().items()}
        self._delays = {name: delays.get(name, settings.delay) for name in COMMAND}
        self._lateness = max(self._delays.values())
        self._past = 2 + int(self._lateness / known.timing.dt)
        self._plans: list[Plan | None] = []
        self._line: LineFrame | None = None
        self.solved = self.fallbacks = 0

    @property
    def facts(self) -> dict[str, Any]:
        """Return how many steps were planned, and how often a solver failed."""
        return {"steps": self.solved, "second_solver": self.qp.handed_over, "fallbacks": self.fallbacks}

    def act(self, race: Race) -> Tensor:
        """Return the actions for the cars of a race."""
        if self._line is None or len(self._plans) != race.count:
            self._line, self._plans = LineFrame(self.corridor, race), [None] * race.count
        state, place = race.seen()
        s, z = self._line.locate(race, state[: len(STATE)], place[0])
        seen = np.column_stack([s.double().numpy(), z.double().numpy()])
        begun = (race.age == 0).tolist()
        actions = [
            self._drive(car, seen[car], (float(race.command[0, car]), float(race.command[1, car])), begun[car])
            for car in range(race.count)
        ]
        return torch.tensor(np.array(actions), dtype=race.dtype)

    def _drive(self, car: int, seen: Array, command: tuple[float, float], begun: bool) -> Array:
        """Return the action of one car from what is seen of it; a car that has just begun gets its first plan."""
        plan = None if begun else self._plans[car]
        given = plan.given if plan else deque([command] * self._past, maxlen=self._past)
        given.appendleft(command)
        y = self._predicted(seen, plan, given)
        if plan is None:
            path = self.along_line(y)
            for _ in range(FIRST_STEPS):
                path = self.improve(path, y) or path
        else:
            improved = self.improve(self._moved_on(plan.path, y), y)
            self.solved += 1
            self.fallbacks += improved is None
            path = improved or self.along_line(y)
        self._plans[car] = Plan(path, given)
        return self._first(path)

    def plan(self, car: int) -> Path:
        """Return the path that a car is on, from the state at which its last command acts."""
        plan = self._plans[car]
        assert plan is not None  # noqa: S101
        return plan.path

    def improve(self, path: Path, y: Array) -> Path | None:
        """Return the path after one step from a car at y (Y,); None where neither solver finds one."""
        steps = self.qp.solve(self._problem(path, y))
        if steps is None:
            return None
        states = self.horizon.states
        share = min(1.0, LARGEST_STEP / max(np.abs(steps[1:, :states]).max(), 1e-9))
        moved = path.y + share * steps[:, :states] * self.horizon.scale
        moved[0] = y
        return Path(moved, np.clip(path.u + share * steps[:-1, states:-1], -1.0, 1.0))

    def along_line(self, y: Array) -> Path:
        """Return a slow drive along the line from y (Y,), as the model does it."""
        horizon = self.horizon
        states, commands = [y], []
        for _ in range(horizon.nodes):
            u = self._follow_line(states[-1])
            commands.append(u)
            states.append(horizon.advance(states[-1][None], u[None], horizon.period).after[0])
        return Path(np.stack(states), np.stack(commands))

    def _problem(self, path: Path, y: Array) -> Problem:
        """Return the quadratic problem about a path, in scaled steps."""
        horizon, weights, h = self.horizon, self.horizon.weights, self.horizon.period
        scale, states = horizon.scale, horizon.states
        K, M = horizon.nodes, states + 3
        slopes = horizon.advance(path.y[:-1], path.u, h)
        residual, by = horizon.residuals(path)
        by = by * np.concatenate([scale, [1.0, 1.0]])
        hessian, gradient = np.zeros((K + 1, M, M)), np.zeros((K + 1, M))
        hessian[:-1, :-1, :-1] = by.transpose(0, 2, 1) @ by
        hessian[:, range(M), range(M)] += h * np.array([self.settings.damping] * (M - 1) + [SLACK])
        gradient[:-1, :-1] = (by.transpose(0, 2, 1) @ residual[:, :, None])[:, :, 0]
        gradient[:-1, -1] = h * weights.boundary
        gradient[-1, 0] = -1.0
        low, high = np.full((K + 1, M), -np.inf), np.full((K + 1, M), np.inf)
        low[:-1, states:-1], high[:-1, states:-1] = -1.0 - path.u, 1.0 - path.u
        low[:, -1] = 0.0
        if self.known.action.integrated:
            drive, unit = path.y[1:, -1], scale[-1]
            low[1:, states - 1] = (self.known.action.drive_min - drive) / unit
            high[1:, states - 1] = (self.known.action.drive_max - drive) / unit
        rows, least = self._boundaries(path.y[1:-1])
        return Problem(
            hessian,
            gradient,
            slopes.by_state * (scale / scale[:, None]),
            slopes.by_command / scale[:, None],
            (slopes.after - path.y[1:]) / scale,
            (y - path.y[0]) / scale,
            rows,
            least,
            low,
            high,
        )

    def _boundaries(self, y: Array) -> tuple[Array, Array]:
        """Return the rows  e ± (n − n_limit(s)) ≥ room,  e ± ξ ≥ −turn  of the inner nodes: C and d of a problem."""
        horizon = self.horizon
        _, low, high, _, low_slope, high_slope = horizon.table.at(y[:, 0])
        rows = np.zeros((len(y), ROWS, horizon.states + 3))
        rows[:, 0, 0], rows[:, 1, 0] = -low_slope, high_slope
        rows[:, 0, 1 + N], rows[:, 1, 1 + N] = 1.0, -1.0
        rows[:, 2, 1 + XI], rows[:, 3, 1 + XI] = 1.0, -1.0
        rows[:, :, : horizon.states] *= horizon.scale
        rows[:, :, -1] = 1.0
        n, xi, room, turn = y[:, 1 + N], y[:, 1 + XI], horizon.weights.room, horizon.weights.turn
        return rows, np.stack([low + room - n, n - high + room, -turn - xi, xi - turn], axis=1)

    def _predicted(self, seen: Array, plan: Plan | None, given: deque[tuple[float, float]]) -> Array:
        """Return the state (Y,) at which a command given now acts; states of effects are those of the plan."""
        horizon, action = self.horizon, self.known.action
        own = slice(1 + len(STATE) - 1, horizon.states - action.integrated)
        y = np.zeros(horizon.states)
        y[: own.start], y[own.stop :] = seen[: own.start], seen[own.start :]
        if plan is not None:
            y[own] = plan.path.y[0, own]
        steps = -int(-self._lateness // LONGEST)
        for number in range(steps):
            step = self._lateness / steps
            history = [given[0], *given]  # the newest is not known yet; where delays differ, the last stands for it
            delta_ref, drive_ref = delayed(history, self._delays, number * step, step, self.known.timing.dt, TORCH)
            if action.integrated:
                y[-1] = drive_ref
            u = np.array(outputs(action, delta_ref, drive_ref, drive_ref, step))
            y = horizon.advance(y[None], u[None], step).after[0]
        if action.integrated:
            y[-1] = given[0][1]
        return y

    def _moved_on(self, path: Path, y: Array) -> Path:
        """Return a path a control period later, as near to a car at y as laps allow; its end is driven on."""
        horizon, K = self.horizon, self.horizon.nodes
        shift = self.known.timing.dt / horizon.period
        place = np.arange(K + 1) + shift
        node = np.minimum(place.astype(np.int64), K - 1)
        share = np.minimum(place - node, 1.0)[:, None]
        states = path.y[node] * (1.0 - share) + path.y[node + 1] * share
        into = np.minimum(place[:-1], K - 1.0)
        node = np.minimum(into.astype(np.int64), K - 2)
        share = (into - node)[:, None]
        commands = path.u[node] * (1.0 - share) + path.u[node + 1] * share
        for k in np.flatnonzero(place > K):
            states[k] = horizon.advance(states[k - 1][None], commands[-1:], horizon.period).after[0]
        states[:, 0] += horizon.table.length * np.round((y[0] - states[0, 0]) / horizon.table.length)
        return Path(states, commands)

    def _first(self, path: Path) -> Array:
        """Return what is commanded over the coming control period: the mean of the nodes that it spans, (2,)."""
        nodes = self.known.timing.dt / self.horizon.period
        share = np.clip(nodes - np.arange(self.horizon.nodes), 0.0, 1.0)
        action: Array = share @ path.u / share.sum()
        return action

    def _follow_line(self, y: Array) -> Array:
        """Return the commands (2,) of a slow drive along the line."""
        action, h = self.known.action, self.horizon.period
        kappa = self.horizon.table.at(y[0] + np.arange(0.0, SIGHT, 0.1))[0]
        speed = float(np.clip(np.sqrt(GRIP * GRAVITY / max(np.abs(kappa).max(), 1e-3)), SLOWEST, FASTEST))
        z = y[1:]
        steering = np.arctan(float(self.known.vehicle.wheelbase) * kappa[1]) - GAINS[0] * z[N] - GAINS[1] * z[XI]
        steering -= GAINS[2] * (z[YAW_RATE] - kappa[0] * z[V_X])
        return np.clip(outputs(action, steering, speed, z[-1], h), -1.0, 1.0)
