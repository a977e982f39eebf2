"""The verdict that every result carries: sound, or doubtful with each reason in one sentence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Doubt:
    """One reason to doubt a result.

    name : short machine-readable name (``snake_case``) · text : one sentence that holds the number
    and says what to do · value : that number, for the JSON
    """

    name: str
    text: str
    value: float | None = None


@dataclass(frozen=True)
class Verdict:
    """Sound where there is no doubt. What cannot be answered at all is refused by an error."""

    doubts: tuple[Doubt, ...] = ()

    @property
    def sound(self) -> bool:
        """Whether nothing speaks against the result."""
        return not self.doubts

    @property
    def status(self) -> str:
        """``sound`` or ``doubtful``."""
        return "sound" if self.sound else "doubtful"

    def __add__(self, other: Verdict) -> Verdict:
        """Both verdicts' doubts, each once, in order."""
        known = {(d.name, d.text) for d in self.doubts}
        return Verdict(
            self.doubts + tuple(d for d in other.doubts if (d.name, d.text) not in known)
        )

    def as_dict(self) -> dict[str, Any]:
        """The verdict as plain values."""
        reasons = [{"name": d.name, "text": d.text, "value": d.value} for d in self.doubts]
        return {"status": self.status, "reasons": reasons}
