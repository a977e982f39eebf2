"""Whether the surface changed during the survey: material heaped on or taken away between passes.

A patch holds the mean residual of its returns in each time bin. What was seen after a moment lies
above what was seen before it by the difference of two means. An offset d of the positions moves a
patch with normal n by ``d·n``, one that grows over the site as a plane does by the patch's place
times that: both are fitted, with weights that leave out what is far off, and taken out. What is
left is the same all over the site but where the surface changed. Of several moments the one counts
after which the most patches lie elsewhere.

Where the two surfaces are further apart than the filter takes for one, a patch is of the one or the
other, and shows nothing but that all of its returns are from before, or from after. Such patches,
and those that scatter, belong to the change where they lie among patches that moved. Returns half
on either of two surfaces scatter by half their distance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.math.equal_rows import distinct_cells
from ladar_volume.model.records import F64, I64, Bool, PatchTable
from ladar_volume.model.verdict import Doubt
from ladar_volume.uncertainty.packing import navigation_units
from ladar_volume.uncertainty.patch_table import ragged_index
from ladar_volume.volume.field_checks.standing_objects import parts

#: Moments that are asked: shares of the time bins. Patches that are asked at most, fewest that
#: answer, fewest that changed together, and how near each other these are, in distances of
#: neighbours.
MOMENTS = tuple(0.1 * k for k in range(1, 10))
ASKED, FEWEST, TOGETHER, NEAR = 20_000, 50, 10, 2.0
#: Fewest returns of a patch before and after, least share of them, and least upward component of
#: its normal.
RETURNS, SHARE, UPWARD = 5, 0.1, 0.7
#: A patch moved where it is so many standard deviations off, and so far, m.
MOVED, LEAST_M = 5.0, 0.02
#: It scatters above so many times the median; it was seen at one time where less than this share of
#: its returns is of the other.
SCATTERS, ONCE = 3.0, 0.05
#: Rounds of the fit at most, and the relative change of its scale at which they end; and the
#: quantile of what moved that stands for patches seen at one time.
ROUNDS, SETTLED, MUCH = 8, 0.01, 0.9


class SurfaceChange(NamedTuple):
    """t_ns : after when the surface is another · row : (k,) patches where it changed · by_m : (k,)
    m, by how much, upward or downward · area_m2 : (k,) plan area of each · up : whether most of
    it rose
    """

    t_ns: int
    row: I64
    by_m: F64
    area_m2: F64
    up: bool


class Moved(NamedTuple):
    """What patches show of a moment: ``off`` (k,) m, how much higher what was seen after it lies;
    whether that is far off, ``far`` (k,); and the share of the returns that is of after it, (k,).
    """

    off: F64
    far: Bool
    share: F64


class Means(NamedTuple):
    """What patches ``row`` (k,) hold of time bins: of each entry (l,) whose of these it is, the
    bin, the returns, and the sum of their residuals, m; and of each patch (k,) all returns, and the
    sum of their residuals.
    """

    row: I64
    owner: I64
    bins: I64
    returns: F64
    sums: F64
    every: F64
    whole: F64


def patch_means(patches: PatchTable) -> Means | None:
    """What patches that face upward hold; None where residuals are not known or patches are few."""
    row = np.flatnonzero(np.abs(patches.normal[:, 2]) > UPWARD).astype(np.int64)
    row = row[:: max(1, math.ceil(len(row) / ASKED))]
    if len(row) < FEWEST or not len(patches.nav_residual):
        return None
    entry = ragged_index(patches.nav_start, row)
    owner = np.repeat(np.arange(len(row)), np.diff(patches.nav_start)[row])
    residual = patches.nav_residual[entry].astype(np.float64)
    if not np.isfinite(residual).all():
        return None
    unit = navigation_units(patches)[row[owner], -2, 0].astype(np.float64)
    returns = patches.used[row[owner]] * patches.M_nav[entry, -2, 0] * unit
    sums = returns * residual
    every, whole = (np.bincount(owner, of, len(row)).astype(np.float64) for of in (returns, sums))
    return Means(row, owner, patches.nav_bin[entry], returns, sums, every, whole)


def apart(place: F64) -> float:
    """Distance of neighbouring patches at places (k, 3), m."""
    near = np.asarray(cKDTree(place).query(place, 2)[0])
    return float(np.median(near[:, 1]))


def common_offset(X: F64, y: F64, weight: F64) -> tuple[F64, float]:
    """Residuals (k,) of y (k,) from a fit with columns X (k, p) that what is far off does not take
    part in, and their scale.
    """
    w, left, scale = weight, y, 0.0
    for _ in range(ROUNDS):
        A = X * w[:, None]
        left = y - X @ np.linalg.lstsq(A.T @ X, A.T @ y, rcond=1e-12)[0]
        before, scale = scale, 1.4826 * float(np.median(np.abs(left)))
        if abs(scale - before) <= SETTLED * scale:
            break
        w = weight / (1.0 + (left / max(2.0 * scale, 1e-9)) ** 2) ** 2
    return left, scale


def moved_at(patches: PatchTable, seen: Means, moment: float) -> Moved | None:
    """What patches show of a moment, a time bin; None where few were seen before and after it."""
    late, every, k = seen.bins >= moment, seen.every, len(seen.row)
    after, above = (np.bincount(seen.owner, of * late, k) for of in (seen.returns, seen.sums))
    before, below = every - after, seen.whole - above
    good = np.minimum(before, after) > np.maximum(RETURNS, SHARE * every)
    if np.count_nonzero(good) < FEWEST:
        return None
    n1, n0 = after[good], before[good]
    off = above[good] / n1 - below[good] / n0
    row = seen.row[good]
    variance = patches.sigma[row] ** 2 * (1.0 / n0 + 1.0 / n1)
    n, place = patches.normal[row], patches.centre[row] - patches.centre[row].mean(axis=0)
    X = np.column_stack([n, place[:, :2] * n[:, 2:] / max(float(np.ptp(place)), 1e-9)])
    left, scale = common_offset(X, off, 1.0 / (variance + 1e-6))
    some = np.zeros(k)
    some[good] = left
    far = np.zeros(k, np.bool_)
    far[good] = np.abs(left) > np.maximum(MOVED * np.sqrt(scale**2 + variance), LEAST_M)
    return Moved(some, far, after / np.maximum(every, 1e-9))


def together(place: F64, mask: Bool, counts: Bool, apart_m: float) -> Bool:
    """Those of the mask (k,), at places (k, 3), that lie among :data:`TOGETHER` that count (k,)."""
    at = np.flatnonzero(mask)
    out = np.zeros(len(mask), np.bool_)
    if len(at):
        pairs = cKDTree(place[at]).query_pairs(NEAR * apart_m, output_type="ndarray")
        label = parts(len(at), pairs[:, 0], pairs[:, 1])
        out[at] = np.bincount(label, counts[at])[label] >= TOGETHER
    return out


def surface_change(patches: PatchTable, bin_ns: int) -> SurfaceChange | None:
    """Where the surface changed during the survey; None where it did not. bin_ns : of a bin."""
    seen = patch_means(patches)
    if seen is None:
        return None
    bins, place = np.unique(seen.bins), patches.centre[seen.row]
    most, best, moment, apart_m = 0.0, None, 0.0, 0.0
    for q in MOMENTS:
        now = float(np.quantile(bins, q))
        moved = moved_at(patches, seen, now)
        if moved is None or np.count_nonzero(moved.far) < TOGETHER:
            continue
        apart_m = apart_m or apart(place)
        size = sum(
            float(np.abs(moved.off[together(place, own, own, apart_m)]).sum())
            for own in (moved.far & (moved.off > 0.0), moved.far & (moved.off < 0.0))
        )
        if size > most:
            most, best, moment = size, moved, now
    t_ns = int(moment * bin_ns)
    return None if best is None else change_of(patches, seen, best, t_ns, apart_m)


def change_of(
    patches: PatchTable, seen: Means, moved: Moved, t_ns: int, apart_m: float
) -> SurfaceChange:
    """The change that patches show, with those among them that show one of the two surfaces.
    apart_m : distance of neighbouring patches, m
    """
    place, sigma = patches.centre[seen.row], patches.sigma[seen.row]
    usual = float(np.median(sigma))
    once = np.minimum(moved.share, 1.0 - moved.share) < ONCE
    some = together(place, moved.far | once | (sigma > SCATTERS * usual), moved.far, apart_m)
    by = np.maximum(2.0 * np.sqrt(np.maximum(sigma**2 - usual**2, 0.0)), np.abs(moved.off))
    by[once & ~moved.far] = float(np.quantile(by[moved.far], MUCH))
    up = float(moved.off[moved.far].sum()) > 0.0
    cell = np.floor(place[some, :2] / apart_m).astype(np.int64)
    _, number = distinct_cells(cell)
    area = apart_m**2 / np.bincount(number)[number]
    return SurfaceChange(t_ns, seen.row[some], by[some], area, up)


def change_doubt(found: SurfaceChange, own: Bool, where: F64, start_ns: int) -> Doubt:
    """The doubt of what changed on a body. own : (k,) which of the patches are its · where : (k, 3)
    their centres, map · start_ns : of the survey
    """
    area, more = (float(x[own].sum()) for x in (found.area_m2, found.area_m2 * found.by_m))
    x, y = where[own, :2].mean(axis=0).tolist()
    words = (
        f"{(found.t_ns - start_ns) * 1e-9:.0f} s into the survey {area:.3g} m² around ({x:.1f}, "
        f"{y:.1f}) {'rose' if found.up else 'sank'} by some {1e2 * more / max(area, 1e-9):.2g} cm: "
        f"material was {'heaped on' if found.up else 'taken away'} between passes, and the volume "
        f"is neither that of before nor that of after; {more:.3g} m³ are in sigma; survey while "
        "nobody works there, or replay one part with --start or --duration"
    )
    return Doubt("changed", words, more)
