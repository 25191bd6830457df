"""Speed, steering and lateral offset over the track coordinate, fastest lap of each subject."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from racerl.paper import figure_6
from racerl.report.figures.style import PAPER, WIDTH, colour, style, to_svg
from racerl.report.subjects import Subject


def draw(subjects: Sequence[Subject]) -> str | None:
    """Return the SVG, or None when nobody finished a lap."""
    raced = [
        (i, s.title, s.evaluation)
        for i, s in enumerate(subjects)
        if s.evaluation is not None and len(s.evaluation.fastest_lap())
    ]
    if not raced:
        return None
    with style():
        figure = Figure(figsize=(WIDTH, 6.4))
        speed, steering, offset = figure.subplots(3, 1, sharex=True)
        for i, label, evaluation in raced:
            lap = evaluation.fastest_lap().sort_values("s")
            for axis, channel in ((speed, "v_x"), (steering, "delta"), (offset, "n")):
                axis.plot(lap["s"], lap[channel], color=colour(i), lw=1.4, label=label)
        if all(evaluation.metrics.get("track") == "l_shape" for _, _, evaluation in raced):
            paper = {"color": PAPER, "lw": 1.0, "ls": ":", "label": "paper, RL on the real car"}
            line = figure_6("speed").sort_values("s_m")
            speed.plot(line["s_m"], line["v_x"], **paper)
            line = figure_6("steering").sort_values("s_m")
            steering.plot(line["s_m"], line["delta_rad"], **paper)
        track = raced[0][2].track
        s, x, y = track["s_m"], track["x_m"], track["y_m"]
        for side, sign in (("left", 1.0), ("right", -1.0)):
            width = ((track[f"{side}_x_m"] - x) ** 2 + (track[f"{side}_y_m"] - y) ** 2) ** 0.5
            offset.plot(s, sign * width, color="black", lw=1.0)
        speed.set(ylabel="v_x [m/s]")
        steering.set(ylabel="steering δ [rad]")
        offset.set(ylabel="offset n [m]", xlabel="s along the centreline [m]", xlim=(0.0, float(s.iloc[-1])))
        speed.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=8)
        return to_svg(figure)
