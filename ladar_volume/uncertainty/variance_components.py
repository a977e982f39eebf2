"""By how much the variances of each group of error sources would have to be larger: variance
components of what passes differ by (Förstner 1979; Koch 1999).

``y`` has the covariance ``V = c I + Σ s_g F_g`` with s_g = 1 where the budget is true. A group is
asked by its score ``yᵀ V⁻¹ F_g V⁻¹ y``, whose mean is ``tr V⁻¹ F_g``; as a sum of chi-squares it is
held against one with the same variance (Satterthwaite). Of the groups that are refuted the one is
freed that makes y the most likely, by Fisher scoring, and the others are asked again.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from ladar_volume.model.records import F64
from ladar_volume.uncertainty.pass_differences import UnitErrors

#: Probability below which a group's budget is refuted.
UNLIKELY = 1e-3
#: Steps of the scoring at most, and the relative change of a component below which they end.
STEPS, SETTLED = 40, 1e-6
#: Groups that are freed at most.
FREED = 3


class Component(NamedTuple):
    """Of one group. factor : of its variances · sigma : of the factor · freedom : independent
    errors it was told from · p_value : of a score as large, were its budget true · freed : whether
    it was refuted, and the factor is its estimate with the other groups that are
    """

    factor: float
    sigma: float
    freedom: float
    p_value: float
    freed: bool


class Scores(NamedTuple):
    """At some factors. first : (g,) derivatives of twice the log-likelihood by the factors ·
    information : (g, g) · ratio : (g,) scores over their means · freedom : (g,) of the scores ·
    likelihood : twice its logarithm, but for a constant
    """

    first: F64
    information: F64
    ratio: F64
    freedom: F64
    likelihood: float


def scores(found: UnitErrors, factors: F64) -> Scores:
    """At factors (g,) of the groups."""
    parts = list(found.part.values())
    V = found.noise * np.eye(len(found.y))
    for s, F in zip(factors, parts, strict=True):
        V += s * F
    L = np.linalg.cholesky(V)
    P = np.linalg.inv(V)
    Py = P @ found.y
    PF = np.stack([P @ F for F in parts])
    trace = np.einsum("gii->g", PF)
    square = np.array([float(Py @ F @ Py) for F in parts])
    flat = PF.reshape(len(parts), -1)
    information = flat @ np.swapaxes(PF, 1, 2).reshape(len(parts), -1).T
    own = np.maximum(np.diag(information), 1e-300)
    likelihood = -2.0 * float(np.log(np.diag(L)).sum()) - float(found.y @ Py)
    return Scores(
        square - trace, information, square / np.maximum(trace, 1e-300), trace**2 / own, likelihood
    )


def most_likely(found: UnitErrors, factors: F64, free: list[int]) -> tuple[F64, Scores]:
    """Factors (g,) of which the free ones make y the most likely, none below 1, with what is known
    there.
    """
    factors = factors.copy()
    at = scores(found, factors)
    for _ in range(STEPS):
        own = at.information[np.ix_(free, free)] + 1e-12 * np.eye(len(free))
        step = np.linalg.solve(own, at.first[free])
        new = np.clip(factors[free] + step, np.maximum(1.0, 0.2 * factors[free]), None)
        still = np.abs(new - factors[free]) <= SETTLED * factors[free]
        factors[free] = new
        at = scores(found, factors)
        if still.all():
            break
    return factors, at


def variance_components(found: UnitErrors) -> dict[str, Component]:
    """A component of each group."""
    names = list(found.part)
    factors, free = np.ones(len(names)), list[int]()
    at = start = scores(found, factors)
    first = chdtrc(start.freedom, start.freedom * start.ratio)
    for _ in range(FREED):
        p = chdtrc(at.freedom, at.freedom * at.ratio)
        refuted = [g for g in range(len(names)) if g not in free and p[g] < UNLIKELY]
        if not refuted:
            break
        tried = [most_likely(found, factors, [*free, g]) for g in refuted]
        best = max(range(len(tried)), key=lambda i: tried[i][1].likelihood)
        factors, at = tried[best]
        free.append(refuted[best])
    out = {}
    last = chdtrc(at.freedom, at.freedom * at.ratio)
    for g, name in enumerate(names):
        if g in free:
            C = np.linalg.inv(at.information[np.ix_(free, free)] + 1e-12 * np.eye(len(free)))
            sigma = math.sqrt(2.0 * float(C[free.index(g), free.index(g)]))
            out[name] = Component(float(factors[g]), sigma, start.freedom[g], first[g], True)
            continue
        own = max(float(at.information[g, g]), 1e-300)
        factor = max(0.0, 1.0 + float(at.first[g]) / own)
        out[name] = Component(factor, math.sqrt(2.0 / own), at.freedom[g], last[g], False)
    return out
