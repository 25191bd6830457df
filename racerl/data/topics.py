"""What a bag offers to a mapping: its topics, the shipped mapping that fits them, and a draft where none does.

A source of a channel is found when the bag has its topic and the topic's messages have its field. A mapping is usable
when it finds a pose or a velocity.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

from racerl.data.layout import Layout, Source, read_layout, shipped
from racerl.data.log import POSE, VELOCITY
from racerl.data.messages import (
    ACKERMANN,
    IMU,
    NUMBER,
    ODOMETRY,
    POSE_STAMPED,
    POSE_WITH_COVARIANCE,
    VESC_STATE,
    has_field,
    usual_field,
)
from racerl.documents import conf_folder, read_yaml
from racerl.errors import LogError

UNMAPPED = "drive_log"  # the mapping of commands that were given none


class Topic(NamedTuple):
    """One topic of a bag: its name, the type of its messages and how many there are."""

    name: str
    kind: str
    messages: int


class UnmappedBag(LogError):
    """A bag in which the mapping finds neither pose nor velocity; carries its topics and a mapping to start from."""

    def __init__(self, line: str, topics: Sequence[Topic], draft: str) -> None:
        super().__init__(line)
        self.topics, self.draft = tuple(topics), draft


def found(layout: Layout, topics: Sequence[Topic]) -> dict[str, Source]:
    """Return the source of every channel that the bag has, with its field.

    The first source whose topic, field and messages are there counts; a topic without messages, or without the field,
    only where no other source is.
    """
    known = {topic.name: topic for topic in topics}
    chosen = {}
    for channel, sources in layout.channels.items():
        there = [
            replace(s, field=s.field or usual_field(known[s.topic].kind, channel)) for s in sources if s.topic in known
        ]
        whole = [source for source in there if has_field(known[source.topic].kind, source.field)]
        heard = [source for source in whole if known[source.topic].messages]
        if there:
            chosen[channel] = (heard or whole or there)[0]
    return chosen


def is_usable(channels: Mapping[str, Source]) -> bool:
    """Return whether there is a pose or a velocity among the channels."""
    return any(channel in channels for channel in (*POSE, *VELOCITY))


def fitting(topics: Sequence[Topic]) -> tuple[str, Layout] | None:
    """Return the usable shipped mapping that finds most channels, and among equals most of its first choices."""
    best, most = None, (0, 0)
    for name, layout in shipped():
        channels = found(layout, topics)
        passed_over = sum(
            [source.topic for source in layout.channels[channel]].index(taken.topic)
            for channel, taken in channels.items()
        )
        if is_usable(channels) and (len(channels), -passed_over) > most:
            best, most = (name, layout), (len(channels), -passed_over)
    return best


def suited(path: Path, topics: Sequence[Topic], layout: Layout) -> tuple[Layout, tuple[str, ...]]:
    """Return the layout to read a bag by, and remarks.

    A layout without topics that nobody changed gives way to the shipped one that fits best. Raises UnmappedBag when
    there is none, and when the layout finds nothing usable.
    """
    if is_usable(found(layout, topics)):
        return layout, ()
    best = fitting(topics)
    if layout.of_bag:
        raise UnmappedBag(
            f"{path}: its mapping finds no pose and no velocity{_near(layout, topics) or _help(path, topics, best)}",
            topics,
            "" if best else draft(path, topics),
        )
    if best is None:
        line = f"{path}: no shipped mapping finds a pose or a velocity in it{_help(path, topics, best)}"
        raise UnmappedBag(line, topics, draft(path, topics))
    if layout != read_layout(read_yaml(conf_folder() / "data" / f"{UNMAPPED}.yaml")):
        raise LogError(f"{path}: is a bag, but its mapping names no topics; give data={best[0]}")
    return best[1], (f"read by data={best[0]}, the shipped mapping that fits its topics best",)


def _near(layout: Layout, topics: Sequence[Topic]) -> str:
    """Return "; did you mean …?" when a pose's or a velocity's topic is named nearly as one of the bag's."""
    named = [source.topic for channel in (*POSE, *VELOCITY) for source in layout.channels.get(channel, ())]
    # a slip of the finger, not one system's /odom for another's /wheel_odom
    near = [match for name in named for match in get_close_matches(name, [topic.name for topic in topics], 1, 0.75)]
    return f"; did you mean {near[0]}?" if near else ""


def _help(path: Path, topics: Sequence[Topic], best: tuple[str, Layout] | None) -> str:
    if best:
        return f"; data={best[0]} fits its topics"
    if _most(topics, POSE_STAMPED, POSE_WITH_COVARIANCE, ODOMETRY) is None:
        return f"; record a pose with it (motion capture, a particle filter): racerl data {path} lists what it holds"
    return f"; save the mapping that racerl data {path} prints as conf/data/mine.yaml, and give data=mine"


def draft(path: Path, topics: Sequence[Topic]) -> str:
    """Return a mapping, in YAML, from the topics whose types say what they are."""
    lines = [f"# conf/data/mine.yaml, made of the topics of {path.name!r}", "channels:"]
    pose = _most(topics, POSE_STAMPED, POSE_WITH_COVARIANCE, ODOMETRY)
    lines += [f"  {channel}: {_quoted(pose)}" for channel in POSE if pose]
    if state := _most(topics, VESC_STATE):
        lines.append(f"  omega: {{topic: {_quoted(state)}, scale: 2.167e-4}}  # 1/speed_to_erpm_gain of your vesc.yaml")
        lines.append(f"  current: {_quoted(state)}")
    command = _most(topics, ACKERMANN)
    if servo := _most([topic for topic in topics if "servo" in topic.name], NUMBER):
        # δ = (servo − offset)/gain
        lines.append(
            f"  delta_ref: {{topic: {_quoted(servo)}, scale: -0.8241, offset: 0.4371}}  # 1/gain, -offset/gain"
        )
    elif command:
        lines.append(f"  delta_ref: {_quoted(command)}")
    lines += [f"  omega_ref: {_quoted(command)}"] if command else []
    if imu := _most(topics, IMU):
        lines.append(f"  # yaw_rate: {_quoted(imu)}  # rad/s about an upward z; a VESC's own sensor gives deg/s")
    return "\n".join(lines) + "\n"


def _most(topics: Sequence[Topic], *kinds: str) -> str | None:
    """Return the topic with most messages of the first of these types that is there."""
    for kind in kinds:
        of_kind = [topic for topic in topics if topic.kind == kind and topic.messages]
        if of_kind:
            return max(of_kind, key=lambda topic: topic.messages).name
    return None


def _quoted(name: str | None) -> str:
    """Return a topic's name as YAML reads it back; names are letters, digits, _ and / unless somebody made them up."""
    name = str(name)
    return name if name.replace("/", "").replace("_", "").isalnum() and name.isascii() else repr(name)
