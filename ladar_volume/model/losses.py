"""Counting what was lost, and why: nothing disappears silently."""

from __future__ import annotations

from collections.abc import Iterator, Mapping


class Losses:
    """A counter of dropped things by reason.

    Keys are ``snake_case`` reasons such as ``"point_nan"``, ``"fix_no_fix"``, ``"point_pose_gap"``;
    the first word names the unit that is counted (point, cloud, fix, imu, odometry, message,
    patch).
    """

    def __init__(self, counts: Mapping[str, int] | None = None) -> None:
        self._counts: dict[str, int] = dict(counts or {})

    def add(self, reason: str, count: int = 1) -> None:
        """Count ``count`` losses for ``reason``; zero counts leave no trace."""
        if count < 0:
            raise ValueError(f"a loss count cannot be negative: {reason} {count}")
        if count:
            self._counts[reason] = self._counts.get(reason, 0) + int(count)

    def merge(self, other: Losses) -> None:
        """Add another counter's losses to this one."""
        for reason, count in other.items():
            self.add(reason, count)

    def items(self) -> Iterator[tuple[str, int]]:
        """Reasons and counts in alphabetical order."""
        return iter(sorted(self._counts.items()))

    def as_dict(self) -> dict[str, int]:
        """A plain, sorted dictionary."""
        return dict(self.items())

    def total(self, prefix: str = "") -> int:
        """Sum of the counts whose reason starts with ``prefix``."""
        return sum(count for reason, count in self._counts.items() if reason.startswith(prefix))

    def __getitem__(self, reason: str) -> int:
        return self._counts.get(reason, 0)

    def __bool__(self) -> bool:
        return bool(self._counts)

    def __repr__(self) -> str:
        return f"Losses({self.as_dict()})"
