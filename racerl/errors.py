"""Errors that a user can mend: one line with the value, what is allowed and what to do."""

import difflib
import errno
from collections.abc import Iterable

LISTED = 24  # choices that a line names; of more only the nearest


class RacerlError(Exception):
    """A mistake in what the user gave, told in one line; the command line prints it without a traceback."""

    def __str__(self) -> str:
        return " ".join(super().__str__().split())  # whatever names it quotes


class ConfigError(RacerlError):
    """An unknown group, choice or key, or a value outside its range."""


class DocumentError(RacerlError):
    """A YAML, JSON, CSV or tensor file that cannot be read safely."""


class VehicleError(RacerlError):
    """A vehicle whose parameters are missing, unknown or outside their physical bounds."""


class TrackError(RacerlError):
    """A track that cannot be read, does not close or has no width."""


class RunError(RacerlError):
    """A run folder that is incomplete, busy, foreign or of another version."""


class Diverged(RunError):
    """A training whose weights are no longer finite; `racerl.train.train` keeps the best policy from before."""


class LogError(RacerlError):
    """A drive log that cannot be read, is damaged, or lacks what a stage needs."""


class OptimumError(RacerlError):
    """A time-optimal lap that was not found."""


class PolicyError(RacerlError):
    """A policy file that is damaged or does not fit the environment."""


# what to do where the operating system refuses, by its number
REMEDIES = {
    errno.ENOSPC: "make room; where a run had begun, the same words with the same out= go on",
    errno.EDQUOT: "make room; where a run had begun, the same words with the same out= go on",
    errno.EFBIG: "files may not be larger here (ulimit -f); raise the limit, then the same words go on",
    errno.EROFS: "choose another out=",
    errno.EACCES: "ask for permission, or choose another out=",
    errno.EPERM: "ask for permission, or choose another out=",
    errno.ENOTDIR: "a file stands where a folder should be; choose another out=",
    errno.EEXIST: "a file stands where a folder should be; choose another out=",
    errno.ENAMETOOLONG: "choose a shorter out=",
    errno.EMFILE: "close other programs, or raise the limit (ulimit -n)",
}


def refused(error: OSError) -> str:
    """Return what the operating system refused, in one line: where, why, and what to do."""
    where = f"{error.filename}: " if error.filename else ""
    remedy = REMEDIES.get(error.errno or 0)
    return f"{where}{error.strerror or error}" + (f"; {remedy}" if remedy else "")


def suggest(value: object, choices: Iterable[str], most: int = 3) -> str:
    """Return "; did you mean …?" with the near choices; all choices, or the nearest of many, when none is near."""
    known, value = sorted(set(choices)), str(value)
    near = difflib.get_close_matches(value, known, n=most, cutoff=0.6)
    if near:
        return f"; did you mean {' or '.join(near)}?"
    if len(known) > LISTED:
        nearest = difflib.get_close_matches(value, known, n=most, cutoff=0.0)
        return f"; there are {len(known)}, the nearest {', '.join(nearest)}"
    return f"; choose from: {', '.join(known)}" if known else ""
