"""What the ring of an excavation says of the registration, in its budget and in its verdict."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ladar_volume.change.excavation import Excavation, Region, Scan, excavate
from ladar_volume.change.ring_fit import RingFit, fit_ring
from ladar_volume.change.sampling import sampling_variance
from ladar_volume.change.spherical_tin import short_edges
from ladar_volume.mesh.tetrahedra import signed_tetrahedra, surface_area
from ladar_volume.model.choices import CORRECTIONS
from ladar_volume.model.records import F64
from ladar_volume.model.verdict import Doubt, Verdict

#: A misregistration stands out beyond so many of its sigmas: 0.3 % of Student's distribution with
#: the nine degrees of freedom that twelve stretches leave of three parameters.
STANDS_OUT = 4.1
#: Share of the ring's lines on changed ground that is named, and at which nothing is left to fit.
CHANGED_SHARE, LOST_SHARE = 0.05, 0.4
#: An edge so many times the median one bridges what was not seen, and the share of the volume
#: that depends on such triangles at which that is named.
WIDE_EDGES, BRIDGED_SHARE = 8.0, 0.05


@dataclass(frozen=True)
class RingCheck:
    """excavation : with the lines ``ring`` and ``sampling`` in its budget · fit : of the ring
    before any correction · b : scan B as it was used · correction : its name · verdict
    """

    excavation: Excavation
    fit: RingFit
    b: Scan
    correction: str
    verdict: Verdict


def checked_excavation(
    a: Scan,
    b: Scan,
    region: Region,
    correction: str = "none",
    *,
    pole_map: F64 | None = None,
    max_edge_m: float = np.inf,
) -> RingCheck:
    """The volume between scans A and B with the registration judged by their ring.

    Without a correction a misregistration that stands out enters the variance with its square, and
    the verdict where it outweighs the rest of the variance; where no transform says how well the
    scans lie on each other, so does one that does not stand out, with its own variance. With a
    correction B is moved, and what is left is the line ``ring``.

    Raises as :func:`excavate` and :func:`fit_ring` do.
    """
    found = excavate(a, b, region, pole_map=pole_map, max_edge_m=max_edge_m)
    fit = fit_ring(found.between, b.points[found.in_b])
    doubts, now, when = changed_ground_doubts(fit, found), fit, ""
    if correction != "none":
        taken = fit_ring(found.between, b.points[found.in_b], CORRECTIONS[correction])
        b, when = transform_scan(b, taken), "after the correction "
        found = excavate(a, b, region, pole_map=pole_map, max_edge_m=max_edge_m)
        now = fit_ring(found.between, b.points[found.in_b])
    stated = correction == "none" and not (a.transform is None and b.transform is None)
    budget, off = ring_line(found, now, correction, stated)
    noise = budget["noise_a"] + budget["noise_b"]
    budget["sampling"], more = sampling_line(a, b, region, found, noise, max_edge_m)
    doubts += more
    rest = sum(v for k, v in budget.items() if k != "ring" and np.isfinite(v))
    if off and now.effect_m3**2 > rest:
        doubts += registration_doubts(now, when)
    found = replace(found, budget_m6=budget, sigma_m3=float(np.sqrt(sum(budget.values()))))
    return RingCheck(found, fit, b, correction, Verdict(tuple(doubts + bridged_doubts(found))))


def sampling_line(
    a: Scan, b: Scan, region: Region, found: Excavation, noise_m6: float, max_edge_m: float
) -> tuple[float, list[Doubt]]:
    """What the choice of points costs, m⁶; 0 with a doubt where half of them make no surface."""
    one, two = a.part(found.in_a), b.part(found.in_b)
    sampled = sampling_variance(one, two, region, found.removed_m3, noise_m6, max_edge_m)
    if sampled is not None:
        return sampled, []
    words = (
        "half of the points do not make the surfaces: what their choice costs is not in "
        "sigma; scan more densely"
    )
    return 0.0, [Doubt("sampling", words)]


def ring_line(
    found: Excavation, fit: RingFit, correction: str, stated: bool
) -> tuple[dict[str, float], bool]:
    """The budget, m⁶, with the line ``ring``, and whether the misregistration stands out.

    fit : of the ring as it is now · stated : whether a transform says how well the scans lie on
    each other.
    """
    budget = dict(found.budget_m6)
    if correction != "none":
        budget = {k: v for k, v in budget.items() if not k.startswith("registration")}
    known = sum(v for k, v in budget.items() if k.startswith("registration"))
    off = abs(fit.effect_m3) > STANDS_OUT * np.sqrt(fit.effect_sigma_m3**2 + known)
    budget["ring"] = 0.0 if stated else fit.effect_sigma_m3**2
    if off or not stated:
        budget["ring"] += fit.effect_m3**2
    return budget, off


def transform_scan(b: Scan, fit: RingFit) -> Scan:
    """Scan B with the ring's misregistration taken out; its transform is the ring's now."""
    T = fit.home
    noise = b.noise if np.ndim(b.noise) < 3 else T.R @ np.asarray(b.noise) @ T.R.T
    return Scan(T.apply(b.points), T.apply(b.scanner[None])[0], noise, T)


def registration_doubts(fit: RingFit, when: str = "") -> list[Doubt]:
    """The doubt of scans that do not lie on each other."""
    return [
        Doubt(
            "registration",
            f"{when}the ring differs by {1e3 * fit.offset_m:.1f} ± {1e3 * fit.offset_sigma_m:.1f} "
            f"mm in the mean, which is {fit.effect_m3:+.3g} ± {fit.effect_sigma_m3:.2g} m³ of "
            "misregistration: register the scans (ladar_volume register, or --icp), or take it "
            "out by --ring-correction rigid",
            fit.effect_m3,
        )
    ]


def changed_ground_doubts(fit: RingFit, found: Excavation) -> list[Doubt]:
    """The doubt of a ring that lies on changed ground."""
    share = fit.changed_share
    if share <= CHANGED_SHARE:
        return []
    largest = float(np.abs(found.between.gap_m[fit.changed]).max())
    words = (
        "nothing tells how the scans lie on each other"
        if share > LOST_SHARE
        else "what changed reaches beyond it"
    )
    return [
        Doubt(
            "ring_changed",
            f"{100.0 * share:.0f} % of the ring lies on ground that changed, by up to "
            f"{largest:.3g} m: {words}; lay the ring (--polygon) on firm ground around",
            share,
        )
    ]


def bridged_doubts(found: Excavation) -> list[Doubt]:
    """The doubt of surfaces that were not seen where much of the volume depends on them."""
    d = found.between
    t = d.triangles[: -2 * len(d.gap_m)]  # the wall comes last
    edge = np.linalg.norm(d.vertices[t] - d.vertices[t[:, [1, 2, 0]]], axis=2)
    wide = ~short_edges(d.vertices, t, WIDE_EDGES * float(np.median(edge)), angle=False)
    if not wide.any():
        return []
    middle = 0.5 * (d.vertices.min(axis=0) + d.vertices.max(axis=0))
    unseen = float(np.abs(signed_tetrahedra(d.vertices, t[wide], middle)).sum())
    if unseen <= max(BRIDGED_SHARE * abs(found.removed_m3), 2.0 * found.sigma_m3):
        return []
    area = surface_area(d.vertices, t[wide])
    return [
        Doubt(
            "unseen",
            f"{unseen:.3g} m³ depend on {area:.3g} m² of triangles with edges of more than "
            f"{WIDE_EDGES:g} times the usual one, where no scan saw the surface: scan from another "
            "place too",
            unseen,
        )
    ]
