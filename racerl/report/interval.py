"""An interval beside a sentence: where an effect lies, the side that is claimed, and zero."""

from collections.abc import Callable, Mapping, Sequence

from markupsafe import Markup

WIDTH, HEIGHT, MARGIN, LINE = 240.0, 46.0, 14.0, 15.0  # px; the interval's height on the page


def draw(effect: float, ci95: Sequence[float] | None, limit: Mapping[str, float], unit: str = "") -> Markup:
    """Return the SVG of an effect with its 95 % interval; the claimed side is shaded, the threshold dashed.

    All numbers are told in `unit`, in which they are given; `limit` is that of a `Comparison`.
    """
    ((side, bound),) = limit.items()
    thresholds = [-bound, bound] if side == "within" else [bound]
    low, high = ci95 or (effect, effect)
    known = [0.0, effect, low, high, *thresholds]
    room = 0.08 * (max(known) - min(known)) or 1.0
    left, right = min(known) - room, max(known) + room

    def x(value: float) -> float:
        return MARGIN + (WIDTH - 2.0 * MARGIN) * (value - left) / (right - left)

    first = left if side == "below" else thresholds[0]
    last = right if side == "above" else thresholds[-1]
    parts = [
        f'<rect class="claimed" x="{x(first):.1f}" y="2" width="{x(last) - x(first):.1f}" height="{2 * LINE - 4:g}"/>',
        *(f'<path class="threshold" d="M{x(each):.1f} 2V{2 * LINE:.1f}"/>' for each in thresholds),
        f'<path class="zero" d="M{x(0.0):.1f} 2V{2 * LINE:.1f}"/>',
        f'<path class="interval" d="M{x(low):.1f} {LINE}H{x(high):.1f}"/>',
        f'<circle class="effect" cx="{x(effect):.1f}" cy="{LINE}" r="3.5"/>',
        *_labels([*thresholds, 0.0], x),
    ]
    words = f"{effect:.3g} ({low:.3g} … {high:.3g}) {unit}, claimed {side} {bound:.3g}"
    head = f'<svg class="effect" role="img" aria-label="{words}" viewBox="0 0 {WIDTH:g} {HEIGHT:g}">'
    return Markup(f"{head}{''.join(parts)}</svg>")  # noqa: S704 numbers alone


def _labels(values: Sequence[float], x: Callable[[float], float]) -> list[str]:
    """Return labels under their places, without those that would run into an earlier one of the list."""
    found: dict[float, str] = {}
    for value in dict.fromkeys(values):
        text = f"{value:.3g}"
        if all(abs(x(value) - place) > 3.5 * (len(text) + len(other)) for place, other in found.items()):
            found[x(value)] = text
    return [f'<text x="{place:.1f}" y="{HEIGHT - 4:g}">{text}</text>' for place, text in found.items()]
