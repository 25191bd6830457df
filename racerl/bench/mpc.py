"""The MPC on one core: milliseconds of its steps along a drive, with and without a compiler, and what they are worth.

A step is all that lies between a measurement and its command. What it found is held against ipopt: both solve the same
problem from the same states of the drive, ipopt to the end, and the costs of the plans are compared.
"""

import time
from dataclasses import dataclass, replace
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from racerl import bounds
from racerl.assemble import Car, use_threads
from racerl.bench import Compose, Progress
from racerl.control.controllers.mpc import Pilot
from racerl.control.horizon import SUBSTEPS, Horizon, Path
from racerl.evaluate.rivals import prepare
from racerl.optimum.along import XI, N
from racerl.registry import construct
from racerl.vehicle.integrate import rk4

ITERATIONS, CAREFUL = 100, 1.5  # of a plan, from the same state, and how they are damped
REACH = 1.2  # laps tabulated from the line on, for ipopt
TABLE = 0.02  # m between the tabulated places

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mpc:
    """So many control `steps` of a drive, and so many `states` of it that ipopt solves the problem from."""

    steps: int
    states: int

    def __post_init__(self) -> None:
        bounds.whole("benchmark.steps", self.steps, 10, 10_000_000)
        bounds.whole("benchmark.states", self.states, 0, 100_000)

    def measure(self, compose: Compose, threads: int, on_progress: Progress) -> dict[str, Any]:
        """Return milliseconds per step, failures, and how far the costs lie above ipopt's."""
        use_threads(1)
        settings = compose("race", ["controller=mpc", "seeds=[0]"])
        facts: dict[str, Any] = {}
        for i, (name, compiled) in enumerate({"compiled": True, "plain": False}.items()):
            states = self.states if compiled else 0
            facts[name] = self._drive(
                settings, compiled, states, lambda share, i=i: on_progress((i + share) / 2, "driving")
            )
        use_threads(threads)
        return {**facts["compiled"], "without_compiler": facts["plain"]}

    def _drive(self, settings: dict[str, Any], compiled: bool, states: int, on_share: Any) -> dict[str, Any]:
        controller = {**settings["controller"], "compiled": compiled}
        field, pilot = prepare({**settings, "controller": controller}, construct(Car, settings["car"], "car"))
        assert isinstance(pilot, Pilot)  # noqa: S101
        reference = Reference(pilot.horizon) if states else None
        plans: list[Path] = []
        every = max(1, self.steps // max(1, states))
        times = []
        for number in range(self.steps):
            begun = bool(field.age[0] == 0)
            began = time.perf_counter_ns()
            action = pilot.act(field)
            if not begun:  # a first plan is made at standstill
                times.append((time.perf_counter_ns() - began) / 1e6)
            field.step(action)
            if number % every == every - 1 and len(plans) < states:
                plans.append(pilot.plan(0))
            on_share(number / self.steps)
        median, p99 = np.percentile(times, [50, 99])
        facts = {"median_ms": float(median), "p99_ms": float(p99), "max_ms": float(np.max(times)), **pilot.facts}
        if reference:
            careful = Pilot(replace(pilot.settings, damping=CAREFUL), pilot.known)
            apart = [_above(reference, careful, plan) for plan in plans]
            solved = np.array([pair for pair in apart if pair is not None]).reshape(-1, 2)
            facts["above_ipopt"] = {"states": len(apart), "not_compared": len(apart) - len(solved)}
            if len(solved):
                facts["above_ipopt"] |= {"in_real_time": _spread(solved[:, 0]), "iterated": _spread(solved[:, 1])}
                facts["above_ipopt"]["iterated"]["within_1_percent"] = int((np.abs(solved[:, 1]) < 0.01).sum())
        return facts


def _above(reference: "Reference", pilot: Pilot, plan: Path) -> tuple[float, float] | None:
    """Return by which share the cost of a plan, and that of the plan iterated to its end, lies above ipopt's.

    None where ipopt finds none, or a step of the iteration fails.
    """
    iterated: Path | None = plan
    for _ in range(ITERATIONS):
        iterated = pilot.improve(iterated, plan.y[0]) if iterated else None
    best = reference.solve(iterated or plan)
    if best is None or iterated is None:
        return None
    above = [(pilot.horizon.cost(path) - best) / abs(best) for path in (plan, iterated)]
    return above[0], above[1]


def _spread(values: Array) -> dict[str, Any]:
    return {"median": float(np.median(values)), "min": float(np.min(values)), "max": float(np.max(values))}


class Reference:
    """The same problem for ipopt."""

    def __init__(self, horizon: Horizon) -> None:
        self.horizon = horizon
        K, states = horizon.nodes, horizon.states
        Y, U, E = casadi.MX.sym("Y", states, K + 1), casadi.MX.sym("U", 2, K), casadi.MX.sym("e", K - 1)
        first = casadi.MX.sym("y0", states)
        node = self._node()
        residuals, _ = horizon.cost_terms()(Y[:, :-1], U)
        limits = self._limits(Y[:, 1:-1], E.T)
        cost = (
            casadi.sumsqr(residuals) / 2
            + horizon.weights.boundary * horizon.period * casadi.sum1(E)
            - (Y[0, -1] - Y[0, 0])
        )
        scale = casadi.DM(horizon.scale)
        gaps = (node.map(K)(Y[:, :-1], U) - Y[:, 1:]) / casadi.repmat(scale, 1, K)
        constraints = casadi.vertcat(Y[:, 0] - first, casadi.vec(gaps), casadi.vec(limits))
        problem: dict[str, Any] = {"x": casadi.veccat(Y, U, E), "p": first, "f": cost, "g": constraints}
        options: dict[str, Any] = {
            "ipopt.print_level": 0,
            "print_time": False,
            "ipopt.sb": "yes",
            "ipopt.max_iter": 500,
            "ipopt.mu_init": 1e-3,  # it begins near its end
        }
        self._solver = casadi.nlpsol("reference", "ipopt", problem, options)
        equal = states * (K + 1)
        self._most = np.concatenate([np.zeros(equal), np.full(constraints.numel() - equal, np.inf)])

    def solve(self, path: Path) -> float | None:
        """Return the least cost near a path, from its first state; None where ipopt fails."""
        low, high = (self._bounds(side) for side in (-1, 1))
        turns = np.floor(path.y[0, 0] / self.horizon.table.length) * self.horizon.table.length
        y = path.y - np.eye(1, self.horizon.states) * turns
        start = np.concatenate([y.ravel(), path.u.ravel(), self.horizon.beyond(path)])
        result = self._solver(x0=start, p=y[0], lbx=low, ubx=high, lbg=0.0, ubg=self._most)
        if not self._solver.stats()["success"]:
            return None
        return float(result["f"])

    def _node(self) -> Any:
        """Return (y, u) → y after one node."""
        horizon = self.horizon
        y, u, kappa = casadi.SX.sym("y", horizon.states), casadi.SX.sym("u", 2), casadi.SX.sym("k")
        rate = casadi.Function("rate", [y, u, kappa], [horizon.derivative(y, u, kappa)])
        curvature = self._tabulated(0, "bspline")
        at, held = casadi.MX.sym("y", horizon.states), casadi.MX.sym("u", 2)
        after = at
        for _ in range(SUBSTEPS):
            after = rk4(lambda now: rate(now, held, curvature(now[0])), after, horizon.period / SUBSTEPS)
        return casadi.Function("node", [at, held], [after])

    def _limits(self, y: Any, e: Any) -> Any:
        """Return what must not be negative at the inner nodes."""
        low, high = (self._tabulated(row, "linear").map(y.shape[1])(y[0, :]) for row in (1, 2))
        n, xi, weights = y[1 + N, :], y[1 + XI, :], self.horizon.weights
        return casadi.vertcat(
            n - low - weights.room + e, high - n - weights.room + e, weights.turn - xi + e, weights.turn + xi + e
        )

    def _tabulated(self, row: int, kind: str) -> Any:
        length = self.horizon.table.length
        s = np.arange(-0.2 * length, (1.0 + REACH) * length, TABLE)
        return casadi.interpolant("table", kind, [s], self.horizon.table.at(s)[row])

    def _bounds(self, side: int) -> Array:
        horizon, action = self.horizon, self.horizon.action
        y = np.full((horizon.nodes + 1, horizon.states), side * np.inf)
        if action.integrated:
            y[1:, -1] = action.drive_min if side < 0 else action.drive_max
        e = np.full(horizon.nodes - 1, 0.0 if side < 0 else np.inf)
        return np.concatenate([y.ravel(), np.full(2 * horizon.nodes, float(side)), e])
