"""The triangles round the points of one tile, as they are in the Delaunay triangulation of all.

A triangle of some of the points is one of the whole where no other point lies within its
circumcircle or on it, and a hull edge where none lies beyond: this is asked of every tile that the
circle or the half plane reaches. Points that speak against a triangle are added, one for each
triangle and tile at a time, and inserted into the triangulation, until none is left. Points that
share a circle are all added, and the diagonals among them follow from the points alone
(``triangle_table.tie_flip``): the result is that of the whole triangulation, whatever the tiles.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import Protocol

import numpy as np

from ladar_volume.math.kernels import kernel, leaf_kernel
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tiles.tile_places import off_hull
from ladar_volume.tiles.tile_store import CloudParts, Tile
from ladar_volume.tin.delaunay import GrowingTriangulation
from ladar_volume.tin.full_tin import any_corner, first_corners, tin_of
from ladar_volume.tin.predicates import incircle, orientation, workspace

#: First halo, in mean distances of the tile's points.
HALO = 6.0
#: Triangles flatter than this (twice the area over the longest edge squared) have a circle that
#: rounding moves: it is computed with whole fractions.
FLAT = 1e-8
#: Relative margin of the other circles.
MARGIN = 1e-6

#: Places of other tiles kept in memory, of those last read.
KEPT = 200_000

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class TileStars:
    """tin : over the tile's footprints and others around it, at the mean height of the points
    there · shared : (n,) how many points · own : (n,) which vertices lie in the tile · star : (m,)
    triangles that meet one of them, all of them final · counted : (m,) of these, those whose first
    vertex (by x, then y) lies in the tile: each triangle of the whole is counted in one tile ·
    rounds : how often its triangles were looked at
    """

    tin: Tin
    shared: F64
    own: Bool
    star: Bool
    counted: Bool
    rounds: int


@kernel
def circle_intruders(corners: F64, reach: F64, points: F64, known: Bool, w: F64) -> I64:
    """For each triangle, corners (m, 3, 2) counter-clockwise, the point (k, 4), ascending by x,
    that lies deepest in its circumcircle or on it, known ones (k,) left aside: (m,), -1 for none.
    reach : (m, 4) the box of each circle, NaN where that is not known
    """
    xy, out = np.empty((4, 2)), np.full(len(corners), -1, np.int64)
    for t in range(len(corners)):
        xy[:3] = corners[t]
        most, first = -1.0, 0
        x0, y0, x1, y1 = reach[t, 0], reach[t, 1], reach[t, 2], reach[t, 3]
        if x0 == x0:
            first = np.searchsorted(points[:, 0], x0)
        for p in range(first, len(points)):
            if points[p, 0] > x1:
                break
            if known[p] or points[p, 1] < y0 or points[p, 1] > y1:
                continue
            xy[3, 0], xy[3, 1] = points[p, 0], points[p, 1]
            depth = incircle(xy, 0, 1, 2, 3, w)
            if depth >= 0.0 and depth > most:
                most, out[t] = depth, p
    return out


@kernel
def hull_intruders(ends: F64, points: F64, known: Bool, w: F64) -> I64:
    """For each hull edge, ends (m, 2, 2) with the surface to the left, the point (k, 4) beyond it
    that sees it under the widest angle, known ones (k,) left aside: (m,), -1 for none.
    """
    out = np.full(len(ends), -1, np.int64)
    for e in range(len(ends)):
        ax, ay, bx, by = ends[e, 0, 0], ends[e, 0, 1], ends[e, 1, 0], ends[e, 1, 1]
        least = np.inf
        for p in range(len(points)):
            x, y = points[p, 0], points[p, 1]
            if known[p] or orientation(ax, ay, bx, by, x, y, w) >= 0.0:
                continue
            across = abs((ax - x) * (by - y) - (ay - y) * (bx - x))
            cot = ((ax - x) * (bx - x) + (ay - y) * (by - y)) / max(across, 1e-300)
            if cot < least or out[e] < 0:
                least, out[e] = cot, p
    return out


@dataclass(frozen=True)
class OpenSides:
    """What may still change: corners (m, 3, 2) of triangles, reach (m, 4) the box of each circle or
    none (NaN) where rounding moves it · ends (e, 2, 2) of hull edges.
    """

    corners: F64
    reach: F64
    ends: F64


@leaf_kernel
def circle_box(corners: F64, out: F64) -> None:
    """The box (4,) m that holds the circumcircle of a triangle (3, 2); NaN for a flat one."""
    ax, ay = corners[0, 0], corners[0, 1]
    ux, uy, vx, vy = (
        corners[1, 0] - ax,
        corners[1, 1] - ay,
        corners[2, 0] - ax,
        corners[2, 1] - ay,
    )
    twice = ux * vy - uy * vx
    uu, vv = ux * ux + uy * uy, vx * vx + vy * vy
    ww = (ux - vx) ** 2 + (uy - vy) ** 2
    if not twice > FLAT * max(max(uu, vv), ww):
        out[:] = np.nan
        return
    x, y = 0.5 * (vy * uu - uy * vv) / twice, 0.5 * (ux * vv - vx * uu) / twice
    size = 0.0
    for k in range(3):
        size = max(size, max(abs(corners[k, 0]), abs(corners[k, 1])))
    r = np.sqrt(x * x + y * y) * (1.0 + MARGIN) + 1e-12 * size
    out[0], out[1], out[2], out[3] = ax + x - r, ay + y - r, ax + x + r, ay + y + r


@kernel
def circle_boxes(corners: F64) -> F64:
    """Boxes (m, 4) m that hold the circumcircles of triangles (m, 3, 2); NaN for flat ones."""
    out = np.empty((len(corners), 4))
    for t in range(len(corners)):
        circle_box(corners[t], out[t])
    return out


@kernel
def open_kernel(
    xy: F64, corners: tuple[I32, I32], star: Bool, own: Bool, safe: Box
) -> tuple[F64, F64, F64]:
    """See :func:`open_sides`, hull edges without regard to the hull of all. corners : triangles and
    neighbours (m, 3) over xy (n, 2)
    """
    triangles, neighbours = corners
    x0, y0, x1, y1 = safe
    m = len(triangles)
    rows, edges = np.empty(m, np.int32), np.empty((m + 2, 2), np.int32)
    at, box, r, e = np.empty((3, 2)), np.empty(4), 0, 0
    for t in range(m):
        if not star[t]:
            continue
        for k in range(3):
            at[k, 0], at[k, 1] = xy[triangles[t, k], 0], xy[triangles[t, k], 1]
            a, b = triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]
            if neighbours[t, k] < 0 and (own[a] or own[b]):
                edges[e, 0], edges[e, 1] = a, b
                e += 1
        circle_box(at, box)
        if not (box[0] > x0 and box[1] > y0 and box[2] < x1 and box[3] < y1):
            rows[r] = t
            r += 1
    found, reach, ends = np.empty((r, 3, 2)), np.empty((r, 4)), np.empty((e, 2, 2))
    for i in range(r):
        for k in range(3):
            found[i, k, 0], found[i, k, 1] = (
                xy[triangles[rows[i], k], 0],
                xy[triangles[rows[i], k], 1],
            )
        circle_box(found[i], reach[i])
    for i in range(e):
        for k in range(2):
            ends[i, k, 0], ends[i, k, 1] = xy[edges[i, k], 0], xy[edges[i, k], 1]
    return found, reach, ends


def meets(corners: F64, box: Box) -> bool:
    """Whether the circumcircle of a triangle (3, 2) reaches a box, without rounding."""
    (ax, ay), (bx, by), (cx, cy) = ([Fraction(v) for v in p] for p in corners.tolist())
    ux, uy, vx, vy = bx - ax, by - ay, cx - ax, cy - ay
    d, uu, vv = 2 * (ux * vy - uy * vx), ux * ux + uy * uy, vx * vx + vy * vy
    x, y = (vy * uu - uy * vv) / d, (ux * vv - vx * uu) / d
    square = x * x + y * y
    x, y = ax + x, ay + y
    x0, y0, x1, y1 = (Fraction(v) for v in box)
    dx, dy = max(x0 - x, x - x1, Fraction(0)), max(y0 - y, y - y1, Fraction(0))
    return dx * dx + dy * dy <= square


def open_sides(tin: Tin, star: Bool, own: Bool, safe: Box, whole: F64) -> OpenSides:
    """The triangles of the stars whose circles leave the box ``safe``, all points of which are in
    the triangulation, and the hull edges at the tile's own vertices (n,) that the hull of all
    points, whose corners are ``whole`` (h, 2), reaches beyond.
    """
    corners = tin.triangles, tin.neighbours
    found, reach, ends = open_kernel(tin.vertices, corners, star, own, safe)
    return OpenSides(found, reach, ends[off_hull(ends, whole)])


def intruders(sides: OpenSides, box: Box, points: F64, known: Bool) -> I64:
    """Rows of points (k, 4) of a tile, whose box is given, that speak against the open sides."""
    x0, y0, x1, y1 = box
    r, w = sides.reach, workspace()
    near = (r[:, 0] <= x1) & (r[:, 1] <= y1) & (r[:, 2] >= x0) & (r[:, 3] >= y0)
    flat = np.flatnonzero(np.isnan(r[:, 0]))
    near[flat] = [meets(sides.corners[t], box) for t in flat.tolist()]
    found = []
    if near.any():
        some = rows_reached(points, r[near])
        deep = circle_intruders(sides.corners[near], r[near], points[some], known[some], w)
        found.append(some[deep[deep >= 0]])
    if len(sides.ends):
        beyond = hull_intruders(sides.ends, points, known, w)
        found.append(beyond[beyond >= 0])
    return np.unique(np.concatenate([np.zeros(0, np.int64), *found]))


@kernel
def rows_reached(points: F64, reach: F64) -> I64:
    """The rows (s,) of points (k, 4) in the box around all boxes (m, 4), of which those that are
    not known (NaN) are everywhere.
    """
    x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
    for t in range(len(reach)):
        if reach[t, 0] != reach[t, 0]:
            return np.arange(len(points))
        x0, y0 = min(x0, reach[t, 0]), min(y0, reach[t, 1])
        x1, y1 = max(x1, reach[t, 2]), max(y1, reach[t, 3])
    out, k = np.empty(len(points), np.int64), 0
    for p in range(len(points)):
        if x0 <= points[p, 0] <= x1 and y0 <= points[p, 1] <= y1:
            out[k] = p
            k += 1
    return out[:k].copy()


def reached(sides: OpenSides, boxes: F64) -> Bool:
    """Which of boxes (t, 4) anything that is open reaches."""
    x0, y0, x1, y1 = boxes.T
    r = sides.reach
    known = r[~np.isnan(r[:, 0])]
    out = np.zeros(len(boxes), np.bool_)
    if len(known):
        (a, b), (c, d) = known[:, :2].min(axis=0), known[:, 2:].max(axis=0)
        some = np.flatnonzero((a <= x1) & (b <= y1) & (c >= x0) & (d >= y0))
        left, low, right, high = boxes[some].T[..., None]
        meet = (known[:, 0] <= right) & (known[:, 1] <= high)
        out[some] = (meet & (known[:, 2] >= left) & (known[:, 3] >= low)).any(axis=1)
    corners = np.stack([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]).transpose(2, 0, 1)
    for a, b in sides.ends:
        along, at = b - a, corners - a
        margin = 1e-9 * np.abs(along).max() * (np.abs(corners).max() + np.abs(a).max())
        out |= (along[0] * at[..., 1] - along[1] * at[..., 0] <= margin).any(axis=1)
    flat = sides.corners[np.isnan(r[:, 0])]
    for k in np.flatnonzero(~out).tolist() if len(flat) else []:
        box = tuple(boxes[k].tolist())
        out[k] = any(meets(one, box) for one in flat)
    return out


class TilePoints(Protocol):
    """Points in tiles: the side of these, by tile the box of its points, the corners (h, 2) of the
    hull of all, and the footprints of a tile as :func:`~ladar_volume.tin.duplicates.places`.
    """

    @property
    def cloud(self) -> CloudParts: ...
    @property
    def box(self) -> Mapping[Tile, Box]: ...
    @property
    def hull(self) -> F64: ...
    def places(self, tile: Tile) -> F64: ...


class Neighbourhood:
    """Points of other tiles that were added to one: all within a halo, and some beyond."""

    def __init__(self, index: TilePoints, tile: Tile, own: int) -> None:
        self.index, self.tile, self.side = index, tile, index.cloud.tile_m
        self.halo = min(self.side, HALO * self.side / max(own, 1) ** 0.5)
        self.others = sorted(t for t in index.box if t != tile)
        self.boxes = np.array([index.box[t] for t in self.others]).reshape(-1, 4)
        self.rows: dict[Tile, Bool] = {}
        self.taken: list[F64] = []
        self.read: dict[Tile, F64] = {}

    def places(self, tile: Tile) -> F64:
        """The places of a tile; a few of those last read are kept."""
        if tile not in self.read:
            while sum(map(len, self.read.values())) > KEPT:
                self.read.pop(next(iter(self.read)))
            self.read[tile] = self.index.places(tile)
        return self.read[tile]

    @property
    def safe_box(self) -> Box:
        """The box all of whose points are taken."""
        (i, j), s, h = self.tile, self.side, self.halo
        return (i * s - h, j * s - h, (i + 1) * s + h, (j + 1) * s + h)

    def take(self, tile: Tile, choose: Callable[[F64, Bool], I64]) -> int:
        """Add the points of a tile that ``choose`` names by their rows, of all its points and
        whether they are known; returns how many.
        """
        points = self.places(tile)
        known = self.rows.setdefault(tile, np.zeros(len(points), bool))
        rows = choose(points, known)
        rows = rows[~known[rows]]
        if len(rows):
            known[rows] = True
            self.taken.append(points[rows])
        return len(rows)

    def take_halo(self) -> None:
        """Add the points of the tiles around that lie in the halo."""
        x0, y0, x1, y1 = self.safe_box

        def inside(points: F64, known: Bool) -> I64:
            x, y = points[:, 0], points[:, 1]
            return np.flatnonzero((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1))

        for i in range(self.tile[0] - 1, self.tile[0] + 2):
            for j in range(self.tile[1] - 1, self.tile[1] + 2):
                box = self.index.box.get((i, j))
                if (i, j) == self.tile or box is None:
                    continue
                if box[0] <= x1 and box[2] >= x0 and box[1] <= y1 and box[3] >= y0:
                    self.take((i, j), inside)

    def take_against(self, sides: OpenSides) -> int:
        """Add the points of all tiles that speak against the open sides; returns how many."""
        added = 0
        for k in np.flatnonzero(reached(sides, self.boxes)).tolist():
            tile = self.others[k]
            added += self.take(tile, partial(intruders, sides, self.index.box[tile]))
        return added

    def take_nearest(self) -> int:
        """Add the points of the nearest tile that has some left; returns how many."""
        i, j = self.tile
        for tile in sorted(self.others, key=lambda t: ((t[0] - i) ** 2 + (t[1] - j) ** 2, t)):
            if added := self.take(tile, lambda p, known: np.flatnonzero(~known)):
                return added
        return 0


def begun(own: F64, around: Neighbourhood) -> GrowingTriangulation:
    """The points of a tile (k, 3) and those taken, triangulated; where all lie on one line, or are
    too few, more are taken. Raises :class:`SurfaceError` where there are none.
    """
    while True:
        try:
            return GrowingTriangulation(np.concatenate([own, *around.taken])[:, :2])
        except SurfaceError:
            if around.take_nearest() == 0:
                raise


def tile_stars(index: TilePoints, tile: Tile) -> TileStars:
    """The final triangles round the points of a tile. Raises :class:`SurfaceError` where the whole
    cloud has fewer than three points off one line.
    """
    own = index.places(tile)
    around = Neighbourhood(index, tile, len(own))
    around.take_halo()
    grown, rounds = begun(own, around), 0
    while True:
        rounds += 1
        known = np.concatenate([own, *around.taken])
        tin = tin_of(np.ascontiguousarray(known[:, :3]), grown.triangulation())
        mine = tin.source < len(own)
        star: Bool = np.asarray(any_corner(tin.triangles, mine))
        before = len(around.taken)
        if around.take_against(open_sides(tin, star, mine, around.safe_box, index.hull)) == 0:
            break
        if around.halo < around.side:
            around.halo = min(2.0 * around.halo, around.side)
            around.take_halo()
        grown.add(np.concatenate(around.taken[before:])[:, :2])
    first = first_corners(tin.vertices, tin.triangles)
    return TileStars(tin, known[tin.source, 3], mine, star, mine[first], rounds)
