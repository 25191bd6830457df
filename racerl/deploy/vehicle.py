"""A vehicle in the forms that other racing stacks take: `f1tenth_gym.yaml` and `pacejka.yaml`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from racerl.documents import write_yaml
from racerl.run import RunFolder
from racerl.vehicle.forms import gym_form, lacking, pacejka_form
from racerl.vehicle.load import load_vehicle

GYM, PACEJKA = "f1tenth_gym.yaml", "pacejka.yaml"


def export_vehicle(settings: Mapping[str, Any], out: Path) -> dict[str, Any]:
    """Write the vehicle file `settings["run"]` into `out` in either form; return them, and what they lack.

    Raises VehicleError where the file is no vehicle.
    """
    file = Path(str(settings["run"]))
    vehicle = load_vehicle({"file": str(file)})
    forms = {GYM: gym_form(vehicle), PACEJKA: pacejka_form(vehicle, file.stem)}
    folder = RunFolder.start(out, "export", settings)
    for name, form in forms.items():
        write_yaml(folder.path / name, form)
    folder.finish()
    return {"forms": forms, "lacking": lacking(vehicle)}
