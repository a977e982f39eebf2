"""How a cloud was sampled: evenly, or along lines as by the rings of a rotating scanner.

The points of one ring lie on an exact cone through the scanner, whatever the noise of the ranges: a
neighbourhood within one ring has no noise across the surface. Neighbourhoods that tell noise or
carry a fit hold several lines. The distance over which they do is told per point, from the cloud
thinned to one point per voxel: while a voxel's neighbours lie on a line, it is too short.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds.filter.point_reduction import sorted_by_voxel
from ladar_volume.model.records import F64, I64, Bool

#: A neighbourhood is a line where its second eigenvalue is below this share of the first.
LINE = 0.1
#: Share of neighbourhoods that are lines from which on a cloud counts as sampled along lines, and
#: points of such a neighbourhood.
LINED, LOOK = 0.05, 30
#: Points of a sheet and of a surface of sheets, thickness of a sheet over its width, in squares,
#: and the share of the neighbourhoods that are such.
SHEET, WIDE, SHEET_FLAT, SHEETS = 12, 120, 0.05, 0.1
#: A neighbourhood reaches over so many voxels; points that it must hold to be a line, or more.
OVER, FEW, FULL = 4.0, 5, 10
#: Spacing that differs by this factor from the densest tenth to the sparsest; samples that tell the
#: spacing of a place, and their quantile; strays are not as flat as that.
UNEVEN, PLACE, USUAL, FLAT = 1.6, 20, 0.3, 0.25
#: Neighbours asked for.
ASKED = 32
#: Voxels grow by this factor; a place where lines are told apart must stay one over so many steps:
#: a surface that is a line when seen from farther off holds five lines or more.
STEP, STAYS = float(np.sqrt(2.0)), 6
#: What is a surface near by and a line from up to so many times farther off is the band of one
#: line: a ring that grazes the ground, told at one elevation while that scatters, covers an area of
#: its own exact cone and shows no noise. Where more than this share of a cloud is narrow it is the
#: cloud that is.
FARTHER, BANDS = 16.0, 0.2
#: Where lines come together over more than so many times the cloud's median distance they are too
#: few to show noise: far ground that a low scanner grazes, whose rings err in elevation.
REMOTE = 16.0
#: Widest neighbourhood over the cloud's diagonal; most voxels of the finest level.
WIDEST, MOST_VOXELS = 0.1, 200_000
#: States of a point at a level.
ALONE, ON_LINE, ON_SURFACE = 0, 1, 2


@dataclass(frozen=True)
class ThinnedLevel:
    """One point for each voxel: edge_m · first : (v,) its row · voxel : (n,) voxel of each point ·
    tree : of the points ``first``
    """

    edge_m: float
    first: I64
    voxel: I64
    tree: cKDTree


@dataclass(frozen=True)
class Lines:
    """reach_m : (n,) radius within which the neighbourhood of a point holds several lines, NaN
    where none does · levels : the thinned clouds, ascending by √2 · remote : (n,) points whose
    lines are too few to show noise
    """

    reach_m: F64
    levels: tuple[ThinnedLevel, ...]
    remote: Bool

    def level_near(self, edge_m: float) -> int:
        """The level whose edge is next to the one wanted."""
        low = self.levels[0].edge_m
        level = round(float(np.log(max(edge_m / low, 1.0)) / np.log(STEP)))
        return min(level, len(self.levels) - 1)


def thin_to_voxels(r: F64, edge_m: float) -> ThinnedLevel:
    """Points (n, 3) m near the origin thinned to one for each voxel of an edge."""
    order, keys, start, _ = sorted_by_voxel(r, edge_m)
    voxel = np.empty(len(r), np.int64)
    voxel[order] = np.repeat(np.arange(len(keys)), np.diff(start))
    first = order[start[:-1]]
    return ThinnedLevel(edge_m, first, voxel, cKDTree(r[first], balanced_tree=False))


def lies_along_lines(r: F64, near: I64) -> bool:
    """Whether points (n, 3) lie along lines, from neighbourhoods (s, k), nearest first."""
    if near.shape[1] < LOOK:
        return False
    values = _of_neighbourhoods(r, near)
    return bool(np.mean(values[:, 1] < LINE * values[:, 2]) >= LINED) or lines_are_sheets(r, near)


def lines_are_sheets(r: F64, near: I64) -> bool:
    """Whether noise wider than the spacing along lines makes a sheet of each, across the surface
    they lie on: the nearest of neighbours (s, k) lie in one, more of them on the surface.
    """
    few, many = (_axes(r[near[:, :k]]) for k in (SHEET, min(WIDE, near.shape[1])))
    thin_ones = few[0][:, 0] < SHEET_FLAT * few[0][:, 1]
    flat = many[0][:, 0] < FLAT * many[0][:, 1]
    turned = np.abs(np.einsum("si,si->s", few[1][:, :, 0], many[1][:, :, 0])) < 0.5
    return bool(np.mean(thin_ones & flat & turned) >= SHEETS)


def _axes(points: F64) -> tuple[F64, F64]:
    """Eigenvalues (s, 3), ascending, and axes (s, 3, 3), of points (s, k, 3)."""
    x = points - points.mean(axis=1, keepdims=True)
    values, axes = np.linalg.eigh(np.einsum("ski,skj->sij", x, x) / x.shape[1])
    return values, axes


def has_uneven_spacing(r: F64, near: I64, distance: F64, around: I64) -> bool:
    """Whether the spacing of points (n, 3) on surfaces differs from place to place: strays have
    another spacing, places do not.

    near, distance : (s, k), neighbours of samples, nearest first · around : (s, m) samples next to
    each
    """
    if near.shape[1] < LOOK:
        return False
    values = _of_neighbourhoods(r, near)
    flat = values[:, 0] < FLAT * values[:, 1]
    if np.mean(flat) < FLAT:  # the noise is wider than the neighbourhoods
        flat[:] = True
    own = np.where(flat, distance[:, LOOK - 1], np.nan)[around[:, :PLACE]]
    own = own[np.isfinite(own).sum(axis=1) >= min(PLACE, own.shape[1]) // 2]
    low, high = np.quantile(np.nanquantile(own, USUAL, axis=1), (0.1, 0.9))
    return bool(high > UNEVEN * low)


def _of_neighbourhoods(r: F64, near: I64) -> F64:
    """Eigenvalues (s, 3) of the points next to samples (s, k)."""
    return _eigenvalues(r[near[:, :LOOK]], np.ones((len(near), LOOK), np.bool_))


def find_lines(r: F64, spacing_m: float) -> Lines:
    """Lines of points (n, 3) m near the origin; spacing_m : of near points where they are dense."""
    widest = WIDEST * float(np.linalg.norm(np.ptp(r, axis=0)))
    edge = spacing_m
    level = thin_to_voxels(r, edge)
    while len(level.first) > MOST_VOXELS:
        edge *= STEP
        level = thin_to_voxels(r, edge)
    levels, states = [], []
    # a place at the widest reach must stay one beyond it
    while OVER * edge <= widest * STEP**STAYS:
        levels.append(level)
        states.append(_state(r, level)[level.voxel])
        edge *= STEP
        level = thin_to_voxels(r, edge)
    if not levels:
        return Lines(np.full(len(r), np.nan), (level,), np.zeros(len(r), np.bool_))
    reach = _first_surface(np.array(states), levels)
    known = reach <= widest * (1.0 + 1e-9)
    wide = np.array([level.edge_m for level in levels])[:, None] * OVER
    seen = (wide > reach) & (wide <= FARTHER * reach)
    band = (seen & (np.array(states) == ON_LINE)).any(axis=0)
    if known.any() and np.mean(band[known]) <= BANDS:
        known &= ~band
    reach = np.where(known, reach, np.nan)
    remote = reach > REMOTE * np.median(reach[known]) if known.any() else known
    return Lines(reach, tuple(levels), remote)


def _state(r: F64, level: ThinnedLevel) -> I64:
    """State (v,) of each voxel: its neighbourhood is empty, a line, or a surface."""
    points = r[level.first]
    distance, near = level.tree.query(
        points, k=min(ASKED, len(points)), distance_upper_bound=OVER * level.edge_m
    )
    distance = np.reshape(distance, (len(points), -1))
    near = np.reshape(near, (len(points), -1))
    found = np.isfinite(distance)
    count = found.sum(axis=1)
    values = _eigenvalues(points[np.where(found, near, 0)], found)
    line = values[:, 1] < LINE * values[:, 2]
    state = np.where(count < FEW, ALONE, np.where(line, ON_LINE, ON_SURFACE))
    return np.where((state == ON_SURFACE) & (count < FULL), ALONE, state)


def _eigenvalues(points: F64, found: np.typing.NDArray[np.bool_]) -> F64:
    """Eigenvalues (s, 3), ascending, of the covariance of points (s, k, 3) that were found."""
    weight = found / np.maximum(found.sum(axis=1, keepdims=True), 1)
    middle = np.einsum("sk,ski->si", weight, points)
    x = (points - middle[:, None]) * np.sqrt(weight)[:, :, None]
    return np.asarray(np.linalg.eigvalsh(np.einsum("ski,skj->sij", x, x)))


def _first_surface(states: I64, levels: list[ThinnedLevel]) -> F64:
    """Radius (n,) of the first level from which on a point's neighbourhood stays a surface."""
    out = np.full(states.shape[1], np.nan)
    for i in range(len(levels) - 1, -1, -1):
        later = states[i + 1 : i + STAYS]
        stays = (states[i] == ON_SURFACE) & ~(later == ON_LINE).any(axis=0)
        out[stays] = OVER * levels[i].edge_m
    return out
