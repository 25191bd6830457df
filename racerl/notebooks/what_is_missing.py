# %% [markdown]
"""
# What does my simulator miss?

Your car does not do what your model says, and better numbers do not help: the model leaves something out. racerl tries
48 known effects, tells which of them explains the error on stretches that it was not fitted to, and by how much. It
takes a minute or two on two cores.
"""

# %%
import sys

import pandas as pd

from racerl.commands import gap, record
from racerl.vehicle import catalogue

QUICK = "quick" in sys.argv[1:]  # seconds in place of minutes: of the effects only two are tried

# %% [markdown]
"""
## A car with a secret

The simulated car resists turning: its yaw motion is damped. The model knows nothing of it. With a log of your own, put
its path in place of `log`.
"""

# %%
HIDDEN = "yaw_damping"
secret = f"+vehicle/effect={HIDDEN}", f"vehicle.effects.{HIDDEN}.coefficient=0.15"
log = record(*secret, vehicle="published", seconds=40 if QUICK else 120).log
print(log)

# %% [markdown]
"""
## Ask

The answer is a verdict. It is a name only where the log can tell it from all others; else it says what to drive next.
"""

# %%
others = [name for name in catalogue.names() if name not in (HIDDEN, "steering_gain")]
found = gap(log, vehicle="published", without=others if QUICK else [])
print(f"{found.verdict}: {found.reason}")

# %%
effects = pd.DataFrame(
    [
        {"effect": name, "parameter": parameter, **estimate._asdict()}
        for name, parameters in found.effects.items()
        for parameter, estimate in parameters.items()
    ]
)
print(effects.to_string(index=False) if len(effects) else "no effect was named")

# %% [markdown]
"""
## See it

The worst stretch: measured, and simulated without and with the effect.
"""

# %%
found.figures["stretch"]

# %% [markdown]
"""
Each channel's error over the noise of its sensor, before and after. At one, nothing is left to explain.
"""

# %%
found.figures["gap"]

# %% [markdown]
"""
## The other candidates

What else was tried, and how much of the error it explains.
"""

# %%
found.figures["ranking"]

# %% [markdown]
"""
## And now

- `train(vehicle=found.model)` trains a policy that knows of the effect.
- `racerl effects yaw_damping` explains it: its formula, its source, and what it is confused with.
- Is the verdict `ambiguous` or `under_excited`? `racerl gap plan LOG` says what to drive next.
"""

# %%
print(found.model)
print(found.page)
