"""What the nodes had heard when a log was written, against what is in the log: where it lacks
messages, its replay is not the live survey.
"""

from __future__ import annotations

from collections.abc import Mapping

from ladar_volume.io.bags import Recording
from ladar_volume.model.errors import BagError
from ladar_volume.model.verdict import Doubt, Verdict

#: Where the nodes report, and the node that hears the sensors.
TOPIC, KIND, NODE = "diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "georeference_node"
#: Messages by role, in the plural.
UNITS = {"cloud": "clouds", "fix": "fixes", "imu": "attitudes", "odometry": "poses"}


def live_counts(bag: Recording) -> dict[str, dict[str, int]]:
    """Messages that each georeference_node had received by its last report: by its full name, then
    by role.
    """
    found: dict[str, dict[str, int]] = {}
    if bag.topics().get(TOPIC, ("", 0))[0] != KIND:
        return found
    for raw in bag.raw({TOPIC}):
        for status in bag.message(raw).status:
            if status.name.rpartition("/")[2] != NODE:
                continue
            values = {v.key: v.value for v in status.values}
            received = {role: values.get(f"received_{role}", "") for role in UNITS}
            found[status.name] = {role: int(n) for role, n in received.items() if n.isdecimal()}
    return found


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


def missing_messages(bag: Recording, topics: Mapping[str, str]) -> Verdict:
    """A doubt where the log has fewer messages of a role than the node had received live. topics :
    by role.
    """
    try:
        heard = counts_of_node(live_counts(bag), topics)
    except BagError:  # torn: its reader says so where it reads the sensors
        return Verdict()
    there = bag.topics()
    words, most = [], 0
    for role, topic in topics.items():
        missing = heard.get(role, 0) - there[topic][1]
        if missing > 0:
            words.append(f"{missing} of {heard[role]} {UNITS[role]}")
            most = max(most, missing)
    if not words:
        return Verdict()
    text = (
        f"the log lacks {' and '.join(words)} that {NODE} had live, so that this volume is not the "
        "live one: start the log before the drivers, or give all files of the log"
    )
    return Verdict((Doubt("log_incomplete", text, float(most)),))
