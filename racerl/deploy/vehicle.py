"""A vehicle in the forms that other racing stacks take: `f1tenth_gym.yaml` and `pacejka.yaml`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from racerl.documents import write_text
from racerl.run import RunFolder
from racerl.vehicle.forms import LOADED, gym_form, pacejka_form
from racerl.vehicle.load import load_vehicle

GYM, PACEJKA = "f1tenth_gym.yaml", "pacejka.yaml"


def export_vehicle(settings: Mapping[str, Any], out: Path) -> dict[str, Any]:
    """Write the vehicle file `settings["run"]` into `out` in either form; return them, and the effects they lack.

    Raises VehicleError where the file is no vehicle.
    """
    file = Path(settings["run"])
    vehicle = load_vehicle({"file": str(file)})
    forms = {GYM: gym_form(vehicle), PACEJKA: pacejka_form(vehicle, file.stem)}
    folder = RunFolder.start(out, "export", settings)
    for name, form in forms.items():
        write_text(folder.path / name, yaml.safe_dump(form, sort_keys=False))
    folder.finish()
    return {"forms": forms, "lacking": [name for name in vehicle.effects if name != LOADED]}
