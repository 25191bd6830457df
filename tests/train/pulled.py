"""Pulling the plug of a training, and what must not show afterwards."""

import json


class Plug(Exception):
    """The plug was pulled."""


def pull_at(*steps, stage="train"):
    """Return what pulls the plug once at each of these steps."""
    left = set(steps)

    def pull(progress):
        for each in sorted(left):
            if progress.stage == stage and progress.steps >= each:
                left.remove(each)
                raise Plug

    return pull


def logged(run):
    """Return what a training wrote about its course, without what the clock says."""
    lines = [json.loads(line) for line in (run / "progress.jsonl").read_text().splitlines()]
    return [{key: value for key, value in line.items() if not key.startswith("time/")} for line in lines]
