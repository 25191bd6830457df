"""The paper's numbers: what they are, and its laps as drives."""

from racerl.paper import NAMES, figure_6, table_1


def test_the_papers_values_are_the_papers():
    table = table_1().set_index("name")
    assert table.loc["rl_geometric", "fastest_valid_lap_s"] == 5.561 and table.loc["mpc", "e_off"] == 0.00083
    assert set(table.index) == set(NAMES)
    assert set(figure_6("speed")) == {"driver", "s_m", "v_x"} and len(figure_6("lines", "human"))
