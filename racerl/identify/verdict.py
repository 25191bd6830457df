"""Whether an identified car may be used: what a user reads first, and what the next command is."""

import math
from collections.abc import Mapping
from typing import Any

GROWN = 1.02  # factor of an error, beyond which it has grown
IDENTIFY, GAP, TRAIN = "racerl identify LOG", "racerl gap LOG", "racerl train vehicle=MODEL"
DATA = "racerl data LOG"  # where columns are mended
PLAN = "racerl gap plan LOG"  # what to drive


def changes(facts: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return {channel: before, after, factor, grew, still} of errors at the longest horizon; None if not known.

    `before` is the vehicle given, `after` the one identified, in runs held out where any were; `still` is what holding
    the first state would err.
    """
    horizon = str(facts["horizon"])
    after, still = (facts[key][horizon] if facts[key] else {} for key in ("rmse", "rmse_hold_last_state"))
    before = facts["rmse_unfitted"][horizon] if facts["fitted"] else {}
    table = {}
    for channel in still:
        old, new = before.get(channel), after.get(channel)
        factor = new / old if new is not None and old else None
        grew = factor is not None and factor > GROWN
        table[channel] = {"before": old, "after": new, "factor": factor, "grew": grew, "still": still[channel]}
    return table


def judge(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return {usable, because, next, channels}: whether to drive the car, why, and the command to go on with.

    LOG, VEHICLE and MODEL in that command stand for the words that named the logs and the vehicle, and for the file.
    """
    table, fitted = changes(facts), facts["fitted"]
    factors = {name: row["factor"] for name, row in table.items() if row["factor"]}
    diverged = [name for name, row in table.items() if row["after"] is None]
    poor = [name for name, row in table.items() if (row["after"] or 0.0) > (row["still"] or math.inf)]
    worse = [f"{name} × {row['factor']:.2f}" for name, row in table.items() if row["grew"]]
    short = facts.get("held_out", "").removeprefix("nothing")
    # what is said first matters most
    reasons = (
        (facts["contradictions"], f"what was measured contradicts itself: {'; '.join(facts['contradictions'])}", DATA),
        (fitted and not facts["rmse"], f"no run was held out{short}", PLAN if short else IDENTIFY),
        (diverged, f"rollouts of {', '.join(diverged)} diverge", GAP if fitted else IDENTIFY),
        (worse, f"errors in runs held out grew: {', '.join(worse)}", GAP),
        (fitted and not facts["method"]["converged"], "the fit has not converged", f"{IDENTIFY} method.iterations=300"),
        (fitted and not facts["open"]["told"], "the log tells no number of the car", PLAN),
        (poor, f"holding the first value errs less: {', '.join(poor)}", GAP if fitted else IDENTIFY),
    )
    for applies, because, command in reasons:
        if applies:
            return {"usable": False, "because": because, "next": command, "channels": table}
    good = "every channel errs less than its first value held"
    if factors:
        good = f"errors in runs held out are {min(factors.values()):.2f} to {max(factors.values()):.2f} of those before"
    return {"usable": True, "because": good, "next": TRAIN if fitted else "racerl train VEHICLE", "channels": table}
