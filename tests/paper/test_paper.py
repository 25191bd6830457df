"""The paper's numbers: what they are, and its laps as drives."""

import numpy as np
import pytest

from racerl import paper
from racerl.assemble import conf_folder
from racerl.data.log import Log
from racerl.evaluate.recorded import follow
from racerl.track.load import read_track

LAPS = {"rl_geometric": paper.rl_lap, "human": paper.human_lap}


def test_the_papers_values_are_the_papers():
    table = paper.table_1().set_index("name")
    assert table.loc["rl_geometric", "fastest_valid_lap_s"] == 5.561 and table.loc["mpc", "e_off"] == 0.00083
    assert set(table.index) == set(paper.NAMES)
    assert set(paper.figure_6("speed")) == {"driver", "s_m", "v_x"} and len(paper.figure_6("lines", "human"))


@pytest.mark.parametrize("name", LAPS)
def test_a_lap_of_the_paper_is_one_flying_lap_of_its_time(name):
    log = Log.from_table(name, LAPS[name]())
    assert log.dt == 0.01 and not log.remarks and len(list(log.runs())) == 1
    (lap,), drive = follow(read_track(conf_folder() / "track" / "l_shape.csv"), [log])
    assert lap.time_s == pytest.approx(
        paper.table_1().set_index("name").loc[name, "fastest_valid_lap_s"], abs=0.01
    )  # a fifth of a sample of the figure
    # the fastest lap counts laps that never leave the track: the drawn ones come within 1 and 6 cm of it
    assert lap.e_off == 0.0 and lap.valid
    assert drive["n"][drive["lap"] == 1].abs().max() == pytest.approx(
        {"rl_geometric": 0.493, "human": 0.446}[name], abs=2e-3
    )


def test_points_are_samples_because_they_give_the_papers_own_delta_time():
    theirs = paper.figure_6_delta_time()
    s = theirs["s_m"]
    rl, human = (
        np.interp(s, line["s_m"], 0.05 * np.arange(len(line)))
        for line in (paper.figure_6("speed", driver) for driver in ("rl", "human"))
    )
    assert np.sqrt(np.mean((rl - human - theirs["rl_minus_human_s"]) ** 2)) < 0.007
