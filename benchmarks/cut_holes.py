"""Holes of 1 to 20 % of a pile's footprint, cut into surveys that were filtered once: is what they
do to the volume within its sigma, and is that no wider than needed?

    python -m benchmarks.cut_holes [--first 5001] [--surveys 8] [--draws 12]

Patches and points whose middle lies in a turned rectangle are taken out of the surface of a whole
survey, on the crest, on a flank, across the toe, or on the top, and the volume is made again. Those
beside the hole were fitted to returns from within it, too, by up to their radius.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ladar_volume.io.bags import BagReader
from ladar_volume.io.config import read_config
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import FilterUpdate, Volume, select
from ladar_volume.replay import Replay
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.scenes import Ground
from ladar_volume.simulation.trouble_kinds import KINDS, TroubledSurvey
from ladar_volume.simulation.troubled_scenes import Pile, SceneDraft
from ladar_volume.uncertainty.packing import unpack_patches
from ladar_volume.volume.estimator import VolumeEstimator

PLACES = ("crest", "flank", "toe", "top")
#: Shares of the footprint, in classes.
CLASSES = ((0.01, 0.03), (0.03, 0.08), (0.08, 0.20))


class Surveyed(NamedTuple):
    """A pile, its volume, the estimator of its survey, and the volume that it found without a
    hole.
    """

    pile: Pile
    true_m3: float
    estimator: VolumeEstimator
    whole: Volume


class Hole(NamedTuple):
    """One hole. error_m3 : of the volume · moved_m3 : by the hole alone"""

    place: str
    share: float
    error_m3: float
    moved_m3: float
    sigma_m3: float
    unseen_m3: float
    named: bool


def surveyed(
    seed: int, true_budget: BudgetParameters | None = None, level: bool = False
) -> Surveyed:
    """A clean survey through the whole engine, its errors drawn from a budget that may be another
    than the believed one; every second pile has a flat top. level : stand on a level, which is
    the base.
    """
    draft = SceneDraft(seed, "clean")
    KINDS["clean"](draft)
    draft.pile = dataclasses.replace(draft.pile, top=0.35 if seed % 2 else 0.0)
    draft.volume_m3 = draft.pile.volume_m3
    if level:
        draft.ground = Ground(0.13, (0.0, 0.0), 0.01, 1.0, seed)
        draft.volume = {"base": "level", "level_m": 0.13}
    draft.true_budget = true_budget or draft.true_budget
    trouble = draft.trouble()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight"
        write_bag(TroubledSurvey.of(trouble, seed), path, trouble.settings, lambda share: None)
        with BagReader(path) as bag:
            config = read_config(path / "config.yaml")
            believed = dataclasses.replace(config, budget=BudgetParameters())
            replay = Replay(bag, believed, bag.roles({}))
            v = replay.run().volume
    return Surveyed(draft.pile, draft.volume_m3, replay.engine.estimator, v)


def rectangle_about(pile: Pile, place: str, share: float, rng: np.random.Generator) -> Any:
    """Middle (2,), axes (2, 2) and half sides (2,) of a hole of a share of the footprint."""
    area, aspect = share * np.pi * pile.a * pile.b, rng.uniform(1.0, 2.0)
    half = 0.5 * np.sqrt([area * aspect, area / aspect])
    phi, turn = rng.uniform(0.0, 2.0 * np.pi, 2)
    at = {"crest": 0.15, "flank": 0.55, "toe": 1.0, "top": 0.0}[place]
    middle = at * np.array([pile.a * np.cos(phi), pile.b * np.sin(phi)])
    return middle, np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]), half


def cut(of: Surveyed, place: str, share: float, rng: np.random.Generator) -> Hole:
    """The volume of a survey with a hole."""
    middle, axes, half = rectangle_about(of.pile, place, share, rng)

    def within(at: Any) -> Any:
        return (np.abs((at[:, :2] - middle) @ axes.T) <= half).all(axis=1)

    store = of.estimator.store
    patches, points = store.patches, store.points
    assert patches is not None and points is not None
    gone = within(patches.centre)
    gone |= np.isin(patches.key, points.patch[within(points.r_map)])
    left = VolumeEstimator(of.estimator.parameters, of.estimator._navigation)
    left.store.replace(
        FilterUpdate(0, patches.key[:0], points, unpack_patches(patches, 0, len(patches)))
    )
    none = unpack_patches(patches, 0, 0)
    left.store.replace(FilterUpdate(1, patches.key[gone], select(points, slice(0, 0)), none))
    v = left.estimate(naive=False).volume
    named = any(d.name in ("unseen", "cut", "ground_one_sided") for d in v.verdict.doubts)
    unseen = v.budget_m6.get("unseen", 0.0) ** 0.5
    error, moved = v.volume_m3 - of.true_m3, v.volume_m3 - of.whole.volume_m3
    return Hole(place, share, error, moved, v.sigma_m3, unseen, named)


def table(holes: list[Hole]) -> str:
    """By place and size, as Markdown."""
    lines = [
        "| place | share of footprint | holes | error, RMS | sigma, RMS | sigma / error "
        "| within 2 sigma | beyond 3 | named |",
        "|---|---|" + "---:|" * 7,
    ]
    for place in (*PLACES, "all"):
        for low, high in CLASSES if place != "all" else ((0.01, 0.20),):
            own = [h for h in holes if place in (h.place, "all") and low <= h.share < high]
            if not own:
                continue
            error = np.array([h.error_m3 for h in own])
            sigma = np.array([h.sigma_m3 for h in own])
            rms, wide = np.sqrt((error**2).mean()), np.sqrt((sigma**2).mean())
            ratio = np.abs(error) / sigma
            lines.append(
                f"| {place} | {100 * low:.0f} to {100 * high:.0f} % | {len(own)} | {rms:.2f} m³ "
                f"| {wide:.2f} m³ | {wide / rms:.2f} | {100 * (ratio <= 2).mean():.0f} % "
                f"| {(ratio > 3).sum()} | {sum(h.named for h in own)} |"
            )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=5001)
    parser.add_argument("--surveys", type=int, default=8)
    parser.add_argument("--draws", type=int, default=4, help="of each place and size, per survey")
    options = parser.parse_args()
    holes, rng = list[Hole](), np.random.default_rng(options.first)
    for seed in range(options.first, options.first + options.surveys):
        of = surveyed(seed)
        places = [p for p in PLACES if p != "top" or of.pile.top > 0.0]
        for place in places:
            for low, high in CLASSES:
                for _ in range(options.draws):
                    share = float(np.exp(rng.uniform(np.log(low), np.log(high))))
                    holes.append(cut(of, place, share, rng))
        print(f"{seed}: {len(holes)} holes", flush=True)
    print(table(holes))


if __name__ == "__main__":
    main()
