"""What the page shows: the newest state of the survey, and how volume and sigma came to be."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field

#: Most estimates that the curve keeps; beyond, every second older one is left out.
KEPT = 600


@dataclass(frozen=True)
class EstimatePoint:
    """One estimate: time of the data, s since the first one; volume and sigma, m³."""

    t_s: float
    volume_m3: float
    sigma_m3: float


@dataclass(frozen=True)
class Cell:
    """A square of the map: middle and mean height, m; mean sigma of height, m; gain_m3 : by which
    sigma of the volume falls after another pass; gap : whether most of that is for want of points
    """

    x_m: float
    y_m: float
    z_m: float
    sigma_m: float
    gain_m3: float
    gap: bool


@dataclass(frozen=True)
class NodeHealth:
    """level : "ok", "warning", "error" or "stale" · words : what the node says of itself"""

    level: str
    words: str


@dataclass
class State:
    """All that the page shows."""

    volume_m3: float | None = None
    sigma_m3: float | None = None
    verdict: str = ""
    reasons: list[str] = field(default_factory=list)
    seen_share: float | None = None
    why_none: str = "no estimate yet"
    curve: list[EstimatePoint] = field(default_factory=list)
    cells: list[Cell] = field(default_factory=list)
    cell_m: float = 0.0
    nodes: dict[str, NodeHealth] = field(default_factory=dict)


class Feed:
    """The state, written by the nodes' thread and read by the server's."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._state = State()
        self._first_ns: int | None = None
        self._last_ns = 0
        self._number = 0

    @property
    def number(self) -> int:
        """How often the state has changed."""
        return self._number

    def text(self) -> str:
        """The state as JSON; numbers that are not finite are null."""
        with self._lock:
            return json.dumps(_finite(asdict(self._state)), allow_nan=False)

    def node(self, name: str, health: NodeHealth) -> None:
        """What a node says of itself."""
        with self._lock:
            self._state.nodes[name] = health
            self._number += 1

    def volume(self, lines: Mapping[str, str]) -> None:
        """The diagnostics of volume_node. An estimate of data from before the last one begins a new
        curve: the survey began again.
        """
        with self._lock:
            s = self._state
            self._number += 1
            if "volume_m3" not in lines:
                s.volume_m3 = s.sigma_m3 = s.seen_share = None
                s.verdict, s.reasons = "", []
                s.why_none = lines.get("estimate", s.why_none)
                return
            s.volume_m3, s.sigma_m3 = float(lines["volume_m3"]), float(lines["sigma_m3"])
            s.verdict, s.seen_share = lines["verdict"], float(lines["seen_share"])
            s.reasons = [words for key, words in lines.items() if key.startswith("doubt_")]
            self._add(int(lines["data_time_ns"]), s)

    def _add(self, t_ns: int, s: State) -> None:
        if self._first_ns is None or t_ns < self._last_ns:
            self._first_ns, s.curve = t_ns, []
        if s.volume_m3 is None or s.sigma_m3 is None or (s.curve and t_ns == self._last_ns):
            return
        self._last_ns = t_ns
        s.curve.append(EstimatePoint((t_ns - self._first_ns) * 1e-9, s.volume_m3, s.sigma_m3))
        if len(s.curve) > KEPT:
            s.curve = s.curve[:-1:2] + s.curve[-1:]

    def cells(self, cells: Sequence[Cell], side_m: float) -> None:
        """The map."""
        with self._lock:
            self._state.cells, self._state.cell_m = list(cells), side_m
            self._number += 1


def _finite(value: object) -> object:
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
