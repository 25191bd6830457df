"""What a log tells of each number, and what it leaves open, in words.

    s = √(λ [(H + λ 1)⁻¹]_ii),    H in the priors' deviations

is the share of a prior's deviation that is left beside the data: near 1 the log tells nothing, and the number stays as
configured. Two numbers whose errors hang together are told only as a ratio or a product.
"""

import fnmatch
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.unknowns import Unknowns
from racerl.identify.methods import Fit
from racerl.identify.objective import Objective

Array = NDArray[np.float64]
NOTHING = 0.9  # of a prior's deviation, beyond which the log tells nothing
TOLD = 0.5  # the same, below which it tells the number
ONE = 0.95  # |correlation| from which on two numbers are told as one
MOST = 4  # pairs that are spoken of


@dataclass(frozen=True)
class Matter:
    """Numbers that belong together, what they are called, and what to drive to learn them."""

    name: str
    drive: str
    patterns: tuple[str, ...]


MATTERS = (
    Matter("how fast the steering answers", "step steers", ("steering.*",)),
    Matter("how fast the drive answers", "speed steps", ("drive.time_constant",)),
    Matter("yaw inertia", "step steers and slaloms", ("yaw_inertia",)),
    Matter("the place of the centre of gravity", "circles both ways at several speeds", ("l_f",)),
    Matter("cornering stiffness", "slaloms", ("*.p_Ky*",)),
    Matter("sideways grip and how it fades", "ramps to full lock at speed", ("*.p_Dy*", "*.p_Cy*", "*.p_Ey*")),
    Matter("stiffness along the car", "launches and braking", ("*.p_Kx*",)),
    Matter("grip along the car and how it fades", "hard launches and braking", ("*.p_Dx*", "*.p_Cx*", "*.p_Ex*")),
    Matter("grip in both directions at once", "power and brakes in turns", ("*.r_*",)),
    Matter("the motor", "launches and coast-downs", ("drive.*",)),
    Matter("drag", "coast-downs", ("drag_*", "rolling*")),
    Matter("effects", "what racerl gap plan proposes", ("effects.*",)),
    Matter("mass and size", "scales", ("*",)),
)


def matter(name: str) -> Matter:
    """Return what a parameter belongs to."""
    return next(each for each in MATTERS if any(fnmatch.fnmatch(name, pattern) for pattern in each.patterns))


def posterior(fit: Fit, objective: Objective) -> tuple[Array, Array]:
    """Return the share s (P,) of each prior's deviation that is left, and the estimates' correlations (P, P)."""
    scale = objective.unknowns.sigma
    H, _ = fit.linearised.reduced()
    λ = max(objective.penalty, 1e-300)
    left = np.linalg.inv(H.sum(axis=0) * np.outer(scale, scale) / λ + np.eye(len(scale)))
    share = np.sqrt(np.clip(np.diag(left), 0.0, 1.0))
    return share, left / np.outer(share, share)


def open_questions(unknowns: Unknowns, share: Array, correlation: Array) -> dict[str, Any]:
    """Return what the log leaves open: `untold` matters with their parameters, `together` pairs, what to `drive`.

    `told` is how many numbers it tells, `says` the same in sentences.
    """
    untold: dict[str, list[str]] = {}
    for name, left in zip(unknowns.names, share.tolist(), strict=True):
        if left > NOTHING:
            untold.setdefault(matter(name).name, []).append(name)
    pairs = list(_together(unknowns, share, correlation))[:MOST]
    names = [*(name for group in untold.values() for name in group), *(n for pair in pairs for n in pair["parameters"])]
    drive = list(dict.fromkeys(matter(name).drive for name in names))
    facts = {"told": int((share < TOLD).sum()), "untold": untold, "together": pairs, "drive": drive}
    return {**facts, "says": _sentences(facts)}


def _together(unknowns: Unknowns, share: Array, correlation: Array) -> Iterator[dict[str, Any]]:
    """Yield pairs of numbers that are told together but not alone, those that hang together most first."""
    upper = np.triu(np.abs(correlation), 1)
    for known in (share > NOTHING, share < TOLD):
        upper[np.ix_(known, known)] = 0.0
    for i, j in sorted(np.argwhere(upper > ONE).tolist(), key=lambda pair: -upper[pair[0], pair[1]]):
        same = (correlation[i, j] > 0.0) == (unknowns.start[i] * unknowns.start[j] > 0.0)
        yield {"parameters": [unknowns.names[i], unknowns.names[j]], "as": "ratio" if same else "product"}


def _sentences(facts: dict[str, Any]) -> list[str]:
    """Return what is left open, a line each; none where all is told."""
    lines = []
    if facts["untold"]:
        matters = [f"{what} ({_listed(names)})" for what, names in facts["untold"].items()]
        lines.append(f"this log does not tell, so it stays as configured: {'; '.join(matters)}")
    lines += [f"{' and '.join(pair['parameters'])} are told only as a {pair['as']}" for pair in facts["together"]]
    if lines:
        lines.append(f"to know more, drive {', '.join(facts['drive'])}")
    return lines


def _listed(names: Sequence[str]) -> str:
    """Return names, or how many where they are many."""
    return ", ".join(names) if len(names) < 4 else f"{len(names)} numbers"
