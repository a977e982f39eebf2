"""Whether the ground of the same survey is the base of a body: other readings of it, each with what
it makes of the volume and how far it may differ by chance.

Three readings stand against the fitted polynomial: a polynomial one degree higher through the same
ground, one through the toe line, the surface seen along the boundary of the outline, and a terrace
within the outline, where there is one. All differences are weighted sums ``Σ w e`` of residuals of
the ground, and their variance is that of the residuals' random field
(:mod:`ladar_volume.uncertainty.ground_field`). A pile on a pad or in a hollow, or ground that
bends, shows in one or more.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import stdtrit

from ladar_volume.ground.heights import (
    PART,
    height_above,
    write_row,
)
from ladar_volume.ground.polynomial import (
    COEFFICIENTS,
    base_height,
    degree_of,
    design,
)
from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I32, I64, Bool, Plane, Tin, Volume
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.boundary import boundary_sides, side_ends
from ladar_volume.tin.full_tin import vertex_mask
from ladar_volume.uncertainty.ground_field import GroundField, Roughness, mean_spacing
from ladar_volume.uncertainty.roughness import estimate_roughness
from ladar_volume.volume.field_checks.terrace import terrace_points

#: A reading differs beyond chance above so many standard deviations of the difference, and matters
#: above so many of the volume.
CHANCE, MATTERS = 3.0, 2.0
#: Standard deviation of the base where readings differ beyond chance: what is beyond so many times
#: it.
BEYOND = 1.5
#: Fewest points of a reading, and of an outline with nothing beyond it, whose hull has few; most of
#: the toe line.
FEWEST, FEWEST_AT_END, MOST = 30, 8, 2000
#: From where to where the toe line lies beyond the outline, in radii of the filter.
TOE = (1.0, 2.0)
#: Points that the field of the residuals is told from.
FIELD = 200
#: A given base is meant to be the ground where it lies no further from it, m.
NEAR_M = 0.5
#: Share of the volume that may lie below the base.
BELOW = 0.005
#: Degrees of freedom from which on Student's t is the normal distribution.
MANY = 200.0
#: Names of readings.
TOE_LINE, TERRACE = "the surface along the toe", "the terrace along the toe"


@dataclass(frozen=True)
class Reading:
    """name : of the base · more_m3 : what the volume above it has more · sigma_m3 : of that
    difference, by chance.
    """

    name: str
    more_m3: float
    sigma_m3: float

    @property
    def beyond_m3(self) -> float:
        """What is beyond chance, m³."""
        return max(0.0, abs(self.more_m3) - BEYOND * self.sigma_m3)


@dataclass(frozen=True)
class BaseReadings:
    """readings : other than the base · freedom : independent places of the ground, which the
    variance ``base_surface`` was told from
    """

    readings: tuple[Reading, ...]
    freedom: float

    @property
    def variance_m6(self) -> float:
        """Variance of the volume for the choice of the base, m⁶."""
        return max((r.beyond_m3 for r in self.readings), default=0.0) ** 2


def toe_points(tin: Tin, inside: Bool, radius_m: float) -> I64:
    """Vertices (k,) in a band along the toe, outside the triangles ``inside`` (m,): nearer than the
    filter's radius it bends the surface there.
    """
    body, around = vertex_mask(tin, inside), vertex_mask(tin, tin.relevant & ~inside)
    border, xy = body & around, tin.vertices[:, :2]
    if not border.any():
        return np.zeros(0, np.int64)
    far = TOE[1] * radius_m
    beyond = around & ~body
    for c in range(2):
        own = xy[border, c]
        beyond &= (xy[:, c] > own.min() - far) & (xy[:, c] < own.max() + far)
    out = np.flatnonzero(beyond).astype(np.int64)
    if not len(out):
        return out
    tree = cKDTree(xy[border], balanced_tree=False, compact_nodes=False)
    d = np.asarray(tree.query(xy[out], distance_upper_bound=far)[0])
    out = out[(d > TOE[0] * radius_m) & (d < far)]
    return out[:: max(1, math.ceil(len(out) / MOST))]


def area_moments(tin: Tin, inside_m2: F64, origin: F64, scale: float, degree: int) -> F64:
    """Integrals (p,) over the outline of the terms of a polynomial in ``(xy − origin) / scale``: by
    the three middles of the sides of each triangle, exact to degree 2.
    """
    sums = np.zeros((len(tin.triangles) // PART + 1, COEFFICIENTS[degree]))
    moments_kernel(tin.vertices, tin.triangles, inside_m2, origin, scale, sums)
    out: F64 = sums.sum(axis=0)
    return out


@kernel
def moments_kernel(
    vertices: F64, triangles: I32, inside_m2: F64, origin: F64, scale: float, sums: F64
) -> None:
    """See :func:`area_moments`: sums (k, p) over every :data:`PART` triangles."""
    row = np.empty(sums.shape[1])
    for t in range(len(triangles)):
        if not inside_m2[t] > 0.0:
            continue
        for k in range(3):
            a, b = vertices[triangles[t, k]], vertices[triangles[t, (k + 1) % 3]]
            x, y = 0.5 * (a[0] + b[0]) - origin[0], 0.5 * (a[1] + b[1]) - origin[1]
            write_row(x / scale, y / scale, row)
            for c in range(len(row)):
                sums[t // PART, c] += inside_m2[t] / 3.0 * row[c]


def fit_weights(xy: F64, moments: F64, origin: F64, scale: float, degree: int) -> F64:
    """Weights (n,) m² of heights at xy (n, 2) in the integral of the polynomial through them."""
    X = design((xy - origin) / scale, np.zeros(2), degree)
    out: F64 = X @ np.linalg.lstsq(X.T @ X, moments, rcond=1e-12)[0]
    return out


def field_sigma(xy: F64, weight: F64, rough: Roughness, noise: F64) -> float:
    """Standard deviation m³ of ``Σ w e`` over a ground field and its points' noise (n,) m²."""
    none = np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros(0)
    field = GroundField(*none, xy, weight, rough)
    return math.sqrt(field.variance_m6 + float(weight**2 @ noise))


def residual_field(xy: F64, residual: F64, noise: F64, parameters: int) -> Roughness:
    """The field of residuals (n,) m at xy (n, 2) m, from a part of them."""
    some = slice(None, None, max(1, math.ceil(len(xy) / FIELD)))
    rough = estimate_roughness(xy[some], residual[some], noise[some], parameters)
    return dataclasses.replace(rough, spacing_m=mean_spacing(xy))


class GroundSeen(NamedTuple):
    """The ground that a base was fitted to, the same for all bodies on it. xy : (n, 2) m · residual
    : (n,) m off the base · noise : (n,) m² of these · origin, scale : m, of the polynomials ·
    higher : degree of the other one · rough : field of what is off that · spread_m : its standard
    deviation
    """

    xy: F64
    residual: F64
    noise: F64
    origin: F64
    scale: float
    higher: int
    rough: Roughness
    spread_m: float


def ground_seen(tin: Tin, base: Plane, height_variance: F64) -> GroundSeen | None:
    """The ground of a base; None for few points, as above a base that is given. height_variance :
    (n,) m² of the vertices
    """
    if len(base.support) < FEWEST:
        return None
    xy = tin.vertices[base.support, :2]
    e = tin.vertices[base.support, 2] - base_height(base, xy)
    noise = height_variance[base.support]
    origin, scale = xy.mean(axis=0), max(float(np.ptp(xy, axis=0).max()), 1e-9)
    higher = min(degree_of(base) + 1, 2)
    X = design((xy - origin) / scale, np.zeros(2), higher)
    left = e - X @ np.linalg.lstsq(X.T @ X, X.T @ e, rcond=1e-12)[0]
    rough = residual_field(xy, left, noise, X.shape[1])
    spread_m = 1.4826 * float(np.median(np.abs(left)))
    return GroundSeen(xy, e, noise, origin, scale, higher, rough, spread_m)


def base_readings(
    tin: Tin, base: Plane, inside_m2: F64, height_variance: F64, radius_m: float
) -> BaseReadings | None:
    """The readings for an outline, inside_m2 (m,) m² of each triangle; None above a base that is
    given. height_variance : (n,) m² of the vertices · radius_m : of the filter.
    """
    seen = ground_seen(tin, base, height_variance)
    return readings_on(seen, tin, base, inside_m2, height_variance, radius_m)


def readings_on(
    seen: GroundSeen | None,
    tin: Tin,
    base: Plane,
    inside_m2: F64,
    height_variance: F64,
    radius_m: float,
) -> BaseReadings | None:
    """The same on ground that is known; the surface may be a part of that the base was fitted on,
    as far as a few radii around the outline.
    """
    if seen is None:
        return None
    degree, found = degree_of(base), []
    xy, origin, scale, rough = seen.xy, seen.origin, seen.scale, seen.rough
    # those of a lower degree come first
    moments = area_moments(tin, inside_m2, origin, scale, seen.higher)
    if seen.higher > degree:
        w = fit_weights(xy, moments, origin, scale, seen.higher)
        chance = field_sigma(xy, w, rough, seen.noise)
        words = f"a ground of degree {seen.higher}"
        found.append(Reading(words, -float(w @ seen.residual), chance))
    own = moments[: COEFFICIENTS[min(degree, 1)]]
    toe = toe_points(tin, inside_m2 > 0.0, radius_m)
    terrace = terrace_points(tin, base, inside_m2, seen.spread_m, radius_m)
    terrace = terrace[:: math.ceil(len(terrace) / MOST) or 1]
    through = Through(base, own, origin, scale, rough)
    for name, rows in ((TOE_LINE, toe), (TERRACE, terrace)):
        found += through.reading(name, tin.vertices[rows], height_variance[rows])
    return BaseReadings(tuple(found), freedom_of(rough, len(xy)))


class Through(NamedTuple):
    """Readings through points along the toe. base : they are held against · moments : (p,)
    integrals over the outline of the terms of a plane, or a level, about ``origin`` (2,) m, by
    ``scale`` m · rough : field of the ground
    """

    base: Plane
    moments: F64
    origin: F64
    scale: float
    rough: Roughness

    def reading(self, name: str, r: F64, variance: F64) -> list[Reading]:
        """That through points r (k, 3) m of variances (k,) m²; none through few."""
        if len(r) < FEWEST:
            return []
        moved = self.moments if name == TOE_LINE else self.moments[:1]
        degree = min(degree_of(self.base), 1, len(moved) - 1)
        w = fit_weights(r[:, :2], moved, self.origin, self.scale, degree)
        chance = field_sigma(r[:, :2], w, self.rough, variance)
        return [Reading(name, -float(w @ height_above(r, self.base)), chance)]


def freedom_of(rough: Roughness, n: int) -> float:
    """How many independent places n points of the ground are."""
    return max(rough.spacing_m**2 * n / (2.0 * math.pi * rough.length_m**2), 1.0)


def base_reading_doubts(
    found: BaseReadings, volume_m3: float, sigma_m3: float, name_of_base: str
) -> list[Doubt]:
    """Readings of the base that differ by more than chance, and by more than two sigma. sigma_m3 :
    without the line ``base_model``.
    """
    out = []
    for r in found.readings:
        if abs(r.more_m3) <= max(CHANCE * r.sigma_m3, MATTERS * sigma_m3):
            continue
        name = "base_toe" if "toe" in r.name else "base_bends"
        words = (
            f"two readings of the base differ: {volume_m3:.5g} m³ above the "
            f"{name_of_base}, {volume_m3 + r.more_m3:.5g} m³ above {r.name} (by chance "
            f"{r.sigma_m3:.2g} m³); look whether the body stands on a pad, in a hollow or on "
            "bent ground, set ground.degree or volume.ground_ring_m, or survey the empty site"
        )
        out.append(Doubt(name, words, r.more_m3))
    return out


def below_base(cut_m3: float, fill_m3: float, sigma_m3: float) -> list[Doubt]:
    """A body that rises above its ground has next to nothing below it. sigma_m3 : of the fill, by
    chance.
    """
    less = min(cut_m3, fill_m3)  # in a deep hollow most of a body lies below
    if not less > max(CHANCE * sigma_m3, BELOW * cut_m3):
        return []
    words = (
        f"{less:.3g} m³ inside the outline of the body lie below its base and are taken off: it "
        "may stand on a pad or in a hollow, lower than the ground around, or a trench or ruts run "
        "along its toe; narrow volume.ground_ring_m, give a level, or survey the empty site"
    )
    return [Doubt("below_base", words, less)]


def unsettled(base: Plane, sigma_m3: float) -> list[Doubt]:
    """Outline and ground go on changing each other. sigma_m3 : of the volume without that."""
    if not base.unsettled_m3 > sigma_m3:
        return []
    words = (
        "outline and ground do not settle: the ground around one outline makes another, and the "
        f"volume changes by {base.unsettled_m3:.3g} m³; the ground is no plane there: draw "
        "volume.polygon_m, give a level, set ground.degree, or narrow volume.ground_ring_m"
    )
    return [Doubt("outline_unsettled", words, base.unsettled_m3)]


def doubted_m6(doubts: list[Doubt]) -> float:
    """Variance, m⁶, by what lies below the base and by an outline that does not settle, where
    these are doubted: it may not belong to the body at all.
    """
    names = ("below_base", "outline_unsettled")
    return sum((doubt.value or 0.0) ** 2 for doubt in doubts if doubt.name in names)


def outline_points(tin: Tin, inside: Bool) -> I64:
    """Vertices (k,) along the outline of the triangles ``inside`` (m,)."""
    out = np.unique(side_ends(tin, *boundary_sides(tin, inside))).astype(np.int64)
    return out[:: max(1, math.ceil(len(out) / MOST))]


def given_base_doubts(
    tin: Tin, base: Plane, inside_m2: F64, radius_m: float, volume: Volume, found: bool
) -> list[Doubt]:
    """The ground along the toe lies off a base that is given, by little and everywhere alike: a
    shift of all heights, such as a lever arm's or a datum's, which the passes cannot see. Where the
    outline was ``found`` and nothing lies beyond it, all of the ground is in it: that along the
    outline counts.
    """
    toe, fewest = toe_points(tin, inside_m2 > 0.0, radius_m), FEWEST
    if len(toe) < fewest and found:
        toe, fewest = outline_points(tin, inside_m2 > 0.0), FEWEST_AT_END
    if len(toe) < fewest or volume.cut_m3 <= volume.fill_m3:
        return []
    height = height_above(tin.vertices[toe], base)
    off = float(np.median(height))
    spread = float(np.median(np.abs(height - off)))
    more = -off * volume.area_m2
    if abs(more) <= CHANCE * volume.sigma_m3 or not 3.0 * spread < abs(off) < NEAR_M:
        return []
    words = (
        f"the ground along the toe lies {abs(off):.2g} m {'above' if off > 0.0 else 'below'} the "
        f"{volume.base}: {volume.volume_m3:.5g} m³ above that, some {volume.volume_m3 + more:.5g} "
        "m³ above the ground, and sigma spans both; check datum, antenna height and lever arms, "
        "which lift all passes alike, or set volume.base ground"
    )
    return [Doubt("base_level", words, off)]


def student_factor(normal: float, confidence: float, share: float, freedom: float) -> float:
    """The coverage factor of a confidence where a ``share`` of the variance, that of the base, was
    told from few places (Welch and Satterthwaite); ``normal`` where they are many.
    """
    if share <= 0.0 or freedom >= MANY:
        return normal
    freedom /= share**2
    if freedom >= MANY:
        return normal
    return float(stdtrit(freedom, 0.5 + confidence / 2.0))
