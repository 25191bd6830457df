"""What a diagnosis tells of its progress."""

from collections.abc import Callable

OnProgress = Callable[[str, float], None]  # what is done, and the share of the work behind it


def silent(what: str, share: float) -> None:
    """Say nothing."""


def within(on_progress: OnProgress, low: float, high: float) -> OnProgress:
    """Return the progress of a part of the work, between two shares of the whole."""
    return lambda what, share: on_progress(what, low + (high - low) * share)
