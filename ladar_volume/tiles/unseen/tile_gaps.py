"""The gaps of one tile: :mod:`ladar_volume.volume.field_checks.gaps` by tiles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ladar_volume.ground.polynomial import base_height
from ladar_volume.math.own_axes import extent_of
from ladar_volume.model.records import F64, I64, Bool, Gap, Plane
from ladar_volume.tiles.array_file import read, write
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_outline import TileParts, parts_of
from ladar_volume.tiles.tile_patch import inside_of
from ladar_volume.tiles.tile_store import Tile, TileIndex
from ladar_volume.tiles.tile_surface import TileSurface, surface_of, used_of
from ladar_volume.tiles.unseen.tile_spacing import Rasters
from ladar_volume.tin.boundary import part_numbers
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.relevant import longest_sides
from ladar_volume.volume.field_checks.gap_kriging import REACH, SPACINGS, ObservedPoints, diameter
from ladar_volume.volume.field_checks.gaps import (
    GAP,
    corners_above,
    gap_at,
    gap_places,
    spanning,
)
from ladar_volume.volume.field_checks.unseen_surface import APART, AWAY, FILLED, UnseenVolume

#: Points around one gap, at most: of a wider one nothing is told.
MOST_AROUND = 2_000_000


@dataclass(frozen=True)
class Spanned:
    """outline : where the triangles inside are at rest, None for all · usual_m : length of a
    triangle's longest edge · rasters : that tell spacings, None for too few points · folder : where
    the numbers of the parts are to be at rest
    """

    outline: Path | None
    usual_m: float
    rasters: Rasters | None
    folder: Path


class WideParts(NamedTuple):
    """Parts of triangles too wide for the spacing. parts : with their areas, m² · triangles : (p,)
    how many each has · square : (p,) m², sums of the squares of what is usual there
    """

    parts: TileParts
    triangles: I64
    square: F64


def longest_edges(of: TiledCloud, tile: Tile, outline: Path | None) -> F64:
    """The longest edges (m,) m of the triangles that count in a tile within the outline."""
    surface = surface_of(of.index, of.limits, tile)
    inside = inside_of(surface, tile, outline) & surface.counted
    return longest_sides(surface.tin.vertices, surface.tin.triangles, np.flatnonzero(inside))


def wide_parts(of: TiledCloud, tile: Tile, asked: Spanned) -> WideParts:
    """The parts of a tile's triangles that are too wide, their numbers at rest."""
    surface = surface_of(of.index, of.limits, tile)
    wide, here = wide_triangles(surface, inside_of(surface, tile, asked.outline), asked)
    label = np.asarray(part_numbers(surface.tin.neighbours, wide), np.int64)
    own, n = np.flatnonzero(wide & surface.counted), label.max(initial=-1) + 1
    area = footprint_areas(surface.tin.vertices, surface.tin.triangles[own])
    total, square = (
        np.bincount(label[own], w, n).astype(np.float64) for w in (area, here[own] ** 2)
    )
    if n:
        write(asked.folder, "wide", tile, label)
    count = np.bincount(label[own], minlength=n).astype(np.int64)
    return WideParts(parts_of(surface, label, total), count, square)


def wide_triangles(surface: TileSurface, inside: Bool, asked: Spanned) -> tuple[Bool, F64]:
    """Triangles (m,) of a tile inside the outline that are too wide, and what is usual (m,) m."""
    tin, usual = surface.tin, asked.usual_m
    rows = np.flatnonzero(inside)
    longest = longest_sides(tin.vertices, tin.triangles, rows)
    could = longest > GAP * usual
    rows, longest = rows[could], longest[could]
    near = None
    if asked.rasters is not None and len(rows):
        used, place = np.unique(tin.triangles[rows], return_inverse=True)
        xy = np.ascontiguousarray(tin.vertices[used, :2])
        near = asked.rasters.spacings(asked.rasters.axes.along(xy))[place.reshape(-1, 3)]
    over, here = spanning(longest, usual, near)
    wide, at = np.zeros(len(inside), np.bool_), np.zeros(len(inside))
    wide[rows[over]], at[rows[over]] = True, here[over]
    return wide, at


def gap_corners(of: TiledCloud, tile: Tile, folder: Path, gap: I64, base: Plane) -> tuple[I64, F64]:
    """Gaps (t,) of the triangles of a tile that span some, and their corners (t, 3, 3) m, heights
    above the base. gap : (p,) the gap of each part of the tile, -1 for those not asked for
    """
    if not (gap >= 0).any():
        return np.zeros(0, np.int64), np.zeros((0, 3, 3))
    surface = surface_of(of.index, of.limits, tile)
    number = np.append(gap, -1)[read(folder, "wide", tile)]
    rows = np.flatnonzero((number >= 0) & surface.counted)
    return number[rows], corners_above(surface.tin, base, rows)


@dataclass(frozen=True)
class GapTask:
    """corners : (t, 3, 3) m of the triangles that span a gap, heights above the base · sigma_m : of
    the heights · usual_m : length of a triangle's longest edge
    """

    corners: F64
    base: Plane
    sigma_m: float
    usual_m: float


class Stretch(NamedTuple):
    """A rectangle along a gap. origin : (2,) m, its middle · axes : (2, 2), along it and across ·
    half : (2,) m
    """

    origin: F64
    axes: F64
    half: F64

    @classmethod
    def of(cls, xy: F64) -> Stretch:
        """The rectangle of places (k, 2) m along their own axes."""
        axes = np.linalg.eigh(np.cov(xy.T))[1].T[::-1]
        low, high = extent_of(np.ascontiguousarray(xy @ axes.T))
        return cls(0.5 * (low + high) @ axes, axes, 0.5 * (high - low))

    def holds(self, xy: F64, margin_m: F64 | float) -> Bool:
        """Which of places (n, 2) m lie in it, or within a margin of it."""
        off = np.abs((xy - self.origin) @ self.axes.T)
        out: Bool = (off <= self.half + np.reshape(margin_m, (-1, 1))).all(axis=1)
        return out


def tiles_near(index: TileIndex, stretch: Stretch, margin_m: float) -> list[Tile]:
    """The tiles with points in a rectangle, or nearly, by name."""
    tiles = sorted(index.box)
    box = np.array([index.box[t] for t in tiles])
    far = 0.5 * np.hypot(*(box[:, 2:] - box[:, :2]).T)
    near = stretch.holds(0.5 * (box[:, :2] + box[:, 2:]), margin_m + far)
    return [tiles[k] for k in np.flatnonzero(near).tolist()]


def gap_surface(
    of: TiledCloud, task: tuple[int, GapTask]
) -> tuple[int, tuple[Gap, UnseenVolume | None]]:
    """The number of a gap, the gap, and its surface from the points around it; None where there are
    too many of these.
    """
    number, at = task
    places = gap_places(at.corners, np.ones(len(at.corners)))
    return number, gap_at(at.corners, places, seen_around(of, at, places[0], places[1]))


def points_in(of: TiledCloud, stretch: Stretch, margin_m: float) -> F64 | None:
    """The points (n, 3) m in a rectangle, or a margin around it; None where they are too many."""
    found, count = [np.zeros((0, 3))], 0
    for tile in tiles_near(of.index, stretch, margin_m):
        xyz = used_of(of.index, of.limits, tile)[0]
        found.append(xyz[stretch.holds(xyz[:, :2], margin_m)])
        count += len(found[-1])
        if count > MOST_AROUND:
            return None
    return np.concatenate(found)


def seen_around(of: TiledCloud, at: GapTask, xy: F64, weight: F64) -> ObservedPoints | None:
    """All points that the surface of a gap of places (k, 2) m with areas (k,) m² may be told from;
    None where these are too many.
    """
    size = diameter(float(weight.sum()))
    least = AWAY * size + max(REACH * size, SPACINGS * at.usual_m) + FILLED * at.usual_m
    stretch, margin = Stretch.of(at.corners[:, :, :2].reshape(-1, 2)), 1.01 * least
    while True:
        r = points_in(of, stretch, margin)
        if r is None:
            return None
        r[:, 2] -= base_height(at.base, r[:, :2])
        # the mean of several points has less, as in one process: too much by next to nothing
        seen = ObservedPoints.of(r, np.full(len(r), at.sigma_m**2), at.usual_m)
        apart = float(np.max(seen.tree.query(xy)[0]))
        if apart <= margin and 1.01 * (least + APART * apart) <= margin:
            return seen
        margin = 1.01 * (least + APART * apart) if apart <= margin else 2.0 * margin
