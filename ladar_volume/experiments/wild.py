"""``ladar_volume study wild``: surveys in which something is not as the model has it, through the
whole engine. How often is a volume more than three printed sigmas off without a warning that names
the cause, and how often is a clean survey called doubtful?
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ladar_volume.io.bags import BagReader
from ladar_volume.io.config import read_config
from ladar_volume.model.errors import GroundError, SurfaceError, VolumeError
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.replay import Replay
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.trouble_kinds import KINDS, TroubledSurvey, make_trouble, mixture

#: Errors above so many printed sigmas are wrong.
WRONG = 3.0
#: The row of a table in which all mixtures are.
MIXED = "two or three kinds"
#: Seeds of each kind, and with ``--reduced``.
SEEDS, REDUCED = 20, 2


@dataclass(frozen=True)
class WildRow:
    """One survey. named : whether a doubt names the cause · refused : by which error, else empty"""

    kind: str
    seed: int
    true_m3: float
    error_m3: float
    sigma_m3: float
    doubts: tuple[str, ...]
    named: bool
    refused: str = ""

    @property
    def group(self) -> str:
        """Its row in a table."""
        return MIXED if "+" in self.kind else self.kind

    @property
    def wrong(self) -> bool:
        """Whether the truth lies beyond three printed sigmas."""
        return not self.refused and abs(self.error_m3) > WRONG * self.sigma_m3

    @property
    def silent(self) -> bool:
        """Whether it does, and no doubt names the cause."""
        return self.wrong and not self.named


def wild_survey(kind: str, seed: int) -> WildRow:
    """One survey of a kind, recorded and replayed with the default budget."""
    trouble = make_trouble(kind, seed)
    flown = TroubledSurvey.of(trouble, seed)
    true = trouble.scene.volume_m3
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight"
        write_bag(flown, path, trouble.settings, lambda share: None)
        with BagReader(path) as bag:
            believed = read_config(path / "config.yaml")
            believed = dataclasses.replace(believed, budget=BudgetParameters())
            try:
                v = Replay(bag, believed, bag.roles({})).run().volume
            except (GroundError, SurfaceError, VolumeError) as error:
                return WildRow(kind, seed, true, np.nan, np.nan, (), True, error.reason)
    doubts = tuple(doubt.name for doubt in v.verdict.doubts)
    named = bool(set(doubts) & set(trouble.names))
    return WildRow(kind, seed, true, v.volume_m3 - true, v.sigma_m3, doubts, named)


def mixed_surveys(count: int, first: int = 1) -> Iterator[WildRow]:
    """So many surveys with two or three kinds of trouble each."""
    for seed in range(first, first + count):
        yield wild_survey(mixture(seed), seed)


def wild_surveys(kinds: list[str], seeds: int, first: int = 1) -> Iterator[WildRow]:
    """Surveys of each kind, seed by seed."""
    for seed in range(first, first + seeds):
        for kind in kinds or list(KINDS):
            yield wild_survey(kind, seed)


def wild_table(rows: list[WildRow]) -> str:
    """A table by kind, as Markdown; mixtures are one row."""
    head = (
        "| kind | surveys | error, RMS | printed sigma, median | > 3 sigma | of these not named |"
    )
    lines = [f"{head} doubtful | refused |", "|---" + "|---:" * 7 + "|"]
    for kind in dict.fromkeys(row.group for row in rows):
        own = [row for row in rows if row.group == kind]
        good = [row for row in own if not row.refused]
        rms = np.sqrt(np.mean([(r.error_m3 / r.true_m3) ** 2 for r in good])) if good else np.nan
        sigma = np.median([r.sigma_m3 / r.true_m3 for r in good]) if good else np.nan
        lines.append(
            f"| {kind.replace('_', ' ')} | {len(own)} | {100 * rms:.2f} % | {100 * sigma:.2f} % "
            f"| {sum(r.wrong for r in own)} | {sum(r.silent for r in own)} "
            f"| {sum(bool(r.doubts) for r in own)} | {sum(bool(r.refused) for r in own)} |"
        )
    silent, wrong = sum(r.silent for r in rows), sum(r.wrong for r in rows)
    lines.append(f"| all | {len(rows)} | | | {wrong} | {silent} | | |")
    return "\n".join(lines) + "\n"
