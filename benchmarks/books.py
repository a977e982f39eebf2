"""Books from the publisher's own count to the file of the log: what was sent is what was received,
plus what was named lost; at every node, and in the log. Too much is as wrong as too little.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from mcap.reader import make_reader

from ladar_volume.io.recorder import log_files

Lines = Mapping[str, Mapping[str, str]]
#: From whom to whom, what the one says it sent, what the other says it took, and how its losses
#: begin.
STEPS = (
    (
        "georeference_node",
        "filter_node",
        "sent_parts",
        "received_points",
        "lost_message_lost_points",
    ),
    ("georeference_node", "filter_node", "sent_points", "count_points", "lost_message_points"),
    ("georeference_node", "filter_node", "sent_states", "count_states", "lost_message_platform"),
    ("filter_node", "volume_node", "count_parts", "count_parts", "lost_message_parts"),
    ("filter_node", "volume_node", "count_parts", "received_points", "lost_message_lost_points"),
    ("filter_node", "volume_node", "count_parts", "received_patches", "lost_message_lost_patches"),
)
#: What makes a step inside a node uneven, and is counted in messages of another kind.
UNEVEN = ("lost_message_before_restart", "lost_message_queue_full", "lost_message_unreadable")


def number(lines: Lines, node: str, key: str) -> int:
    """A counter of a node's last diagnostics; 0 where it is not there."""
    text = lines.get(node, {}).get(key, "0")
    return int(text) if text.lstrip("-").isdigit() else 0


def uneven(lines: Lines, node: str) -> bool:
    """Whether a node named losses that cannot be told by what was sent."""
    return any(k.startswith(UNEVEN) and v != "0" for k, v in lines.get(node, {}).items())


def open_steps(lines: Lines, restarted: frozenset[str]) -> list[str]:
    """Steps between nodes whose books do not close, in words. Steps of nodes that were started
    again, whose counters began again, are left out.
    """
    out = []
    for one, other, sent_key, taken_key, lost in STEPS:
        if {one, other} & restarted or uneven(lines, other) or other not in lines:
            continue
        sent = number(lines, one, sent_key)
        taken = number(lines, other, taken_key) + number(lines, other, lost)
        if sent != taken:
            out.append(f"{one} {sent_key} {sent}, {other} {taken_key} and losses {taken}")
    return out


def open_inside(lines: Lines, returns_sent: int, unlike: frozenset[str]) -> list[str]:
    """Nodes that have lost or won points between their input and their output, in words; those of
    ``unlike`` are left out, since they did not hear all or began again.
    """
    out = []
    if "georeference_node" not in unlike and "georeference_node" in lines:
        node = "georeference_node"
        lost = sum(number(lines, node, key) for key in lines[node] if key.startswith("lost_point_"))
        after = number(lines, node, "sent_points") + number(lines, node, "returns_waiting") + lost
        came = number(lines, node, "received_returns")
        if not returns_sent == came == after:
            out.append(f"{node}: {returns_sent} returns sent, {came} came, {after} went on or lost")
    if "filter_node" not in unlike and "filter_node" in lines:
        came = number(lines, "filter_node", "count_points")
        offered = number(lines, "filter_node", "points_offered")
        if came != offered:
            out.append(f"filter_node: {came} points came, {offered} were offered to the surface")
    return out


def open_log(
    sent: Mapping[str, int], logged: Mapping[str, int], lost: Mapping[str, int]
) -> list[str]:
    """Topics of which the log's files and its named losses are not what was sent, in words."""
    out = []
    for topic, count in sent.items():
        there, named = logged.get(topic, 0), lost.get(topic, 0)
        if there + named != count:
            out.append(f"{topic}: {count} sent, {there} in the log, {named} named lost")
    return out


def in_files(base: Path) -> dict[str, int]:
    """Messages by topic in all files of a log."""
    out: dict[str, int] = {}
    for path in log_files(base):
        with path.open("rb") as stream:
            for _, channel, _ in make_reader(stream).iter_messages():
                topic = channel.topic.lstrip("/")
                out[topic] = out.get(topic, 0) + 1
    return out
