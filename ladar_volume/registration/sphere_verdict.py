"""What speaks against a registration by spheres: the reasons of its verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ladar_volume.model.records import F64, I64
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.registration.correspondence import Centres, Correspondence
from ladar_volume.registration.spheres import Sphere
from ladar_volume.registration.stillness import Stillness

#: A radius is off where it is so by more than so many sigma, and by this share.
RADIUS_SIGMAS, RADIUS_SHARE = 5.0, 0.01
#: Centres whose second extent is below this share of the first lie nearly on one line.
LINE_SHARE = 0.05
#: Centres whose third extent is below this share of the first lie in one plane.
FLAT_SHARE = 0.01
#: A scale is off where it differs from 1 by more than this and by five sigma.
SCALE_SHARE = 1e-3


@dataclass(frozen=True)
class SphereMeasurement:
    """One sphere as measured in one frame. free : fitted without the given radius, None where the
    points do not bear that, or no radius was given · still : None without times
    """

    sphere: Sphere
    free: Sphere | None
    still: Stillness | None


def sphere_verdict(
    c: Correspondence,
    a: Centres,
    b: Centres,
    parts: Sequence[tuple[SphereMeasurement, SphereMeasurement]],
) -> Verdict:
    """The verdict on a registration; ``parts`` are the spheres of its rows in A and B."""
    doubts = [
        *numbering_doubts(c, a, b),
        *rejected_doubts(c, a),
        *residual_doubts(c),
        *geometry_doubt(c, a),
    ]
    for (one, two), k in zip(parts, a.number[c.rows_a], strict=True):
        doubts += motion_doubts(one, two, int(k)) + radius_doubts(one, two, int(k))
    return Verdict(tuple(doubts))


def cycles(one: I64, two: I64) -> str:
    """In words, how numbers two (k,) of B stand for numbers one (k,) of A."""
    wrong = {int(p): int(q) for p, q in zip(one, two, strict=True) if p != q}
    words = []
    while wrong:
        first = min(wrong)
        chain = [first, wrong.pop(first)]
        while chain[-1] in wrong:
            chain.append(wrong.pop(chain[-1]))
        if len(chain) == 3 and chain[0] == chain[2]:
            words.append(f"spheres {chain[0]} and {chain[1]} were swapped")
        else:
            words += [f"sphere {p} of A is number {q} in B" for p, q in pairwise(chain)]
    return ", ".join(words)


def numbering_doubts(c: Correspondence, a: Centres, b: Centres) -> list[Doubt]:
    """Doubts about the numbering."""
    if c.renumbered:
        one, two = a.number[c.rows_a], b.number[c.rows_b]
        text = cycles(one, two) or "spheres without a partner of the same number were left out"
        return [
            Doubt(
                "renumbered",
                f"{text}: found from the distances between the centres, which agree in this "
                "numbering alone; number them alike",
                float((one != two).sum()),
            )
        ]
    if c.others:
        return [
            Doubt(
                "symmetric",
                f"the spheres stand so symmetrically that {c.others} other numbering(s) fit as "
                "well: the given numbers alone decide; add a sphere off the symmetry",
                float(c.others),
            )
        ]
    return []


def rejected_doubts(c: Correspondence, a: Centres) -> list[Doubt]:
    """Doubts about spheres that were left out."""
    out = []
    for i in np.flatnonzero(~c.registration.used):
        off = float(np.linalg.norm(c.registration.residuals[i]))
        out.append(
            Doubt(
                "left_out",
                f"sphere {int(a.number[c.rows_a[i]])} is {1e3 * off:.1f} mm off where the others "
                "put it, and was left out: did it move? Measure it again",
                off,
            )
        )
    return out


def residual_doubts(c: Correspondence) -> list[Doubt]:
    """Doubts about spheres that agree less than their noise says, and about the scale."""
    out, f = [], c.registration
    if not f.consistent:
        out.append(
            Doubt(
                "inconsistent",
                f"the spheres disagree by {f.sigma0:.1f} times their noise; the covariance is "
                "scaled by that: check the noise, and whether a sphere moved",
                f.sigma0,
            )
        )
    off, sigma = f.transform.scale - 1.0, float(np.sqrt(f.transform.C[6, 6]))
    if abs(off) > max(SCALE_SHARE, 5.0 * sigma):
        out.append(
            Doubt(
                "scale",
                f"B is {1.0 + off:.6f} times as large as A: check the units and the distance "
                "correction of both instruments",
                1.0 + off,
            )
        )
    return out


def spread_of(r: F64) -> F64:
    """Extents (3,) of centres (n, 3) along their principal axes, m."""
    out: F64 = np.linalg.svd(r - r.mean(axis=0), compute_uv=False)
    return out


def geometry_doubt(c: Correspondence, a: Centres) -> list[Doubt]:
    """A doubt where the centres lie nearly on one line, or in a plane that is turned upside down;
    a levelled instrument is free of both.
    """
    used, T = a.r[c.rows_a[c.registration.used]], c.registration.transform
    spread, sigma = spread_of(used), np.sqrt(np.diag(T.C)[:3])
    if T.R[2, 2] < 0.0 and (len(used) < 4 or spread[2] <= FLAT_SHARE * spread[0]):
        tilt = float(np.degrees(np.arccos(np.clip(T.R[2, 2], -1.0, 1.0))))
        return [
            Doubt(
                "upside_down",
                f"the frames stand upside down to each other (by {tilt:.0f}°), and spheres in one "
                "plane cannot tell that from a mirrored frame: check the signs and the order of "
                "the axes, or add a sphere off the plane",
                tilt,
            )
        ]
    if not sigma[:2].any() or spread[1] > LINE_SHARE * spread[0]:
        return []
    worst = float(np.sqrt(np.linalg.eigvalsh(T.C[:3, :3])[-1]))
    return [
        Doubt(
            "near_line",
            f"the spheres lie nearly on one line ({spread[1]:.2f} m aside over "
            f"{spread[0]:.1f} m): the turn about it is known to {1e3 * worst:.1f} mrad only; add a "
            "sphere off the line",
            worst,
        )
    ]


def motion_doubts(one: SphereMeasurement, two: SphereMeasurement, k: int) -> list[Doubt]:
    """Doubts about a sphere that moved during a scan."""
    out = []
    for name, part in zip("AB", (one, two), strict=True):
        if part.still is not None and not part.still.still:
            moved = float(np.linalg.norm(part.still.displacement_m))
            out.append(
                Doubt(
                    "moved",
                    f"sphere {k} moved by {1e3 * moved:.1f} mm during scan {name}: leave it out or "
                    "measure it again",
                    moved,
                )
            )
    return out


def radius_doubts(one: SphereMeasurement, two: SphereMeasurement, k: int) -> list[Doubt]:
    """Doubts about radii that differ from the given one, or between the frames."""
    out = []
    for name, part in zip("AB", (one, two), strict=True):
        if part.free is not None and radius_differs(part.free, part.sphere.radius, 0.0):
            out.append(
                Doubt(
                    "radius",
                    f"sphere {k} of {name} has a radius of {part.free.radius:.4g}, not "
                    f"{part.sphere.radius:.4g}: its centre is off by as much; give the right "
                    "--radius",
                    part.free.radius,
                )
            )
    if not one.sphere.radius_known and radius_differs(
        one.sphere, two.sphere.radius, two.sphere.C[3, 3]
    ):
        out.append(
            Doubt(
                "radii",
                f"sphere {k} has a radius of {one.sphere.radius:.4g} in A and "
                f"{two.sphere.radius:.4g} in B: not the same sphere, or not the same units",
                two.sphere.radius / one.sphere.radius,
            )
        )
    return out


def radius_differs(free: Sphere, radius: float, variance: float) -> bool:
    """Whether a fitted radius differs from another one with its variance, m²."""
    off, sigma = abs(free.radius - radius), float(np.sqrt(free.C[3, 3] + variance))
    return bool(off > max(RADIUS_SIGMAS * sigma, RADIUS_SHARE * radius))
