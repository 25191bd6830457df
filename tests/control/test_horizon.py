"""What a predictive controller predicts: against the race's own integrator, finite differences and a dense solver."""

import casadi
import numpy as np
import pytest
import torch

from racerl.assemble import build_action, build_race, build_vehicle
from racerl.config import compose_settings
from racerl.control.horizon import Horizon, Path, Weights
from racerl.control.stage_qp import ROWS, Problem, StageQp
from racerl.optimum.along import LineFrame
from racerl.optimum.corridor import Corridor
from racerl.vehicle.integrate import advance
from racerl.vehicle.ops import TORCH

NODES, SECONDS = 12, 0.4
WEIGHTS = Weights(sideslip=0.3, steering=0.2, drive=0.1, boundary=50.0, room=0.05, turn=1.0)


@pytest.fixture(scope="module")
def world():
    settings = compose_settings("train")
    race = build_race(settings, cars=4, seeds=[3])
    return race, Corridor(race.track), build_vehicle(settings), build_action(settings)


@pytest.fixture(scope="module")
def horizon(world):
    _, corridor, vehicle, action = world
    return Horizon(vehicle, action, corridor, WEIGHTS, NODES, SECONDS)


def somewhere(horizon, generator):
    """Return a path of moving, sliding cars all over the track."""
    low = [0.0, -0.3, -0.5, 1.5, -0.8, -2.0, -0.4, 1.5, 1.5]
    high = [17.0, 0.3, 0.5, 4.0, 0.8, 2.0, 0.4, 4.0, 4.0]
    return Path(generator.uniform(low, high, (NODES + 1, 9)), generator.uniform(-1.0, 1.0, (NODES, 2)))


def test_a_node_is_the_motion_of_the_car(world, horizon):
    race, corridor, vehicle, action = world
    frame = LineFrame(corridor, race)
    generator = torch.Generator().manual_seed(0)
    state = race.state.clone()
    state[3] = 2.0 + torch.rand(4, generator=generator)
    state[4:6] = torch.rand(2, 4, generator=generator) - 0.5
    state[7] = state[3] + 0.2
    race.command = torch.stack([torch.zeros(4), state[7]])
    s, z = frame.locate(race, state, race.s)
    y = np.column_stack([s.numpy(), z.numpy()]).astype(float)
    u = np.array([[0.6, 0.5]])
    # the reference rises over the node; a fine step of the car sees its mean
    command = torch.tensor([[u[0, 0] * action.steering_max]] * 4).T
    moved, steps = state.double(), 50
    for k in range(steps):
        drive = race.command[1].double() + (k + 0.5) / steps * horizon.period * u[0, 1] * action.rate_max
        held = torch.stack([command[0].double(), drive])
        moved = advance(vehicle, moved, held, horizon.period / steps, 1, TORCH)
    for car in range(4):
        after = Horizon.advance(horizon, y[car : car + 1], u, horizon.period).after[0]
        s_after, z_after = frame.locate(race, moved.float(), race.s)
        expected = [float(s_after[car]), *z_after[car, :-1].tolist()]
        assert np.allclose(after[:-1], expected, atol=2e-3), (after[:-1], expected)
        assert after[-1] == pytest.approx(float(race.command[1, car]) + horizon.period * 0.5 * action.rate_max)


def test_slopes_are_finite_differences(horizon):
    path = somewhere(horizon, np.random.default_rng(1))
    y, u, step = path.y[:-1], path.u, 1e-6
    slopes = horizon.advance(y, u, horizon.period)
    for column in range(9):
        wide = 0.01 if column == 0 else step  # curvature is tabulated every centimetre
        moved = np.eye(9)[column] * wide
        ends = [horizon.advance(y + side * moved, u, horizon.period).after for side in (1, -1)]
        apart = np.abs(slopes.by_state[:, :, column] - (ends[0] - ends[1]) / (2 * wide))
        assert apart[:, 2].max() < 1e-3  # the heading turns with the line: its curvature's slope is that of the table
        assert np.delete(apart, 2, axis=1).max() < (2e-4 if column < 4 else 2e-5)
    for column in range(2):
        moved = np.eye(2)[column] * step
        ends = [horizon.advance(y, u + side * moved, horizon.period).after for side in (1, -1)]
        assert np.allclose(slopes.by_command[:, :, column], (ends[0] - ends[1]) / (2 * step), atol=2e-5)
    values, by = horizon.residuals(path)
    for column in range(11):
        whole = np.zeros((NODES + 1, 11))
        whole[:, column] = step
        ends = [
            horizon.residuals(Path(path.y + side * whole[:, :9], path.u + side * whole[:-1, 9:]))[0] for side in (1, -1)
        ]
        assert np.allclose(by[:, :, column], (ends[0] - ends[1]) / (2 * step), atol=1e-6)
    assert values.shape == (NODES, 3)


def test_without_a_compiler_it_is_the_same(world, horizon):
    _, corridor, vehicle, action = world
    plain = Horizon(vehicle, action, corridor, WEIGHTS, NODES, SECONDS, compiled=False)
    path = somewhere(horizon, np.random.default_rng(2))
    both = [each.advance(path.y[:-1], path.u, each.period) for each in (horizon, plain)]
    assert np.allclose(both[0].after, both[1].after, rtol=1e-10, atol=1e-10)
    assert np.allclose(both[0].by_state, both[1].by_state, rtol=1e-8, atol=1e-8)


def test_the_cost_is_what_it_says(horizon):
    path = somewhere(horizon, np.random.default_rng(3))
    y, u, h, car = path.y, path.u, horizon.period, horizon.vehicle
    total = -(y[-1, 0] - y[0, 0])
    for k in range(NODES):
        kinematic = np.arctan(float(car.l_r) / float(car.wheelbase) * np.tan(y[k, 6]))
        total += h * WEIGHTS.sideslip * (kinematic - np.arctan2(y[k, 4], y[k, 3])) ** 2
        total += h * WEIGHTS.steering * (0.5 * u[k, 0] - y[k, 6]) ** 2
        total += h * WEIGHTS.drive * (y[k, 8] - y[k, 7]) ** 2
        if k:
            _, low, high, *_ = horizon.table.at(y[k : k + 1, 0])
            outside = max(y[k, 1] - high[0], low[0] - y[k, 1]) + WEIGHTS.room
            total += h * WEIGHTS.boundary * max(0.0, outside, abs(y[k, 2]) - WEIGHTS.turn)
    assert horizon.cost(path) == pytest.approx(total, rel=1e-9)


def small_problem(generator, K=5, Y=3, U=2):
    M = Y + U + 1
    root = generator.normal(size=(K + 1, M, M))
    return Problem(
        hessian=root @ root.transpose(0, 2, 1) + np.eye(M),
        gradient=generator.normal(size=(K + 1, M)),
        by_state=generator.normal(size=(K, Y, Y)) * 0.5,
        by_command=generator.normal(size=(K, Y, U)),
        gap=generator.normal(size=(K, Y)) * 0.1,
        given=generator.normal(size=Y) * 0.1,
        rows=generator.normal(size=(K - 1, ROWS, M)),
        least=-np.abs(generator.normal(size=(K - 1, ROWS))),
        low=np.full((K + 1, M), -1.0),
        high=np.full((K + 1, M), 1.0),
    )


def dense_solution(p):
    """Return the steps of a problem, written out plainly for another solver."""
    K, Y, U = len(p.gap), p.by_state.shape[1], p.by_command.shape[2]
    w = [casadi.MX.sym(f"w{k}", Y + U + 1) for k in range(K + 1)]
    cost = sum(casadi.bilin(p.hessian[k], w[k], w[k]) / 2 + casadi.dot(p.gradient[k], w[k]) for k in range(K + 1))
    equal = [w[0][:Y] - p.given, w[K][Y:]]
    for k in range(K):
        after = p.by_state[k] @ w[k][:Y] + p.by_command[k] @ w[k][Y:-1] + p.gap[k]
        equal.append(w[k + 1][:Y] - after)
    above = [p.rows[k - 1] @ w[k] - p.least[k - 1] for k in range(1, K)]
    above += [w[k][i] - p.low[k][i] for k in range(K + 1) for i in range(Y + U + 1) if (k, i >= Y) != (0, False)]
    above += [p.high[k][i] - w[k][i] for k in range(K + 1) for i in range(Y + U + 1) if (k, i >= Y) != (0, False)]
    g = casadi.vertcat(*equal, *above)
    count = sum(part.numel() for part in equal)
    solver = casadi.nlpsol(
        "s", "ipopt", {"x": casadi.vertcat(*w), "f": cost, "g": g}, {"ipopt.print_level": 0, "print_time": False}
    )
    found = solver(lbg=0.0, ubg=np.r_[np.zeros(count), np.full(g.numel() - count, np.inf)])
    assert solver.stats()["success"]
    return np.array(found["x"]).reshape(K + 1, -1)


@pytest.mark.parametrize("seed", range(4))
def test_steps_are_those_of_another_solver(seed):
    problem = small_problem(np.random.default_rng(seed))
    steps = StageQp(5, 3, 2).solve(problem)
    assert steps is not None
    assert np.abs(steps - dense_solution(problem)).max() < 1e-3


def test_a_car_far_beyond_every_limit_has_a_problem_still():
    problem = small_problem(np.random.default_rng(0))
    far = Problem(**{**problem.__dict__, "rows": np.zeros_like(problem.rows), "least": np.full((4, ROWS), 41.0)})
    assert StageQp(5, 3, 2).solve(far) is None  # told, not raised
    slack = far.rows.copy()
    slack[:, :, -1] = 1.0
    high = problem.high.copy()
    high[:, -1] = np.inf
    assert StageQp(5, 3, 2).solve(Problem(**{**far.__dict__, "rows": slack * 10.0, "high": high})) is not None


def test_where_one_solver_fails_the_other_takes_over(monkeypatch):
    problem, qp = small_problem(np.random.default_rng(0)), StageQp(5, 3, 2)
    first = qp.solve(problem)

    class Failing:
        def __call__(self, **numbers):
            return {"x": np.full(27, np.nan)}

        def stats(self):
            return {"success": False}

    monkeypatch.setattr(qp, "_hpipm", Failing())
    second = qp.solve(problem)
    assert qp.handed_over == 1 and np.abs(first - second).max() < 0.02
    monkeypatch.setattr(qp, "_osqp", Failing())
    assert qp.solve(problem) is None
    assert StageQp(5, 3, 2).solve(Problem(**{**problem.__dict__, "gap": problem.gap * np.nan})) is None
