"""What a training may end with, in a moment."""

from typing import Any

SHORT = {
    "generations": 2,
    "evaluations": 1,
    "pairs": 16,
    "horizon": 20,
    "between": 5,
    "episode": 40,
    "again": 0.9,
    "momentum": 0.9,
    "perturbation": "[0.02,0.005]",
    "step": "[0.005,0.0005]",
    "most": 3.0,
    "price": 100.0,
    "reserve": 0.006,
}


ASCENT = {
    "updates": 4,
    "evaluations": 4,
    "cars": 16,
    "horizon": 20,
    "between": 5,
    "episode": 40,
    "again": 0.9,
    "learning_rate": "[0.001,0.0001]",
    "betas": "[0.9,0.99]",
    "gradient_norm": 20.0,
    "price": 400.0,
    "reserve": 0.05,
}


def refinement(**changes: Any) -> str:
    """Return the word that asks for an evolution strategy, with some numbers changed."""
    return f"+budget.refinement={_mapping({**SHORT, **changes})}"


def ascent(**changes: Any) -> str:
    """Return the word that asks for an ascent along the gradient, with some numbers changed."""
    return f"+budget.ascent={_mapping({**ASCENT, **changes})}"


def _mapping(numbers: dict[str, Any]) -> str:
    return f"{{{','.join(f'{key}:{value}' for key, value in numbers.items())}}}"
