"""The elementary functions that the vehicle's equations are written in.

`TORCH` runs them on tensors and plain floats (a float stays a float, so constants cost nothing); `CASADI` builds
symbolic graphs for optimal control. Both offer the same names; the parity test holds them together.
"""

import functools
import math
import threading
from collections.abc import Callable, Sequence
from typing import Any, ParamSpec, Protocol, TypeVar

import torch

Scalar = Any
"""One quantity per car: a float, a tensor of shape (N,) or a CasADi SX."""


Given = ParamSpec("Given")
Result = TypeVar("Result")
SYMBOLIC = threading.RLock()


class Ops(Protocol):
    """What an equation may call besides + − × ÷."""

    def sin(self, x: Scalar) -> Scalar: ...  # noqa: D102
    def cos(self, x: Scalar) -> Scalar: ...  # noqa: D102
    def atan(self, x: Scalar) -> Scalar: ...  # noqa: D102
    def sqrt(self, x: Scalar) -> Scalar: ...  # noqa: D102
    def tanh(self, x: Scalar) -> Scalar: ...  # noqa: D102
    def exp(self, x: Scalar) -> Scalar: ...  # noqa: D102
    def abs(self, x: Scalar) -> Scalar: ...  # noqa: D102
    def sign(self, x: Scalar) -> Scalar: ...  # noqa: D102
    def minimum(self, x: Scalar, y: Scalar) -> Scalar: ...  # noqa: D102
    def maximum(self, x: Scalar, y: Scalar) -> Scalar: ...  # noqa: D102
    def where(self, condition: Scalar, x: Scalar, y: Scalar) -> Scalar: ...  # noqa: D102
    def stack(self, rows: Sequence[Scalar]) -> Any: ...  # noqa: D102
    def unstack(self, rows: Any) -> Sequence[Scalar]: ...  # noqa: D102


def _unary(tensor_function: Callable[[torch.Tensor], torch.Tensor], float_function: Callable[[float], float]) -> Any:
    def call(x: Scalar) -> Scalar:
        return tensor_function(x) if isinstance(x, torch.Tensor) else float_function(x)

    return staticmethod(call)


class TorchOps:
    """Tensors of shape (N,), mixed freely with floats."""

    sin = _unary(torch.sin, math.sin)
    cos = _unary(torch.cos, math.cos)
    atan = _unary(torch.atan, math.atan)
    sqrt = _unary(torch.sqrt, math.sqrt)
    tanh = _unary(torch.tanh, math.tanh)
    exp = _unary(torch.exp, math.exp)
    abs = _unary(torch.abs, abs)
    sign = _unary(torch.sign, lambda x: float(x > 0) - float(x < 0))

    @staticmethod
    def minimum(x: Scalar, y: Scalar) -> Scalar:
        """Return the smaller of x and y."""
        return _extremum(x, y, torch.minimum, min)

    @staticmethod
    def maximum(x: Scalar, y: Scalar) -> Scalar:
        """Return the larger of x and y."""
        return _extremum(x, y, torch.maximum, max)

    @staticmethod
    def where(condition: Scalar, x: Scalar, y: Scalar) -> Scalar:
        """Return x where the condition holds, else y."""
        if isinstance(condition, torch.Tensor):
            return torch.where(condition, x, y)
        return x if condition else y

    @staticmethod
    def stack(rows: Sequence[Scalar]) -> torch.Tensor:
        """Stack scalars of shape (N,) to (S, N); floats are broadcast."""
        like = next(row for row in rows if isinstance(row, torch.Tensor))
        return torch.stack([row if isinstance(row, torch.Tensor) else torch.full_like(like, row) for row in rows])

    @staticmethod
    def unstack(rows: torch.Tensor) -> Sequence[torch.Tensor]:
        """Split (S, N) into S scalars of shape (N,)."""
        return rows.unbind(0)


def _extremum(x: Scalar, y: Scalar, tensor_function: Callable[..., Any], float_function: Callable[..., Any]) -> Scalar:
    if isinstance(x, torch.Tensor) and isinstance(y, torch.Tensor):
        return tensor_function(x, y)
    if isinstance(x, torch.Tensor) or isinstance(y, torch.Tensor):
        tensor, bound = (x, y) if isinstance(x, torch.Tensor) else (y, x)
        return tensor.clamp(max=bound) if float_function is min else tensor.clamp(min=bound)
    return float_function(x, y)


def symbolic(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """Let in one thread at a time: CasADi's expressions share nodes, which threads must neither make nor drop at once.

    The function returns no expression, so that all of its own are dropped before the next thread comes in.
    """

    @functools.wraps(function)
    def alone(*given: Given.args, **named: Given.kwargs) -> Result:
        with SYMBOLIC:
            return function(*given, **named)

    return alone


class CasadiOps:
    """CasADi SX expressions; imported on first use so that training does not load CasADi."""

    def __init__(self) -> None:
        import casadi

        self.sin, self.cos, self.atan, self.tanh = casadi.sin, casadi.cos, casadi.atan, casadi.tanh
        self.sqrt = casadi.sqrt
        self.exp, self.abs, self.sign = casadi.exp, casadi.fabs, casadi.sign
        self.minimum, self.maximum, self.where = casadi.fmin, casadi.fmax, casadi.if_else
        self._vertcat, self._vertsplit = casadi.vertcat, casadi.vertsplit

    def stack(self, rows: Sequence[Scalar]) -> Any:
        """Stack scalars to a column."""
        return self._vertcat(*rows)

    def unstack(self, rows: Any) -> Sequence[Scalar]:
        """Split a column into scalars."""
        return self._vertsplit(rows)


TORCH = TorchOps()


def soft_clip(x: Scalar, limit: Scalar, ops: Ops) -> Scalar:
    """Return x/(1 + (x/limit)⁸)^⅛: x well inside ± limit, ± limit well outside, smooth everywhere."""
    squared = (x / limit) * (x / limit)
    to_the_fourth = squared * squared
    return x / ops.sqrt(ops.sqrt(ops.sqrt(1.0 + to_the_fourth * to_the_fourth)))


def soft_abs(x: Scalar, width: Scalar, ops: Ops) -> Scalar:
    """Return √(x² + width²) − width: |x| less the width well outside it, smooth at 0."""
    return ops.sqrt(x * x + width * width) - width
