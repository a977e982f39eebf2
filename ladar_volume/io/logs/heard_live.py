"""What the nodes had heard when a log was written, against what is in the log: where it lacks
messages, its replay is not the live survey.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ladar_volume.io.bags import Recording
from ladar_volume.model.errors import BagError
from ladar_volume.model.verdict import Doubt, Verdict

#: Where the nodes report, and the node that hears the sensors.
TOPIC, KIND, NODE = "diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "georeference_node"
#: Messages by role, in the plural.
UNITS = {"cloud": "clouds", "fix": "fixes", "imu": "attitudes", "odometry": "poses"}
#: Lines of the reports that count them.
COUNTS = frozenset(f"{key}_{r}" for r in UNITS for key in ("received", "lost_message_queue_full"))


def live_counts(bag: Recording) -> dict[str, dict[str, int]]:
    """Messages that each georeference_node had received by its last report, without those that
    found no room in its queue: by its full name, then by role. One that was started again counts
    from 0: what it had received before is added.
    """
    found: dict[str, dict[str, int]] = {}
    earlier: dict[str, list[dict[str, int]]] = {}
    if bag.topics().get(TOPIC, ("", 0))[0] != KIND:
        return found
    for raw in bag.raw({TOPIC}):
        for status in bag.message(raw).status:
            if status.name.rpartition("/")[2] != NODE:
                continue
            lines = [v for v in status.values if v.key in COUNTS and v.value.isdecimal()]
            counts = {v.key: int(v.value) for v in lines}
            last = found.get(status.name, {})
            if any(counts.get(key, 0) < n for key, n in last.items()):
                earlier.setdefault(status.name, []).append(last)
            found[status.name] = counts
    return {name: used([*earlier.get(name, []), last]) for name, last in found.items()}


def used(counts: Sequence[Mapping[str, int]]) -> dict[str, int]:
    """Messages by role that found room, from the counts of a node's starts."""
    out = {}
    for role in UNITS:
        heard, unused = f"received_{role}", f"lost_message_queue_full_{role}"
        if heard in counts[-1]:
            out[role] = sum(each.get(heard, 0) - each.get(unused, 0) for each in counts)
    return out


def counts_of_node(
    counts: Mapping[str, Mapping[str, int]], topics: Mapping[str, str]
) -> Mapping[str, int]:
    """The counts of the node that hears the topics by role: the only one, or that of the cloud's
    namespace; none where that cannot be told.
    """
    if len(counts) == 1:
        return next(iter(counts.values()))
    space = topics.get("cloud", "").lstrip("/").rpartition("/")[0]
    return counts.get(f"{space}/{NODE}".lstrip("/"), {})


def heard_and_logged(bag: Recording, topics: Mapping[str, str]) -> dict[str, tuple[int, int]]:
    """By role: how many messages georeference_node had received by its last report, and how many
    the log has. Empty for a log without reports; of several logs the sums of those with reports.
    topics : by role.
    """
    out: dict[str, tuple[int, int]] = {}
    for one in bag.parts or (bag,):
        for role, (heard, there) in heard_and_logged_once(one, topics).items():
            before = out.get(role, (0, 0))
            out[role] = (before[0] + heard, before[1] + there)
    return out


def heard_and_logged_once(bag: Recording, topics: Mapping[str, str]) -> dict[str, tuple[int, int]]:
    """:func:`heard_and_logged` of a single log."""
    try:
        heard = counts_of_node(live_counts(bag), topics)
    except BagError:  # torn: its reader says so where it reads the sensors
        return {}
    there = bag.topics()
    return {
        role: (heard[role], there[topic][1] if topic in there else 0)
        for role, topic in topics.items()
        if role in heard
    }


def in_words(counts: Mapping[str, int]) -> str:
    """``3 clouds and 5 attitudes``."""
    return " and ".join(f"{n} {UNITS[role]}" for role, n in counts.items())


def more_than_live(counted: Mapping[str, tuple[int, int]]) -> dict[str, int]:
    """By role, the messages that the log has beyond those that the node had received."""
    return {role: there - heard for role, (heard, there) in counted.items() if there > heard}


def lacking_words(counted: Mapping[str, tuple[int, int]]) -> str:
    """What the log lacks of the messages that the node had received live; empty for nothing."""
    lacks = {role: n for role, n in counted.items() if n[0] > n[1]}
    words = " and ".join(f"{h - n} of {h} {UNITS[role]}" for role, (h, n) in lacks.items())
    return f"the log lacks {words} that {NODE} had live" if lacks else ""


def missing_messages(counted: Mapping[str, tuple[int, int]]) -> Verdict:
    """A doubt where the log has fewer messages of a role than the node had received live."""
    words = lacking_words(counted)
    if not words:
        return Verdict()
    text = (
        f"{words}, so that this volume is not the live one: start the log before the drivers, or "
        "give all files of the log"
    )
    return Verdict((Doubt("log_incomplete", text, float(max(h - n for h, n in counted.values()))),))


def absent_words(bag: Recording) -> str:
    """Of a log that lacks a sensor's topic: what the node had of all sensors, where that was
    something; empty for a recording without reports.
    """
    try:
        counts = live_counts(bag)
    except BagError:
        return ""
    had = {role: n for role, n in (counts_of_node(counts, {}) or {}).items() if n}
    return f"{NODE} had {in_words(had)} live, which this log lacks" if had else ""
