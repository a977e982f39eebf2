"""How often is one group of error sources found that is worse than its budget, how often could any
test find it from the same differences, and by how much is it scaled? Errors are drawn anew on the
patches and sensitivities of surveys that were filtered once.

    python -m benchmarks.refuted_budgets [--first 5001] [--surveys 4] [--draws 400] [--whole N]

With ``--whole`` that many surveys of each case are flown instead, through the whole engine.
"""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any

import numpy as np

from benchmarks.cut_holes import surveyed
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import F64
from ladar_volume.uncertainty.pass_differences import UnitErrors, pass_differences
from ladar_volume.uncertainty.variance_components import UNLIKELY, Component, variance_components

CASES = (
    ("none", (1.0,)),
    ("position", (2.0, 3.0, 5.0)),
    ("attitude", (2.0, 3.0, 5.0)),
    ("beams", (2.0, 3.0, 5.0)),
    ("boresight", (2.0, 3.0, 5.0)),
    ("lever_arms", (2.0, 3.0, 5.0)),
    ("clock", (5.0, 100.0)),
)


def told(seed: int) -> list[UnitErrors]:
    """What a survey's patches tell of its errors."""
    of = surveyed(seed).estimator
    patches, budget = of.store.patches, of.parameters.budget
    assert patches is not None
    gap_s = of.parameters.georeference.max_position_gap_s
    return pass_differences(patches, of._navigation, budget, gap_s)


def drawn(
    survey: list[UnitErrors], group: str, factor: float, rng: np.random.Generator
) -> dict[str, Component]:
    """Components of one draw with the sigma of a group so many times as large."""
    out: dict[str, Component] = {}
    for one in survey:
        V = one.noise * np.eye(len(one.y))
        for name, part in one.part.items():
            V += (factor**2 if name == group else 1.0) * part
        y = np.linalg.cholesky(V) @ rng.standard_normal(len(one.y))
        out |= variance_components(one._replace(y=y))
    return out


def most_found(
    survey: list[UnitErrors], group: str, factor: float, rng: np.random.Generator, draws: int = 100
) -> float:
    """Share, of the survey's draws, in which the most powerful test there is (Neyman and Pearson,
    for exactly this factor, all other variances known) refutes the budget of a group.
    """
    for one in survey:
        if group not in one.part:
            continue
        V = one.noise * np.eye(len(one.y)) + sum(one.part.values())
        worse = V + (factor**2 - 1.0) * one.part[group]
        A = np.linalg.inv(V) - np.linalg.inv(worse)
        limit = np.quantile(sums_of_squares(A, V, rng, 4000 * draws), 1.0 - UNLIKELY)
        return float((sums_of_squares(A, worse, rng, 1000 * draws) > limit).mean())
    return 0.0


def sums_of_squares(A: F64, V: F64, rng: np.random.Generator, draws: int) -> F64:
    """Draws (k,) of ``yᵀ A y`` for y of covariance V (n, n)."""
    L = np.linalg.cholesky(V)
    own = np.linalg.eigvalsh(L.T @ A @ L)
    out = np.zeros(draws)
    for value in own[own > 1e-6 * own.max()]:
        out += value * rng.chisquare(1.0, draws)
    return out


def worse(group: str, factor: float) -> BudgetParameters:
    """The default budget with the sigmas of a group so many times as large."""
    b = BudgetParameters()
    names = {
        "position": ("position_sigma_m",),
        "attitude": ("attitude_sigma_rad",),
        "beams": ("beam_range_sigma_m", "beam_vertical_sigma_rad"),
        "boresight": ("boresight_sigma_rad",),
        "lever_arms": ("lever_laser_sigma_m", "lever_antenna_sigma_m"),
        "clock": ("clock_sigma_s",),
        "none": (),
    }[group]
    larger: dict[str, Any] = {}
    for name in names:
        own = (factor * np.array(getattr(b, name))).tolist()
        larger[name] = tuple(own) if isinstance(own, list) else own
    return dataclasses.replace(b, **larger)


def whole_surveys(first: int, count: int, only: float) -> None:
    """A row of each case, above a level, where errors do not cancel: how often its group is
    refuted, and another; the volume's error over its sigma, and over what it would be unscaled.
    """
    print("| worse | times | found | another | error / sigma, RMS | before | doubted |")
    print("|---|" + "---:|" * 6)
    for group, factors in CASES[:5]:
        for factor in (f for f in factors if only in (0.0, f) or group == "none"):
            rows = []
            for seed in range(first, first + count):
                of = surveyed(seed, worse(group, factor), level=True)
                v = of.whole
                assert v.agreement is not None
                freed = {s.name for s in v.agreement.sources if s.scale > 1.0} - {"noise"}
                unscaled = dataclasses.replace(
                    of.estimator.parameters,
                    volume=dataclasses.replace(of.estimator.parameters.volume, budget_check="warn"),
                )
                of.estimator.set_parameters(unscaled)
                before = of.estimator.estimate(naive=False).volume.sigma_m3
                error = v.volume_m3 - of.true_m3
                doubted = not v.verdict.sound
                rows.append(
                    (
                        group in freed,
                        bool(freed - {group}),
                        error / v.sigma_m3,
                        error / before,
                        doubted,
                    )
                )
            own, others, ratio, plain, doubts = np.array(rows, dtype=np.float64).T
            print(
                f"| {group} | {factor:g} | {own.sum():.0f} of {count} | {others.sum():.0f} "
                f"| {np.sqrt((ratio**2).mean()):.2f} | {np.sqrt((plain**2).mean()):.2f} "
                f"| {doubts.sum():.0f} |",
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=5001)
    parser.add_argument("--surveys", type=int, default=4)
    parser.add_argument("--draws", type=int, default=400)
    parser.add_argument("--whole", type=int, default=0)
    parser.add_argument("--times", type=float, default=0.0, help="with --whole, this factor alone")
    options = parser.parse_args()
    if options.whole:
        whole_surveys(options.first, options.whole, options.times)
        return
    surveys = [told(options.first + k) for k in range(options.surveys)]
    rng = np.random.default_rng(options.first)
    print(
        "| worse | times | found | by any test | another one | scaled sigma over true, RMS |\n|---|"
        + "---:|" * 5
    )
    for group, factors in CASES:
        for factor in factors:
            made = [
                drawn(surveys[k % len(surveys)], group, factor, rng) for k in range(options.draws)
            ]
            own = [c[group] for c in made if group in c]
            found = np.mean([c.freed for c in own]) if own else 0.0
            others = np.mean(
                [any(c.freed for name, c in one.items() if name != group) for one in made]
            )
            scales = [max(c.factor, 1.0) if c.freed else 1.0 for c in own]
            ratio = np.sqrt(np.mean(scales)) / factor if own else 1.0
            most = np.mean([most_found(one, group, factor, rng) for one in surveys])
            print(
                f"| {group} | {factor:g} | {100 * found:.0f} % | {100 * most:.0f} % "
                f"| {100 * others:.1f} % | {ratio:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
