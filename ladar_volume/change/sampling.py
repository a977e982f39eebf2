"""What the choice of points costs a volume between two scans: it is computed again from halves.

Edges that no point marks are cut short, and roughness between the points is not seen. The error of
a triangulation falls with the square of the spacing, so from half of the points it is twice that of
all: the mean over both halves of a split less the whole estimates the error, half of the difference
of the halves its scatter (after Quenouille's split halves 1956, and Richardson). The noise of the
points is in that scatter too and is taken out again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from ladar_volume.change.excavation import Region, Scan, between_scans
from ladar_volume.change.spherical_tin import stereographic, unit_directions, widest_gap
from ladar_volume.change.two_surfaces import near_polygon
from ladar_volume.math.random_halves import random_halves
from ladar_volume.model.errors import SurfaceError, VolumeError
from ladar_volume.model.records import F64, I64

#: Splits into halves: of many points, and more of few, where they cost little: an error from three
#: is itself uncertain by 40 % of it. Tries, since some halves make no surface, and the first seed.
SPLITS, MORE, FEW, TRIES, SEED = 3, 6, 10_000, 9, 7


def sampling_variance(
    a: Scan, b: Scan, region: Region, removed_m3: float, noise_m6: float, max_edge_m: float = np.inf
) -> float | None:
    """Variance, m⁶, of the volume between scans A and B (both within their regions) by the choice
    of their points; None where halves of them do not make the surfaces.

    removed_m3 : from all points · noise_m6 : the share of the points' noise in its variance
    """
    found: list[F64] = []
    wanted = MORE if len(a.points) + len(b.points) <= FEW else SPLITS
    for seed in range(SEED, SEED + TRIES):
        if len(found) == wanted:
            break
        try:
            found.append(halves(a, b, region, seed, max_edge_m))
        except (VolumeError, SurfaceError):
            continue
    if not found:
        return None
    v = np.array(found)
    off = ((v.mean(axis=1) - removed_m3) ** 2).mean()
    scatter = ((0.5 * (v[:, 0] - v[:, 1])) ** 2).mean()
    noise = noise_m6 if np.isfinite(noise_m6) else 0.0
    return float(off + max(scatter - noise, 0.0))


def halves(a: Scan, b: Scan, region: Region, seed: int, max_edge_m: float) -> F64:
    """Volumes (2,) m³ from the two halves of a random split; both have the outlines of the scans,
    without which the ring would lie outside of many halves.
    """
    rng = np.random.default_rng(seed)
    rows_a, rows_b = (
        random_halves_of(a.points, region, rng),
        random_halves_of(b.points, region, rng),
    )
    edge_a, edge_b = outline(a), outline(b)
    coarse = replace(region, spacing_m=float(np.sqrt(2.0)) * region.spacing_m)
    out: F64 = np.array(
        [
            between_scans(
                a.part(np.union1d(one, edge_a)),
                b.part(np.union1d(two, edge_b)),
                coarse,
                b.scanner,
                max_edge_m,
            ).removed_m3
            for one, two in zip(rows_a, rows_b, strict=True)
        ]
    )
    return out


def random_halves_of(points: F64, region: Region, rng: np.random.Generator) -> tuple[I64, I64]:
    """Rows of two random halves of points (n, 3), those of the region by themselves: which points
    scan B has far beyond it depends on how the region's box lies, and must not change the others.
    """
    near = np.ones(len(points), bool)
    if region.corners.shape[1] == 2:
        near = near_polygon(points[:, :2], region.corners, 0.5 * region.margin_m)
    parts = [
        (rows, random_halves(points[rows], rng)) for rows in map(np.flatnonzero, (near, ~near))
    ]
    one, two = (np.concatenate([rows[half[k]] for rows, half in parts]) for k in (0, 1))
    return one, two


def outline(scan: Scan) -> I64:
    """Rows (k,) of the points at the outline of a scan as its scanner sees it."""
    direction, _ = unit_directions(scan.points, scan.scanner)
    try:
        hull = ConvexHull(stereographic(direction, widest_gap(direction)))
    except QhullError:
        return np.zeros(0, np.int64)
    return np.asarray(hull.vertices, np.int64)
