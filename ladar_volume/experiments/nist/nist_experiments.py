"""Experiments 1 to 4 of seed 000 chapter 5 on simulated scans, as published, and the same scans
measured the way the package does.

The published way: a partial TIN of each scan by adaptive insertion (residual times area), triangles
at the map's corners removed, each surface over its own footprint. Experiments 1 to 3 mesh over the
floor and subtract the cut volumes above the highest level without fill; Experiment 4 meshes along
the scan direction and compares by Method 1 (fill, in front of the box) and Method 2 (cut, behind
everything). The package's way: all points, along the scan direction, over the common footprint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.experiments.nist.nist_published import BINS, TABLE_5_6, VERTICES_5_3
from ladar_volume.experiments.nist.nist_scene import RANGE_SIGMA_M, SCANNER_M, TRUE_M3, Scan, pair
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I64, Tin
from ladar_volume.tin.adaptive import AdaptiveTin, adaptive_tin
from ladar_volume.tin.diagonal_exchange import exchange_diagonals
from ladar_volume.tin.elevation_adjustment import adjust_rms, fit_of
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.median_screen import tin_filter
from ladar_volume.tin.scan_frame import Frame, frame_along, mean_direction
from ladar_volume.volume.cutfill import cut_sequence
from ladar_volume.volume.floors import Offset, sequence_offset
from ladar_volume.volume.overlay import volumes_between
from ladar_volume.volume.published_methods import (
    Pairs,
    front_level,
    method_one,
    method_two,
    zero_fill_level,
)

#: Vertices of Experiment 1 (the last is all points), of Experiments 3 and 4.
COUNTS = (3000, 4000, 5000, 6000, 7000, 8000, 9000, 10_000, 13_000, 16_000)
SUBSET_VERTICES, FULL_VERTICES, SUBSETS = 3000, 6000, 10
#: Tolerance of the median filter, m: not printed; five times the range noise.
FILTER_TOLERANCE_M = 0.10
#: Steps between the levels of Experiment 4, and those of the search for the front of the box, m;
#: levels of one method.
LEVEL_STEP_M, SEARCH_STEP_M, LEVELS = 0.05, 0.002, 5


@dataclass(frozen=True)
class PackageVolume:
    """The package's way: volume_m3 and its predicted sigma_m3 from range noise · area_m2 : of the
    common footprint
    """

    volume_m3: float
    sigma_m3: float
    area_m2: float


def error_pct(volume_m3: F64 | float) -> F64:
    """Error of a volume of the box, in per cent of the true one."""
    return np.asarray(100.0 * (np.asarray(volume_m3) / TRUE_M3 - 1.0))


def adaptive(points: F64, vertices: int, bins: int | None = None) -> AdaptiveTin:
    """The published TIN of points (n, 3); with as many vertices as points, or more, the full
    one.
    """
    if vertices >= len(points):
        return adaptive_tin(points, ratio=1.0, bins_per_row=bins)
    return adaptive_tin(points, vertices=vertices, bins_per_row=bins)


def adjust_elevations(points: F64, tin: Tin) -> Tin:
    """The TIN after RMS elevation adjustment to the points."""
    return adjust_rms(tin, points).tin


def box_volume(tins: tuple[Tin, Tin]) -> float:
    """Volume by Experiments 1 to 3: difference of the cut volumes above the highest common level
    without fill.
    """
    return float(method_two(*tins).volume_m3[0])


def surface_pairs(
    points: tuple[F64, F64], vertices: tuple[int, int], bins: int | None = None
) -> list[tuple[Tin, Tin]]:
    """The two surfaces, with and without the box, first as inserted, then RMS adjusted."""
    plain = [adaptive(p, n, bins).tin for p, n in zip(points, vertices, strict=True)]
    return [
        (plain[0], plain[1]),
        (adjust_elevations(points[0], plain[0]), adjust_elevations(points[1], plain[1])),
    ]


def experiment_one(
    seed: int, counts: tuple[int, ...] = COUNTS, bins: tuple[int, ...] = BINS
) -> F64:
    """Volumes (2, counts, bins), m³, first without then with RMS adjustment (Table 5.2); NaN where
    the bins alone hold more vertices.
    """
    a, b = pair(1, seed)
    out = np.full((2, len(counts), len(bins)), np.nan)
    for i, n in enumerate(counts):
        for j, per_row in enumerate(bins):
            try:
                surfaces = surface_pairs((a.points, b.points), (n, n), per_row)
            except SurfaceError as error:
                if error.reason != "surface_bins":
                    raise
                continue
            out[:, i, j] = [box_volume(s) for s in surfaces]
    return out


def fits(points: F64, tin: Tin) -> tuple[float, float]:
    """ASD and RMS, m, of the points over a surface's relevant triangles."""
    residual = fit_of(tin, points).residuals(tin.vertices[:, 2])
    return float(np.abs(residual).mean()), float(np.sqrt((residual**2).mean()))


def experiment_two(
    seed: int, densities: tuple[int, ...] = (1, 2, 3, 4, 5)
) -> tuple[F64, F64, float]:
    """Volumes (densities, 4 options), m³, measures of fit (densities, with and without, ASD and
    RMS, 4 options), m, and the volume of the full set of the last density (Tables 5.3 and 5.4).
    """
    volumes, measures, full = (
        np.empty((len(densities), 4)),
        np.empty((len(densities), 2, 2, 4)),
        float("nan"),
    )
    for i, density in enumerate(densities):
        a, b = pair(density, seed)
        points, n = (a.points, b.points), VERTICES_5_3[density - 1]
        plain, rms = surface_pairs(points, (n, n))
        options = [plain, rms]
        for one, two in ((plain), (rms)):
            options.append(
                (exchange_diagonals(one, points[0]).tin, exchange_diagonals(two, points[1]).tin)
            )
        volumes[i] = [box_volume(s) for s in options]
        for k, surfaces in enumerate(options):
            for s in range(2):
                measures[i, s, :, k] = fits(points[s], surfaces[s])
        full = (
            box_volume(surface_pairs(points, (len(points[0]), len(points[1])))[0])
            if i == len(densities) - 1
            else full
        )
    return volumes, measures, full


def subsets(scan: Scan, seed: int, which: int) -> list[I64]:
    """Ten random halves of a scan, as indices in ascending order; ``which`` tells the scans of a
    pair apart.
    """
    rng = np.random.default_rng([seed, 17, which])
    return [
        np.sort(rng.permutation(len(scan.points))[: len(scan.points) // 2]) for _ in range(SUBSETS)
    ]


def experiment_three(seed: int, count: int = SUBSETS) -> F64:
    """Volumes (subsets, 4), m³, in the columns of Table 5.5: no filter with and without RMS
    adjustment, filter with and without.
    """
    a, b = pair(1, seed)
    out = np.empty((count, 4))
    for k, (i, j) in enumerate(
        list(zip(subsets(a, seed, 0), subsets(b, seed, 1), strict=True))[:count]
    ):
        raw = a.points[i], b.points[j]
        for column, points in (
            (0, raw),
            (2, tuple(tin_filter(p, FILTER_TOLERANCE_M).points_map for p in raw)),
        ):
            plain, rms = surface_pairs((points[0], points[1]), (SUBSET_VERTICES, SUBSET_VERTICES))
            out[k, column : column + 2] = box_volume(rms), box_volume(plain)
    return out


def scan_frame(without: Scan) -> Frame:
    """The frame along the general scan direction, its origin at the scanner, so that levels are
    minus the distance along it.
    """
    return frame_along(mean_direction(without.points, SCANNER_M), SCANNER_M)


@dataclass(frozen=True)
class MethodComparison:
    """Experiment 4 of one pair of clouds: one, two : the levels of Method 1 and Method 2 (Tables
    5.7, 5.8) · offset : between the two sequences of cut volumes in front of the box (Table 5.6),
    of the surface with it against that without
    """

    one: Pairs
    two: Pairs
    offset: Offset


def compare_methods(surfaces: tuple[Tin, Tin]) -> MethodComparison:
    """Both methods, from the level in front of the box five steps towards the scanner, and from the
    highest level without fill down.
    """
    steps = np.asarray(LEVEL_STEP_M * np.arange(LEVELS), dtype=np.float64)
    front = front_level(*surfaces, SEARCH_STEP_M)
    two = method_two(*surfaces, zero_fill_level(*surfaces) - steps)
    level = np.arange(
        front,
        max(float(s.vertices[s.triangles[s.relevant], 2].max()) for s in surfaces),
        SEARCH_STEP_M,
    )
    cuts = [cut_sequence(s, level).cut_m3 for s in surfaces]
    offset = (
        sequence_offset(level, cuts[0], cuts[1], 0.02)
        if len(level) > 30
        else Offset(float("nan"), float("nan"), float("nan"), 0)
    )
    return MethodComparison(method_one(*surfaces, front + steps[::-1]), two, offset)


#: Levels of Table 5.6, cm: every 0.2 cm, of which the first and the last are printed.
FRONT_LEVELS_CM = np.round(np.linspace(-30.0, -80.0, 251), 1)


def front_sequences(seed: int) -> tuple[F64, F64]:
    """Levels (k,), m, and the cut volumes (2, k), m³, of the full set with and without the box, not
    adjusted: those of Table 5.6, moved so that the first cuts as much as is printed there.
    """
    a, b = pair(1, seed)
    frame = scan_frame(b)
    surfaces = [adaptive(frame.points(s.points), FULL_VERTICES).tin for s in (a, b)]
    top = max(float(s.vertices[s.triangles[s.relevant], 2].max()) for s in surfaces)
    fine = np.linspace(top, top - 200 * SEARCH_STEP_M, 201)
    first = int(np.argmax(cut_sequence(surfaces[0], fine).cut_m3 >= 1e-6 * TABLE_5_6[0, 1]))
    level: F64 = 0.01 * (FRONT_LEVELS_CM - FRONT_LEVELS_CM[0]) + fine[first]
    return level, np.array([cut_sequence(s, level).cut_m3 for s in surfaces])


def difference_at(level_m: F64, cuts_m3: F64, offset_m: float) -> float:
    """Root of the summed squares, m³, of the differences of two sequences (2, k) where the second
    is read ``offset_m`` below the levels (k,) of the first, as in Table 5.6.
    """
    order = np.argsort(level_m)
    at = level_m - offset_m
    there = at >= level_m.min()
    second = np.interp(at[there], level_m[order], cuts_m3[1][order])
    return float(np.sqrt(np.sum((cuts_m3[0][there] - second) ** 2)))


def experiment_four(seed: int, count: int = SUBSETS) -> list[list[MethodComparison]]:
    """The full set, then each subset; of each without and with RMS adjustment (Tables 5.7 to
    5.9).
    """
    a, b = pair(1, seed)
    frame = scan_frame(b)
    halves = [
        (a.points[i], b.points[j])
        for i, j in zip(subsets(a, seed, 0), subsets(b, seed, 1), strict=True)
    ][:count]
    out = []
    for points, n in [
        ((a.points, b.points), FULL_VERTICES),
        *((h, SUBSET_VERTICES) for h in halves),
    ]:
        turned = frame.points(points[0]), frame.points(points[1])
        out.append([compare_methods(surfaces) for surfaces in surface_pairs(turned, (n, n))])
    return out


def own_way(a: Scan, b: Scan, sigma_m: float = RANGE_SIGMA_M) -> PackageVolume:
    """All points, along the scan direction, over the common footprint; sigma from independent range
    noise through the exact gradients.
    """
    frame = scan_frame(b)
    surfaces = [build_tin(frame.points(s.points)) for s in (a, b)]
    r = volumes_between(surfaces[0], surfaces[1])
    variance = 0.0
    for scan, tin, gradient in zip((a, b), surfaces, (r.gradient_net, r.lower_net), strict=True):
        along = (frame.gradients_to_map(gradient) * scan.ray[tin.source]).sum(axis=1)
        variance += float((along**2).sum()) * sigma_m**2
    return PackageVolume(r.net_m3, float(np.sqrt(variance)), r.area_m2)
