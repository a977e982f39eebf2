"""All kinds of troubled surveys by name, and the flights that what happens on the way is put on."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ladar_volume.model.errors import SimulationError
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.simulation import troubled_scenes as first
from ladar_volume.simulation.further_troubles import FURTHER
from ladar_volume.simulation.survey import EPOCH_NS, Fixes, Survey, Sweep
from ladar_volume.simulation.troubled_scenes import DURATION_S, FlightTrouble, SceneDraft, Trouble

#: Share of returns that mix two surfaces.
MIXED = 0.05
KINDS: dict[str, Callable[[SceneDraft], None]] = {
    made.__name__: made
    for made in (
        first.clean,
        first.crest_hole,
        first.top_hole,
        first.flank_hole,
        first.toe_hole,
        first.open_hole,
        first.region_cut,
        first.region_toe,
        first.one_side,
        first.two_piles,
        first.wall,
        first.pad,
        first.hollow,
        first.undulating,
        first.machine,
        first.grass,
        first.grass_on_pile,
        first.wrong_attitude,
        first.wrong_beams,
        first.wrong_position,
        first.wrong_boresight,
        *FURTHER,
    )
}


#: Kinds that draw pile or ground anew, and those that end the survey or change it: of several
#: troubles at once these come first and last.
FIRST = ("thin_toe", "flat_top_shadow", "undulating", "varied_ground")
LAST = ("heaped", "region_cut", "region_toe", "one_side")
#: What no mixture has: nothing wrong, and a volume above a level, which other ground would change.
ALONE = ("clean", "lever_above_level")
#: Kinds of which one undoes the other, or what is true would not be known.
APART = (
    {"thin_toe", "flat_top_shadow"},
    {"thin_toe", "heaped"},
    {"undulating", "varied_ground"},
    {"wall", "heaped"},
    {"machine_leaves", "heaped"},
    {"region_cut", "region_toe"},
)
#: Share of mixtures of two kinds; the others have three.
PAIRS = 0.7


def make_trouble(kind: str, seed: int) -> Trouble:
    """A random survey of a kind, or of several joined by ``+``. Raises SimulationError for an
    unknown kind.
    """
    kinds = kind.split("+")
    for each in kinds:
        if each not in KINDS:
            raise SimulationError(f"no trouble {each!r}; there are {', '.join(KINDS)}", value=each)
    drawing, names, volume = SceneDraft(seed, kind), set[str](), dict[str, Any]()
    for each in kinds:
        KINDS[each](drawing)
        names.update(drawing.names)
        volume |= drawing.volume
    drawing.names, drawing.volume = tuple(sorted(names)), volume
    return drawing.trouble()


def mixture(seed: int) -> str:
    """Two or three kinds at random, joined by ``+``."""
    rng = np.random.default_rng([seed, 77])
    drawn = [kind for kind in KINDS if kind not in ALONE]
    middle = sorted({*drawn} - {*FIRST, *LAST})
    order = [*FIRST, *middle, *LAST]
    while True:
        some = set(rng.choice(drawn, 2 if rng.random() < PAIRS else 3, replace=False).tolist())
        if not any(pair <= some for pair in APART):
            return "+".join(sorted(some, key=order.index))


@dataclass
class TroubledSurvey(Survey):
    """A survey on whose flight something happens."""

    flight_trouble: FlightTrouble = field(default_factory=FlightTrouble)

    @classmethod
    def of(cls, trouble: Trouble, seed: int) -> TroubledSurvey:
        """The survey of a trouble; receiver and IMU state the default budget."""
        flight = trouble.flight_trouble
        options = SurveyParameters(
            DURATION_S,
            flight.thin,
            dropout_share=flight.dropout_share,
            mixed_share=MIXED,
            float_spans_s=flight.floats_s,
            seed=seed,
        )
        believed = BudgetParameters()
        return cls(
            trouble.scene,
            trouble.platform,
            trouble.true_budget,
            options,
            {},
            believed,
            flight_trouble=flight,
        )

    def fixes(self) -> Fixes:
        """As drawn, off by a jump from its time on."""
        t, antenna, sigma, status = super().fixes()
        late = t >= EPOCH_NS + np.float64(self.flight_trouble.jump_s) * 1e9
        return t, antenna + np.where(late[:, None], self.flight_trouble.jump_m, 0.0), sigma, status

    def sweeps(self) -> Iterator[Sweep]:
        """Clouds of one turn each, with echoes; from a time on, of the later scene."""
        rng = np.random.default_rng([self.options.seed, 3])
        for sweep in self._hits():
            yield with_echoes(sweep, self.flight_trouble.echo_share, rng)

    def _hits(self) -> Iterator[Sweep]:
        changes = EPOCH_NS + self.flight_trouble.later_s * 1e9
        yield from (s for s in super().sweeps() if s.stamp_ns < changes)
        if self.flight_trouble.later is not None:
            after = Survey(
                self.flight_trouble.later,
                self.platform,
                self.budget,
                self.options,
                {},
                self.stated_budget,
            )
            yield from (s for s in after.sweeps() if s.stamp_ns >= changes)


def with_echoes(sweep: Sweep, share: float, rng: np.random.Generator) -> Sweep:
    """A share of the returns took a longer way, and seem to come from 0.5 to 4 m behind what was
    hit.
    """
    late = rng.random(len(sweep.xyz)) < share
    further = rng.uniform(0.5, 4.0, len(late)) / np.linalg.norm(sweep.xyz, axis=1)
    xyz = np.where(late[:, None], sweep.xyz * (1.0 + further[:, None]), sweep.xyz)
    return dataclasses.replace(sweep, xyz=xyz.astype(np.float32))
