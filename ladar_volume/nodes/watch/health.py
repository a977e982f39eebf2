"""What a node knows of its own state: rates and ages of its inputs, how far behind it is, whether
it keeps up, what it lost lately.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

#: Losses that belong to a good survey: what the gates and the filter are there to remove.
ROUTINE = frozenset(
    f"point_{reason}"
    for reason in (
        "nan",
        "range",
        "intensity",
        "vehicle",
        "region",
        "outlier",
        "few_neighbours",
        "over_cap",
        "dual_return",
    )
)

#: An input that is silent while another has come for this long is missing, s.
ALONE_S = 3.0


@dataclass
class _Input:
    count: int = 0
    first_s: float = 0.0
    arrived_s: float = 0.0
    stamp_ns: int | None = None
    worked_ns: int | None = None
    silent_s: float | None = None
    shown: tuple[float, int] | None = None
    worked_before_ns: int | None = None


class Health:
    """Times ``now_s`` are a steady clock's (s), ``ros_ns`` the node's clock's, stamps those of the
    messages (ns).
    """

    def __init__(self) -> None:
        self._inputs: dict[str, _Input] = {}
        self._busy_s = self._busy_before_s = 0.0
        self._shown_s: float | None = None
        self._lost: dict[str, int] = {}

    def expect(self, kind: str, silent_s: float) -> None:
        """An input that should never be silent for longer than ``silent_s``."""
        self._inputs.setdefault(kind, _Input()).silent_s = silent_s

    def record_arrival(self, kind: str, now_s: float, stamp_ns: int | None = None) -> None:
        """A message came in."""
        one = self._inputs.setdefault(kind, _Input())
        one.first_s = one.first_s if one.count else now_s
        one.count, one.arrived_s, one.stamp_ns = one.count + 1, now_s, stamp_ns

    def record_work(self, kind: str, seconds: float, stamp_ns: int | None = None) -> None:
        """The worker was busy with a message."""
        self.busy(seconds)
        one = self._inputs.setdefault(kind, _Input())
        one.worked_ns = stamp_ns if stamp_ns is not None else one.worked_ns

    def busy(self, seconds: float) -> None:
        """The worker was busy."""
        self._busy_s += seconds

    def lines(self, now_s: float, ros_ns: int) -> dict[str, Any]:
        """Per input ``received``, ``rate`` (Hz), ``age`` (s since it came), ``delay`` (s from its
        stamp to now); of the worker ``load`` (share of the time it was busy) and
        ``real_time_factor`` (data time worked off per time it was busy), since the last call.
        """
        out: dict[str, Any] = {}
        for kind, one in list(self._inputs.items()):
            if not one.count:
                continue
            then, count = one.shown or (now_s, one.count)
            out[f"received_{kind}"] = one.count
            out[f"rate_{kind}_hz"] = (
                f"{(one.count - count) / (now_s - then):.1f}" if now_s > then else "0.0"
            )
            out[f"age_{kind}_s"] = f"{now_s - one.arrived_s:.2f}"
            if one.stamp_ns is not None:
                out[f"delay_{kind}_s"] = f"{(ros_ns - one.stamp_ns) * 1e-9:.3f}"
            one.shown = (now_s, one.count)
        busy, span = (
            self._busy_s - self._busy_before_s,
            now_s - (self._shown_s if self._shown_s is not None else now_s),
        )
        progress = self._progress_s()
        out["load"] = f"{min(busy / span, 1.0):.3f}" if span > 0 else "0.000"
        out["real_time_factor"] = f"{progress / busy:.1f}" if busy > 0 and progress > 0 else "-"
        self._busy_before_s, self._shown_s = self._busy_s, now_s
        return out

    def _progress_s(self) -> float:
        most = 0
        for one in self._inputs.values():
            if one.worked_ns is not None and one.worked_before_ns is not None:
                most = max(most, one.worked_ns - one.worked_before_ns)
            one.worked_before_ns = one.worked_ns
        return most * 1e-9

    def counts(self) -> dict[str, int]:
        """How many messages came, by input."""
        return {kind: one.count for kind, one in list(self._inputs.items())}

    def silent(self, now_s: float) -> tuple[list[str], list[str]]:
        """Inputs that are expected and do not come, in words: warnings, and errors where another
        one has come for :data:`ALONE_S` and this one has not.
        """
        expected = {k: one for k, one in self._inputs.items() if one.silent_s is not None}
        warnings: list[str] = []
        errors: list[str] = []
        for kind, one in expected.items():
            silence = now_s - one.arrived_s
            if not one.count:
                text = f"no {kind} yet"
                alone = any(
                    o.count and now_s - o.first_s > ALONE_S and now_s - o.arrived_s < ALONE_S
                    for o in expected.values()
                )
            elif silence > float(one.silent_s or 0.0):
                text = f"no {kind} for {silence:.1f} s"
                alone = silence > ALONE_S and any(
                    o.count and now_s - o.arrived_s < ALONE_S for o in expected.values()
                )
            else:
                continue
            (errors if alone else warnings).append(text)
        return warnings, errors

    def newly_lost(self, losses: Mapping[str, int]) -> list[str]:
        """What was lost since the last call and is no routine, in words."""
        fresh = {
            k: n - self._lost.get(k, 0)
            for k, n in losses.items()
            if k not in ROUTINE and n > self._lost.get(k, 0)
        }
        self._lost = dict(losses)
        return [f"lost {n} {k}" for k, n in sorted(fresh.items(), key=lambda item: -item[1])]
