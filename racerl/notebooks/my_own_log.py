# %% [markdown]
"""
# Your own car's log

A log holds what your car was told and where it went. From it come the numbers of its model: grip, tyres, inertia,
actuators, each with an interval. It takes some minutes on two cores.
"""

# %%
import sys
from pathlib import Path

import pandas as pd

from racerl.commands import data, identify, record

LOG: Path | None = None  # your log, for instance Path("drive.parquet"); a bag needs data="f1tenth" or the like below
QUICK = "quick" in sys.argv[1:]  # seconds in place of minutes: fewer numbers are looked for

# %% [markdown]
"""
## A log

No log at hand? A simulated car drives one. Its yaw inertia is a fifth larger than that of our model, so there is
something to find. Its sensors are noisy, as real ones are.
"""

# %%
HIDDEN = 0.175  # kg m², where the model has 0.146
log = LOG or record(f"vehicle.yaw_inertia={HIDDEN}", vehicle="published", seconds=30 if QUICK else 300).log
print(log)

# %% [markdown]
"""
## What it holds

Look before you fit: channels that are late, wrong units and clipped commands spoil every number that comes out.
"""

# %%
seen = data(log)
print("\n".join(seen.warnings) or "no warnings")
seen.figures["log_0_channels"]

# %% [markdown]
"""
How long the car drove at which speed, steering and slip. What it never did, no fit can tell.
"""

# %%
seen.figures["log_0_coverage"]

# %% [markdown]
"""
## Its numbers

The fit moves the parameters until short simulations end where the car was measured. It is repeated with parts of the
log held out: only there it shows whether a number helps to foretell what the car does.
"""

# %%
few = "hold=['front.*','rear.*','drive.*']", "starts=1", "folds=0"
found = identify(log, *(few if QUICK else ()), vehicle="published")
print("usable" if found.usable else "not usable", "because", found.facts["verdict"]["because"])

# %%
numbers = pd.DataFrame(found.parameters, index=["value", "low", "high", "unit"]).T
print(numbers.to_string())

# %% [markdown]
"""
`low` and `high` bound each value with 95 % confidence. Of the simulated car you know the truth: its yaw inertia.

## Measured and simulated

Every stretch begins where the car was measured, at a dotted line, and is simulated from there.
"""

# %%
found.figures["overlay"]

# %% [markdown]
"""
## And now

- `train(vehicle=found.model)` trains a policy for this car.
- Is it not usable? Then the car does something that no number of the model can say: `what_is_missing.py` looks for it.
"""

# %%
print(found.model)
print(found.page)
