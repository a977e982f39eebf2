"""``ladar_volume study nist``: the box experiment of seed 000 repeated on simulated scans, beside
the published values.

:func:`run` simulates and measures, :mod:`nist_tables` writes Tables 5.1 to 5.9 and 6.1,
:mod:`nist_figures` the figures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ladar_volume.experiments.nist import nist_discrepancies as riddles
from ladar_volume.experiments.nist.nist_experiments import (
    MethodComparison,
    PackageVolume,
    error_pct,
    experiment_four,
    experiment_one,
    experiment_three,
    experiment_two,
    front_sequences,
    own_way,
)
from ladar_volume.experiments.nist.nist_scene import DENSITIES, TRUE_M3, pair
from ladar_volume.model.errors import SimulationError
from ladar_volume.model.records import F64

#: Seeds of Experiment 1, which takes as long as all the others, are no more than this.
MOST_ONE = 8


@dataclass(frozen=True)
class Study:
    """Everything measured; s seeds, the first r of them in Experiment 1.

    points : (s, 5, 2) after cropping, with and without the box · one : (r, 2, 10, 7) m³ · two : (s,
    5, 4) m³ · fits : (s, 5, 2, 2, 4) m · full : (s,) m³, all points of density 5 · three : (s, 10,
    4) m³ · four : by seed, cloud (the full set first) and adjustment · own : the package's way ·
    sensitivity : by seed, see :func:`nist_discrepancies.sensitivity` · front : levels and cut
    volumes of
    seed 0 as in Table 5.6, see :func:`nist_experiments.front_sequences`
    """

    points: F64
    one: F64
    two: F64
    fits: F64
    full: F64
    three: F64
    four: list[list[list[MethodComparison]]]
    own: list[PackageVolume]
    sensitivity: list[dict[str, F64]]
    front: tuple[F64, F64]

    def methods(self) -> F64:
        """Volumes (s, clouds, 4), m³, of Experiment 4 in the columns of Table 5.9: Method 1 at the
        front level, Method 2 at the highest level without fill, without and then with RMS
        adjustment.
        """
        return np.array(
            [
                [
                    [v for d in cloud for v in (d.one.volume_m3[-1], d.two.volume_m3[0])]
                    for cloud in seed
                ]
                for seed in self.four
            ]
        )


def run(seeds: int, progress: Callable[[str], None] = lambda text: None) -> Study:
    """Simulate and measure with seeds 0 to seeds − 1. Raises :class:`SimulationError` for none."""
    if seeds < 1:
        raise SimulationError(f"a study needs one seed or more, not {seeds}", value=seeds)
    points = np.empty((seeds, len(DENSITIES), 2))
    one: list[F64] = []
    two: list[tuple[F64, F64, float]] = []
    three: list[F64] = []
    four: list[list[list[MethodComparison]]] = []
    own: list[PackageVolume] = []
    sensitivity: list[dict[str, F64]] = []
    for seed in range(seeds):
        for density in range(len(DENSITIES)):
            points[seed, density] = [len(s.points) for s in pair(density + 1, seed)]
        if seed < MOST_ONE:
            progress(f"seed {seed + 1} of {seeds}: experiment 1")
            one.append(experiment_one(seed))
        progress(f"seed {seed + 1} of {seeds}: experiments 2 to 4")
        two.append(experiment_two(seed))
        three.append(experiment_three(seed))
        four.append(experiment_four(seed))
        own.append(own_way(*pair(1, seed)))
        progress(f"seed {seed + 1} of {seeds}: experiment 3 changed one thing at a time")
        sensitivity.append(riddles.sensitivity(seed))
    volumes, fits, full = (np.array([r[k] for r in two]) for k in range(3))
    one_array, three_array = np.array(one), np.array(three)
    front = front_sequences(0)
    return Study(points, one_array, volumes, fits, full, three_array, four, own, sensitivity, front)


def spread(values: F64) -> float:
    """Sample standard deviation; NaN for one value."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")


def own_numbers(own: list[PackageVolume]) -> dict[str, float]:
    """Bias and spread of the package's way over the seeds, and the predicted sigma, all in % of the
    box; errors of bias and spread.
    """
    error, sigma = (
        np.array([float(error_pct(o.volume_m3)) for o in own]),
        np.array([100.0 * o.sigma_m3 / TRUE_M3 for o in own]),
    )
    n, s = len(error), spread(error)
    return {
        "seeds": float(n),
        "bias_pct": float(error.mean()),
        "bias_error_pct": s / np.sqrt(n),
        "spread_pct": s,
        "spread_error_pct": s / np.sqrt(2.0 * max(n - 1, 1)),
        "predicted_sigma_pct": float(np.sqrt((sigma**2).mean())),
    }


def scatter(error: F64, column: int) -> dict[str, Any]:
    """Mean of errors (seeds, subsets, columns) by column and, for one of them, the spread among the
    subsets of one pair of scans and that of their means between pairs.
    """
    one = error[:, :, column]
    within = (
        float(np.sqrt(np.mean(np.var(one, axis=1, ddof=1)))) if one.shape[1] > 1 else float("nan")
    )
    return {
        "mean": error.mean(axis=(0, 1)),
        "within_a_pair": within,
        "between_pairs": spread(one.mean(axis=1)),
    }


def plain(value: object) -> Any:
    """Arrays as lists, within dictionaries too."""
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items()}
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def summary(study: Study) -> dict[str, Any]:
    """The numbers of the study as plain values: bias and spread of every procedure, and the
    riddles.
    """
    three, four = error_pct(study.three), error_pct(study.methods())[:, 1:]
    numbers: dict[str, Any] = {
        "own": own_numbers(study.own),
        "experiment_3_pct": scatter(three, 0),
        "experiment_4_pct": scatter(four, 2),
        "filter_change_pct": {
            "mean": float((three[:, :, 2] - three[:, :, 0]).mean()),
            "by_seed": (three[:, :, 2] - three[:, :, 0]).mean(axis=1),
            "worse_share": float(
                (np.abs(three[:, :, 2].mean(axis=1)) > np.abs(three[:, :, 0].mean(axis=1))).mean()
            ),
        },
        "sensitivity_pct": {
            name: {
                "mean": np.mean(rows, axis=0),
                "spread": np.std(rows, axis=0, ddof=1) if len(rows) > 1 else np.nan,
            }
            for name in study.sensitivity[0]
            for rows in [np.array([s[name] for s in study.sensitivity])]
        },
        "densities": riddles.densities(study.two, study.fits),
        "vertices": riddles.vertices(study.one),
        "levels_published": riddles.published_levels(),
        "levels": riddles.simulated_levels(study.four),
    }
    return {key: plain(value) for key, value in numbers.items()}
