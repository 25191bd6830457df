"""A refinement of a moment."""

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


def refinement(**changes: Any) -> str:
    """Return the word that asks for it, with some numbers changed."""
    return f"budget.refinement={{{','.join(f'{key}:{value}' for key, value in {**SHORT, **changes}.items())}}}"
