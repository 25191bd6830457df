# %% [markdown]
"""
# Your first policy

A policy is a small neural network that steers and drives a car. Here one learns to race a simulated 1:10 car, in some
four minutes on two cores. Then it laps, in the car that it has learned with and in one that it has never seen.
"""

# %%
import sys

import pandas as pd

from racerl.assemble import build_race
from racerl.commands import evaluate, report, train
from racerl.config import compose_settings

QUICK = "quick" in sys.argv[1:]  # seconds in place of minutes: the policy learns nothing

# %% [markdown]
"""
## Train

Every car in the simulation gets another grip, 2 % around the nominal one, so that the policy does not rely on an exact
number. `seed` makes the training one that can be repeated.
"""

# %%
policy = train("dr=friction_0.02", budget="smoke" if QUICK else "laptop", seed=0)
print(f"{policy.facts['steps']:,} control steps in {policy.facts['seconds']:.0f} s, kept in {policy.folder}")

# %% [markdown]
"""
## Race

Flying laps from each of three starts. `model` is the car of the training. `twin` stands for a real car: it has numbers
of its own, dead times, late sensors and drifting grip.
"""

# %%
LAPS = 2 if QUICK else 20
model, twin = (evaluate(policy.folder, car=car, laps=LAPS) for car in ("model", "twin"))
raced = pd.DataFrame(
    {
        name: {
            "mean lap in s": laps.mean_lap,
            "laps": len(laps.laps),
            "clean laps": int(laps.laps["valid"].sum()),
            "share of crashes": laps.facts["crash_share"],
        }
        for name, laps in (("model", model), ("twin", twin))
    }
)
print(raced)

# %% [markdown]
"""
The time-optimal lap of the default car takes 5.16 s: nobody laps it faster. A policy of this training needs about 5.5 s
in the model and 5.7 s in the twin.

## Look

A report draws what was raced. Each of its figures can be shown alone: first how the policy learned.
"""

# %%
page = report([model.folder, twin.folder])
page.figures["learning_curve"]

# %% [markdown]
"""
The racing line, coloured by speed, in the model and in the twin. (There is none where no lap was finished.)
"""

# %%
page.figures.get("racing_line")

# %% [markdown]
"""
## Drive it yourself

The race is a few tensors: observations of all cars in, actions of all cars out. Here 100 cars drive for ten seconds.
"""

# %%
race = build_race(compose_settings("train"), cars=100, seeds=[1])
metres = 0.0
for _ in range(200):
    step = race.step(policy.policy.act(race))  # what it decides by what it observes
    metres += step.progress.mean().item()
print(f"A car makes {metres:.0f} m in ten seconds.")

# %% [markdown]
"""
## And now

- The whole report is one page; its path is printed below.
- `racerl export RUN` writes the policy for your car's computer.
- `my_own_log.py` finds the numbers of *your* car, `what_is_missing.py` what your model leaves out.
"""

# %%
print(page.page)
