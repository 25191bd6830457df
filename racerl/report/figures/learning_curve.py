"""Learning: mean reward per step and evaluation lap over training steps."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from racerl.report.figures.style import WIDTH, colour, style, to_svg
from racerl.report.subjects import Subject


def draw(subjects: Sequence[Subject]) -> str | None:
    """Return the SVG, or None when no subject has a training log."""
    trained = [(i, subject) for i, subject in enumerate(subjects) if subject.progress is not None]
    if not trained:
        return None
    with style():
        figure = Figure(figsize=(WIDTH, 3.4))
        reward, lap = figure.subplots(1, 2)
        for i, subject in trained:
            log = subject.progress
            assert log is not None  # noqa: S101
            steps = log["steps"] / 1e6
            if "train/reward" in log:
                reward.plot(steps, log["train/reward"], color=colour(i), lw=1.2, label=subject.title)
            if "evaluation/mean_lap_s" in log:
                known = log["evaluation/mean_lap_s"].notna()
                lap.plot(steps[known], log["evaluation/mean_lap_s"][known], "o-", ms=3, color=colour(i))
        reward.set(xlabel="control steps [million]", ylabel="reward per step [m]", title="Training reward")
        lap.set(xlabel="control steps [million]", ylabel="lap time [s]", title="Evaluation on the way, mean lap")
        if reward.get_legend_handles_labels()[0]:
            reward.legend(loc="lower right", fontsize=8)
        return to_svg(figure)
