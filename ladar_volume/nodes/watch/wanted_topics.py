"""Which topics of a graph the log takes: inputs and results of its own vehicle."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable

from ladar_volume.io.logs.unheard import TOPIC as UNHEARD
from ladar_volume.model.parameters import LoggerParameters

#: What the nodes derive on the way: large, and made again by a replay.
DERIVED = frozenset(
    {"points_mapped", "points_filtered", "patches", "tin", "mesh", "more_data", "taken"}
    | {"georeference_node/inputs_heard"}
)
#: Topics of all vehicles.
SHARED = frozenset({"/tf", "/tf_static", "/clock", "/diagnostics", "/rosout"})
#: Nodes whose namespace is a vehicle's.
VEHICLE = frozenset({"georeference_node", "volume_node"})


class WantedTopics:
    """Asked by full topic names."""

    def __init__(self, namespace: str, parameters: LoggerParameters) -> None:
        self._own = f"{namespace.rstrip('/')}/"
        self._parameters = parameters
        self._foreign: tuple[str, ...] = ()

    def look(self, nodes: Iterable[tuple[str, str]]) -> None:
        """Names and namespaces of the graph's nodes: where others' vehicles are."""
        spaces = {f"{space.rstrip('/')}/" for name, space in nodes if name in VEHICLE}
        self._foreign = tuple(s for s in sorted(spaces) if not self._own.startswith(s))

    def matches(self, topic: str) -> bool:
        """Whether a topic is logged: one that is named, or with ``*`` an input or a result."""
        name = topic.lstrip("/")
        if topic.endswith(f"/{UNHEARD}"):  # what the log itself says in it: from nobody else
            return False
        patterns = [p.lstrip("/") for p in self._parameters.topics]
        if any(fnmatch.fnmatch(name, p) for p in patterns if p != "*"):
            return True
        if "*" not in patterns:
            return False
        if topic in SHARED:
            return True
        if not topic.startswith(self._own) or topic.startswith(self._foreign):
            return False
        own = topic.removeprefix(self._own)
        return self._parameters.all or own not in DERIVED
