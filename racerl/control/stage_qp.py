"""The quadratic problem of one step of a predictive controller, node by node.

Over steps w_k = (Δy_k, Δu_k, e_k) of states, commands and slack, with Δy_0 given:

    min Σ ½ w_kᵀH_k w_k + g_kᵀw_k,   Δy_{k+1} = A_k Δy_k + B_k Δu_k + c_k,   C_k w_k ≥ d_k,   low_k ≤ w_k ≤ high_k

HPIPM solves it with a Riccati recursion; OSQP where that fails. Bounds wider than ± `WIDEST` are taken as that.
"""

from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

ROWS = 4  # of C, at every node but the first and the last
WIDEST = 10.0  # stands for no bound: an interior-point method minds an infinite one
ACCURACY = {"res_g_max": 1e-5, "res_b_max": 1e-6, "res_d_max": 1e-6, "res_m_max": 1e-5}
ITERATIONS = 35  # usual are 12 to 20
SPLITTINGS = 150  # of OSQP, which has no more time than that

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Problem:
    """One problem; M = Y + U + 1 rows of w."""

    hessian: Array  # (K + 1, M, M)
    gradient: Array  # (K + 1, M)
    by_state: Array  # A, (K, Y, Y)
    by_command: Array  # B, (K, Y, U)
    gap: Array  # c, (K, Y)
    given: Array  # Δy_0, (Y,)
    rows: Array  # C, (K − 1, ROWS, M)
    least: Array  # d, (K − 1, ROWS)
    low: Array  # (K + 1, M)
    high: Array  # (K + 1, M)


class StageQp:
    """The solvers, for K nodes, Y states and U commands."""

    def __init__(self, nodes: int, states: int, commands: int) -> None:
        self.nodes, self.states, self.inputs = nodes, states, commands + 1
        K, Y, inputs = nodes, states, self.inputs
        structure: dict[str, Any] = {
            "N": K,
            "nx": [0] + [Y] * K,
            "nu": [inputs] * K + [0],
            "ng": [0] + [ROWS] * (K - 1) + [0],
        }
        shape = {"h": self._hessian_sparsity(), "a": self._rows_sparsity()}
        quiet: dict[str, Any] = {"error_on_fail": False, "print_time": False}
        hpipm = {"iter_max": ITERATIONS, **ACCURACY}
        self._hpipm = casadi.conic("hpipm", "hpipm", shape, {**structure, "hpipm": hpipm, **quiet})
        self._osqp = casadi.conic("osqp", "osqp", shape, {"osqp": {"verbose": False, "max_iter": SPLITTINGS}, **quiet})
        self._h, self._a = shape["h"], shape["a"]
        self.handed_over = 0  # to OSQP

    def solve(self, problem: Problem) -> Array | None:
        """Return the steps (K + 1, M), or None when neither solver finds them."""
        numbers = (problem.hessian, problem.gradient, problem.by_state, problem.by_command, problem.gap, problem.least)
        if not all(np.isfinite(part).all() for part in (*numbers, problem.given)):
            return None
        given = self._numbers(problem)
        found = self._hpipm(**given)
        if not self._hpipm.stats()["success"]:
            self.handed_over += 1
            found = self._osqp(**given)
            if not self._osqp.stats()["success"]:
                return None
        steps = np.zeros((self.nodes + 1, self.states + self.inputs))
        steps[0, : self.states] = problem.given
        flat = steps.reshape(-1)[self.states : -self.inputs]
        flat[:] = np.array(found["x"]).ravel()
        return steps if np.isfinite(steps).all() else None

    def _numbers(self, p: Problem) -> dict[str, Any]:
        """Return a problem in the solvers' form."""
        Y = self.states
        first = p.gradient[0] + p.hessian[0][:, :Y] @ p.given
        gap = p.gap.copy()
        gap[0] += p.by_state[0] @ p.given
        nothing, most = np.maximum(p.least, 0.0) + WIDEST, -gap
        equal = most[:1].ravel()
        low = np.concatenate([most[1:], p.least], axis=1).ravel()
        high = np.concatenate([most[1:], nothing], axis=1).ravel()
        return {
            "h": casadi.DM(self._h, self._hessian_values(p)),
            "g": np.concatenate([first[Y:], p.gradient[1:].ravel()[: -self.inputs]]),
            "a": casadi.DM(self._a, self._row_values(p)),
            "lba": np.concatenate([equal, low]),
            "uba": np.concatenate([equal, high]),
            "lbx": np.clip(p.low.ravel()[Y : -self.inputs], -WIDEST, WIDEST),
            "ubx": np.clip(p.high.ravel()[Y : -self.inputs], -WIDEST, WIDEST),
        }

    def _hessian_values(self, p: Problem) -> Array:
        Y, h = self.states, p.hessian
        return np.concatenate([h[0, Y:, Y:].ravel(), h[1:-1].ravel(), h[-1, :Y, :Y].ravel()])

    def _row_values(self, p: Problem) -> Array:
        """Return the values of the rows' matrix column by column: −1 of the node before, A or B, C."""
        K, Y, inputs = self.nodes, self.states, self.inputs
        b = np.zeros((K, inputs, Y))
        b[:, :-1] = p.by_command.transpose(0, 2, 1)
        c = p.rows.transpose(0, 2, 1)
        of_states = np.concatenate([np.full((K - 1, Y, 1), -1.0), p.by_state[1:].transpose(0, 2, 1), c[:, :Y]], axis=2)
        of_inputs = np.concatenate([b[1:], c[:, Y:]], axis=2)
        nodes = np.concatenate([of_states.reshape(K - 1, -1), of_inputs.reshape(K - 1, -1)], axis=1)
        return np.concatenate([b[0].ravel(), nodes.ravel(), np.full(Y, -1.0)])

    def _hessian_sparsity(self) -> Any:
        dense = casadi.Sparsity.dense
        sizes = [self.inputs] + [self.states + self.inputs] * (self.nodes - 1) + [self.states]
        return casadi.diagcat(*(dense(size, size) for size in sizes))

    def _rows_sparsity(self) -> Any:
        """Return the pattern  [B_0 −I], [A_1 B_1 −I; C_1], …, [A B −I]."""
        K, Y, inputs = self.nodes, self.states, self.inputs
        rows: list[int] = []
        columns: list[int] = []
        for k in range(K):
            top = k * (Y + ROWS) - (ROWS if k else 0)
            height = Y + (ROWS if k else 0)
            left = k * (Y + inputs) - Y
            for column in range(max(left, 0), left + Y + inputs):
                rows += range(top, top + height)
                columns += [column] * height
            rows += range(top, top + Y)
            columns += range(left + Y + inputs, left + 2 * Y + inputs)
        return casadi.Sparsity.triplet(K * Y + (K - 1) * ROWS, K * (Y + inputs), rows, columns)
