"""What the other nodes of this namespace report in /diagnostics."""

from __future__ import annotations

from collections.abc import Iterable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from ladar_volume.model.verdict import Doubt, Verdict

#: How many points georeference_node has sent since it was configured.
SENT = "sent_points"
#: georeference_node may end this long before the next node is asked to, s. Clouds were still coming
#: where its newest one was at most this old, s.
ALONE_S, COMING_S = 5.0, 1.0


def own_name(status_name: str, namespace: str) -> str | None:
    """The name of a node of this namespace; None for a status of somebody else."""
    space, slash, name = f"/{status_name}".rpartition("/")
    return name if space + slash == f"{namespace.rstrip('/')}/" else None


class UpstreamNodes:
    """The last status of each of the named nodes."""

    def __init__(self, namespace: str, names: Iterable[str]) -> None:
        self._namespace, self._names = namespace, tuple(names)
        self._last: dict[str, DiagnosticStatus] = {}
        self._restarts = self._sent = 0
        self._ended_s: float | None = None
        self._alone_s = 0.0

    def take(self, message: DiagnosticArray) -> None:
        """A message of /diagnostics."""
        for status in message.status:
            name = own_name(status.name, self._namespace)
            if name in self._names:
                self._last[str(name)] = status
        sent = self.lines("georeference_node").get(SENT, "")
        if sent.isdecimal():
            self._restarts += int(sent) < self._sent
            self._sent = int(sent)

    def watch(self, now_s: float, others_end: bool) -> None:
        """Every now and then, by a steady clock: how long georeference_node has ended while the
        nodes after it go on. others_end : whether these, too, have been asked to end.
        """
        if self.lines("georeference_node").get("finished") != "1":  # or it was started again
            self._ended_s, self._alone_s = None, 0.0
        elif not others_end:
            self._ended_s = now_s if self._ended_s is None else self._ended_s
            self._alone_s = now_s - self._ended_s

    def lines(self, name: str) -> dict[str, str]:
        """Keys and values of a node's last status; empty before its first one."""
        status = self._last.get(name)
        return {} if status is None else {v.key: v.value for v in status.values}

    def losses(self) -> dict[str, dict[str, int]]:
        """Losses by node and reason."""
        return {
            name: {
                key.removeprefix("lost_"): int(value)
                for key, value in self.lines(name).items()
                if key.startswith("lost_") and value.isdigit()
            }
            for name in self._names
            if name in self._last
        }

    def verdict(self) -> Verdict:
        """An error of an upstream node, or one that was started again, is a doubt of this node's
        result.
        """
        found = [
            Doubt(f"error_{name}", f"{name} reports an error: {status.message}")
            for name, status in self._last.items()
            if status.level == DiagnosticStatus.ERROR
        ]
        if self._restarts:
            words = f"{self._restarted_text()}: replay the log"
            found.append(Doubt("georeference_restarted", words, float(self._restarts)))
        if ended := self._ended_text():
            found.append(Doubt("georeference_ended", f"{ended}: replay the log", self._alone_s))
        return Verdict(tuple(found))

    def _restarted_text(self) -> str:
        return (
            "georeference_node was started again in the survey: what came while it was down is in "
            "no volume"
        )

    def _ended_text(self) -> str:
        """That georeference_node has ended alone while clouds were coming; empty where not."""
        age = self.lines("georeference_node").get("age_cloud_s", "")
        if self._alone_s <= ALONE_S or not age.replace(".", "", 1).isdecimal():
            return ""
        if float(age) > COMING_S:
            return ""
        return (
            f"georeference_node ended {self._alone_s:.0f} s before the others, and clouds were "
            "still coming: what came since is in no volume"
        )

    def untaken_text(self) -> str:
        """What did not reach the surface of what georeference_node mapped, once both have ended, as
        text; empty for nothing.
        """
        words = [
            f"{name} lost {count} messages for which it had no room"
            for name, lost in self.losses().items()
            if (count := sum(n for why, n in lost.items() if why.startswith("message_queue_full")))
        ]
        words += [self._restarted_text()] if self._restarts else []
        words += [ended] if (ended := self._ended_text()) else []
        sent = self.lines("georeference_node").get(SENT, "")
        taken = self.lines("filter_node").get("count_points", "")
        if sent.isdecimal() and taken.isdecimal() and int(taken) < int(sent):
            words.append(f"filter_node took {taken} of {sent} mapped points")
        cut = [name for name in self._names if self.lines(name).get("finished") == "0"]
        words += [f"{name} ended before its work was done" for name in cut]
        return ", ".join(words)

    def sent_ns(self) -> int:
        """Stamp of the last part of the surface that filter_node has sent, 0 where it says none."""
        stamp = self.lines("filter_node").get("sent_ns", "")
        return int(stamp) if stamp.isdecimal() else 0

    def waiting_text(self) -> str:
        """What the upstream nodes had not passed on at their last status, as text."""
        lines = self.lines("filter_node")
        if not lines:
            return "the nodes before this one had not ended when it did"
        late = lines.get("deferred_s", "0.00")
        return (
            f"filter_node had not ended, with {late} s of returns and {lines.get('queue', '0')} "
            "messages waiting when last heard"
        )
