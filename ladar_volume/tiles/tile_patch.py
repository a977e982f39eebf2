"""The surface around a tile: its triangles at rest with those of the tiles beside, so that all
triangles are known so many edges away from its own vertices.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ladar_volume.math.equal_rows import first_equal
from ladar_volume.math.kernels import kernel
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tiles.array_file import read, write
from ladar_volume.tiles.joined_triangles import distinct_triangles
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_outline import Box
from ladar_volume.tiles.tile_stars import TilePoints
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import TileSurface, surface_of, surface_path
from ladar_volume.tin.full_tin import across_sides, any_corner, corners_of, places_in
from ladar_volume.volume.neighbourhood import grow_kernel

C128 = npt.NDArray[np.complex128]
#: First width around the tile for each edge, in mean distances of its points.
WIDTH = 2.0


@dataclass(frozen=True)
class TilePatch:
    """tin : the triangles, without ``source`` · shared : (n,) points at each vertex · own : (k,)
    the tile's own vertices, in the order in which its surface has them · counted, inside, relevant
    : (m,) triangles that belong to the tile, those within the outline, and those that count
    """

    tin: Tin
    shared: F64
    own: I64
    counted: Bool
    inside: Bool
    relevant: Bool


@dataclass(frozen=True)
class SurfacePart:
    """Triangles (m, 3) of one tile over vertices (n, 3) m, points at each, round which of them all
    triangles are here (n,), and which triangles count in it, lie within the outline, and count at
    all (m,).
    """

    vertices: F64
    triangles: I32
    shared: F64
    complete: Bool
    counted: Bool
    inside: Bool
    relevant: Bool


def inside_of(surface: TileSurface, tile: Tile, folder: Path | None) -> Bool:
    """The triangles (m,) of a tile that lie inside the outline."""
    return surface.tin.relevant if folder is None else read(folder, "inside", tile)


def patch_of(
    of: TiledCloud, tile: Tile, surface: TileSurface, folder: Path | None, edges: int
) -> TilePatch:
    """The surface around a tile in which all triangles are known so many edges away from its own
    vertices. folder : of the triangles inside the outline, as in :func:`inside_of`
    """
    side, own = of.index.cloud.tile_m, int(np.count_nonzero(surface.own))
    width = min(side, WIDTH * edges * side / max(own, 1) ** 0.5)
    i, j = tile
    box = (i * side - width, j * side - width, (i + 1) * side + width, (j + 1) * side + width)
    parts = [whole_part(surface, inside_of(surface, tile, folder))]
    parts += parts_beside(of, tile, box, folder)
    while True:
        found = joined(parts)
        marked = np.zeros(len(found.complete), np.bool_)
        marked[found.own] = True
        grow_kernel(found.triangles, marked, edges)
        missing = found.vertices[marked & ~found.complete, :2]
        if not len(missing):
            return found.patch(parts)
        # long triangles on the hull lead far out of the box: fetch what meets their corners
        parts += parts_at(of, missing, folder, edges)


def whole_part(surface: TileSurface, inside: Bool) -> SurfacePart:
    """All that a tile has at rest."""
    t = surface.tin
    return SurfacePart(
        t.vertices, t.triangles, surface.shared, surface.own, surface.counted, inside, t.relevant
    )


def in_box(xy: F64, box: Box) -> Bool:
    """Which of places (n, 2) lie in a box."""
    x0, y0, x1, y1 = box
    x, y = xy[:, 0], xy[:, 1]
    return np.asarray((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1))


def parts_beside(
    of: TiledCloud, tile: Tile, box: Box, folder: Path | None
) -> Iterator[SurfacePart]:
    """What other tiles have round their own vertices in a box."""
    for other in tiles_in(of.index, box):
        if other == tile:
            continue
        s = surface_of(of.index, of.limits, other)
        marked = s.own & in_box(s.tin.vertices, box)
        if marked.any():
            yield part_round(s, inside_of(s, other, folder), marked)


def parts_at(of: TiledCloud, xy: F64, folder: Path | None, edges: int) -> Iterator[SurfacePart]:
    """What the tiles that places (n, 2) m lie in have round the vertices there, and round their own
    up to a third of so many edges away: these are asked for next. Raises :class:`InputError` where
    a tile at rest has none.
    """
    cells = np.floor(xy / of.index.cloud.tile_m).astype(np.int64)
    for i, j in np.unique(cells, axis=0).tolist():
        s = surface_of(of.index, of.limits, (i, j))
        own = np.flatnonzero(s.own)
        at = rows_at(s.tin.vertices[own], xy[(cells == (i, j)).all(axis=1)])
        if (at < 0).any():
            path = surface_path(of.index, (i, j))
            words = f"{path}: not the surface of its tile: delete it and run again"
            raise InputError(words, reason="input_unreadable", value=str(path))
        marked = np.zeros(len(s.own), np.bool_)
        marked[own[at]] = True
        grow_kernel(s.tin.triangles, marked, edges // 3)
        marked &= s.own
        yield part_round(s, inside_of(s, (i, j), folder), marked)


def part_round(s: TileSurface, inside: Bool, marked: Bool) -> SurfacePart:
    """What a tile beside has round marked vertices (n,) of its own. inside : (m,) its triangles
    within the outline
    """
    some = any_corner(s.tin.triangles, marked)
    corners = corners_of(s.tin.triangles[some], len(s.own))
    triangles = places_in(corners, len(s.own))[s.tin.triangles[some]]
    none = np.zeros(len(triangles), np.bool_)
    return SurfacePart(
        s.tin.vertices[corners],
        triangles,
        s.shared[corners],
        marked[corners],
        none,
        inside[some],
        s.tin.relevant[some],
    )


def tiles_in(index: TilePoints, box: Box) -> list[Tile]:
    """The tiles with points in a box, or nearly, by name."""
    x0, y0, x1, y1 = box
    i0, j0, i1, j1 = (int(v // index.cloud.tile_m) for v in box)
    if (i1 - i0 + 3) * (j1 - j0 + 3) < len(index.box):
        names = [(i, j) for i in range(i0 - 1, i1 + 2) for j in range(j0 - 1, j1 + 2)]
        near = [(name, index.box[name]) for name in names if name in index.box]
    else:
        near = sorted(index.box.items())
    return [t for t, b in near if b[0] <= x1 and b[2] >= x0 and b[1] <= y1 and b[3] >= y0]


@dataclass(frozen=True)
class JoinedParts:
    """Triangles (m, 3) of parts over their vertices (n, 3) m, each once. first : (n,) rows of the
    vertices among those of all parts, one after the other · some : (m,) those of the triangles ·
    own : (k,) the vertices of the first part round which it knows all triangles · complete : (n,)
    round which vertices any part does
    """

    vertices: F64
    triangles: I32
    first: I64
    some: I64
    own: I64
    complete: Bool

    def patch(self, parts: Sequence[SurfacePart]) -> TilePatch:
        """The surface of these parts."""
        n = len(self.vertices)
        counted, inside, relevant = (
            np.concatenate([getattr(p, name) for p in parts])[self.some]
            for name in ("counted", "inside", "relevant")
        )
        shared = np.concatenate([p.shared for p in parts])[self.first]
        across = across_sides(self.triangles, n)
        tin = Tin(self.vertices, self.triangles, across, inside, np.full(n, -1))
        return TilePatch(tin, shared, self.own, counted, inside, relevant)


def joined(parts: Sequence[SurfacePart]) -> JoinedParts:
    """The triangles of parts, the first of which is that of the tile."""
    xyz = np.concatenate([p.vertices for p in parts])
    same = first_equal(xyz[:, :2])
    first = np.flatnonzero(same == np.arange(len(same)))
    place = places_in(first, len(same))[same]
    start = np.r_[0, np.cumsum([len(p.vertices) for p in parts])].tolist()
    corners = np.concatenate(
        [place[at + p.triangles] for at, p in zip(start[:-1], parts, strict=True)]
    )
    some, triangles = distinct_triangles(corners, len(first))
    own = place[: start[1]][parts[0].complete].astype(np.int64)
    complete = np.zeros(len(first), np.bool_)
    complete[place[np.concatenate([p.complete for p in parts])]] = True
    return JoinedParts(xyz[first], triangles, first, some, own, complete)


def names_of(xy: F64) -> C128:
    """Places (n, 2) m as one number each."""
    return np.ascontiguousarray(xy[:, :2]).view(np.complex128).reshape(-1)


def rows_at(xy: F64, wanted: F64) -> I64:
    """The rows (m,) of distinct places xy (n, 2) at which places (m, 2) are, -1 for none."""
    if not len(xy):
        return np.full(len(wanted), -1)
    names, asked = names_of(xy), names_of(wanted)
    if ascending(xy):  # as the vertices of one tile are
        at = np.minimum(np.searchsorted(names, asked), len(names) - 1)
    else:
        order = np.argsort(names, kind="stable")
        at = order[np.minimum(np.searchsorted(names[order], asked), len(order) - 1)]
    return np.where(names[at] == asked, at, -1)


@kernel
def ascending(xy: F64) -> bool:
    """Whether places (n, 2) come by x, then y."""
    for i in range(1, len(xy)):
        if not (xy[i - 1, 0] < xy[i, 0] or (xy[i - 1, 0] == xy[i, 0] and xy[i - 1, 1] <= xy[i, 1])):
            return False
    return True


def write_shares(
    of: TiledCloud, tile: Tile, folder: Path, own: F64, shares: tuple[F64, F64]
) -> tuple[Tile, ...]:
    """Write what a tile gives to heights at places (n, 2) m, values (n,): to the tile's own
    vertices (k, 2), and to others. Returns the tiles of these.
    """
    xy, values = shares
    at = rows_at(own, xy)
    write(folder, "own", tile, np.bincount(at[at >= 0], values[at >= 0], len(own)))
    far = (at < 0) & (values != 0.0)
    write(folder, "beside", tile, np.column_stack([xy[far], values[far]]))
    tiles = np.unique(np.floor(xy[far] / of.index.cloud.tile_m).astype(np.int64), axis=0)
    return tuple((int(i), int(j)) for i, j in tiles)


def read_shares(tile: Tile, folder: Path, xy: F64, wrote: bool, beside: Sequence[Tile]) -> F64:
    """What is given to the heights of a tile's own vertices (k, 2) m, (k,): by itself, where it
    ``wrote`` something, and by the tiles ``beside``.
    """
    out = read(folder, "own", tile) if wrote else np.zeros(len(xy))
    for other in beside:
        values = read(folder, "beside", other)
        at = rows_at(xy, values[:, :2])
        out += np.bincount(at[at >= 0], values[at >= 0, 2], len(xy))
    return out
