"""What a fit of the ground asks of the vertices of one tile: sums, order statistics, some rows."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ladar_volume.ground.polynomial import (
    base_height,
    design,
    design_surface,
)
from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.tiles.array_file import read
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import used_of

#: Digits of a number that a bin of the sizes of residuals leaves out, of 52 binary ones.
COARSE_BITS = 40
#: Values are counted in a table of all bins from the least to the greatest, where these are at most
#: so many for each value.
MANY = 20


@dataclass(frozen=True)
class VertexSelection:
    """Vertices that a ground is fitted to: of those that count, or of a ring of them at rest in the
    folder ``ring``, the ones within ``limit_m`` of a surface, or those with given rows (k,) of the
    file, ascending.
    """

    origin_xy: tuple[float, float]
    beta: tuple[float, ...]
    limit_m: float
    ring: Path | None = None
    rows: I64 | None = field(default=None, compare=False)

    def mask(self, xyz: F64, row: I64) -> Bool:
        """Which of the vertices (k, 3) m with rows (k,) these are."""
        if self.rows is not None:
            return np.asarray(np.isin(row, self.rows, assume_unique=True))
        if self.limit_m == math.inf:
            return np.ones(len(xyz), np.bool_)
        surface = design_surface(self.beta, self.origin_xy)
        off = np.abs(xyz[:, 2] - base_height(surface, xyz[:, :2]))
        return np.asarray(off <= self.limit_m)


def vertices(of: TiledCloud, tile: Tile, ring: Path | None = None) -> tuple[F64, F64, I64]:
    """Of a tile's vertices that count, or of those in a ring: places (k, 3) m, points at each (k,),
    rows (k,).
    """
    xyz, shared, row = used_of(of.index, of.limits, tile)
    if ring is not None:
        some = read(ring.parent, ring.name, tile)
        xyz, shared, row = xyz[some], shared[some], row[some]
    return xyz, shared, row


def chosen_of(of: TiledCloud, tile: Tile, chosen: VertexSelection) -> tuple[F64, F64, I64]:
    """The same of the chosen ones."""
    xyz, shared, row = vertices(of, tile, chosen.ring)
    mask = chosen.mask(xyz, row)
    if mask.all():
        return xyz, shared, row
    return xyz[mask], shared[mask], row[mask]


def extent(of: TiledCloud, tile: Tile, ring: Path | None) -> tuple[int, float]:
    """How many vertices there are, and their greatest height up or down, m."""
    xyz, _, _ = vertices(of, tile, ring)
    return len(xyz), float(np.abs(xyz[:, 2]).max(initial=0.0))


def products(of: TiledCloud, tile: Tile, chosen: VertexSelection) -> tuple[int, F64, F64, bytes]:
    """Number of the chosen, ``XᵀX`` (p, p), ``Xᵀz`` (p,), and a digest of which they are."""
    xyz, _, row = vertices(of, tile, chosen.ring)
    mask = chosen.mask(xyz, row)
    X = design_of(chosen, xyz[mask])
    name = hashlib.blake2b(np.packbits(mask).tobytes(), digest_size=16).digest()
    return len(X), X.T @ X, X.T @ xyz[mask, 2], name


def design_of(chosen: VertexSelection, xyz: F64) -> F64:
    """Design rows (k, p) at places (k, 3) m."""
    degree = (1, 3, 6, 10).index(len(chosen.beta))
    return design(xyz[:, :2], np.array(chosen.origin_xy), degree)


def residuals(of: TiledCloud, tile: Tile, chosen: VertexSelection, beta: F64) -> F64:
    """Residuals (k,) m of the chosen."""
    xyz, _, _ = chosen_of(of, tile, chosen)
    out: F64 = xyz[:, 2] - design_of(chosen, xyz) @ beta
    return out


def bins_of(size: F64) -> I64:
    """Bins (k,) of sizes (k,), ascending with them."""
    return np.ascontiguousarray(size).view(np.int64) >> COARSE_BITS


def counted(bins: I64) -> tuple[I64, I64]:
    """The distinct ones of bins (n,), ascending, and how often each is there."""
    low = int(bins.min(initial=np.iinfo(np.int64).max))
    if len(bins) and int(bins.max()) - low < MANY * len(bins):  # sorting takes ten times as long
        count = np.bincount(bins - low)
        some = np.flatnonzero(count)
        return some + low, count[some]
    return np.unique(bins, return_counts=True)


def spread(of: TiledCloud, tile: Tile, chosen: VertexSelection, beta: F64) -> tuple[F64, I64, I64]:
    """Sum of squared residuals, m², number of those below 0 and sum of their squares, (3,); bins of
    their sizes, and how many there are in each.
    """
    r = residuals(of, tile, chosen, beta)
    below = r[r < 0.0]
    return np.array([r @ r, len(below), below @ below]), *counted(bins_of(np.abs(r)))


def sizes_in(
    of: TiledCloud, tile: Tile, chosen: VertexSelection, beta: F64, low: int, high: int
) -> F64:
    """Sizes (k,) m of the residuals in bins from ``low`` to ``high``."""
    size = np.abs(residuals(of, tile, chosen, beta))
    bins = bins_of(size)
    return size[(bins >= low) & (bins <= high)]


@kernel
def blocks_of(row: I64, begin: I64, size: int) -> I64:
    """The block (n,) that each of rows (n,) of the file lies in, -1 for none. begin : (k,) the
    first rows of blocks of so many rows, a power of two, ascending
    """
    out, shift = np.full(len(row), -1, np.int64), 0
    while size >> (shift + 1):
        shift += 1
    for i in range(len(row) if len(begin) else 0):
        low, high = 0, min(((row[i] - begin[0]) >> shift) + 1, len(begin))
        if high <= 0 or begin[high - 1] <= row[i]:
            low = high  # as where one block follows the other
        while low < high:
            middle = (low + high) // 2
            if begin[middle] <= row[i]:
                low = middle + 1
            else:
                high = middle
        if low > 0 and row[i] < begin[low - 1] + size:
            out[i] = low - 1
    return out


def count_in_blocks(
    of: TiledCloud, tile: Tile, chosen: VertexSelection, begin: I64, size: int
) -> I64:
    """How many of the chosen are in each block of rows (k,), as :func:`blocks_of` has them."""
    at = blocks_of(chosen_of(of, tile, chosen)[2], begin, size)
    return np.bincount(at[at >= 0], minlength=len(begin))


def rows_in_blocks(
    of: TiledCloud, tile: Tile, chosen: VertexSelection, begin: I64, size: int
) -> I64:
    """The rows (k,) of the chosen in some blocks."""
    row = chosen_of(of, tile, chosen)[2]
    return row[blocks_of(row, begin, size) >= 0]


def vertices_at(of: TiledCloud, tile: Tile, chosen: VertexSelection, rows: I64 | None) -> F64:
    """Row, x, y, z, points (k, 5) of the chosen with given rows, ascending; None for
    all.
    """
    xyz, shared, row = chosen_of(of, tile, chosen)
    some = slice(None) if rows is None else blocks_of(row, rows, 1) >= 0
    return np.column_stack([row, xyz, shared])[some]


def layers(of: TiledCloud, tile: Tile, chosen: VertexSelection, threshold_m: float) -> I64:
    """How many vertices lie within the threshold of the surface, and in the layers of the same
    thickness above and below, (3,).
    """
    xyz, _, _ = vertices(of, tile, chosen.ring)
    surface = design_surface(chosen.beta, chosen.origin_xy)
    r = xyz[:, 2] - base_height(surface, xyz[:, :2])
    above, below = ((s > threshold_m) & (s <= 3.0 * threshold_m) for s in (r, -r))
    return np.array([np.count_nonzero(m) for m in (np.abs(r) <= threshold_m, above, below)])


def moments(of: TiledCloud, tile: Tile, chosen: VertexSelection, about: F64) -> F64:
    """Sums (4, 4) of products of (1, x, y, z) of the chosen about a place (3,), m."""
    xyz, _, _ = chosen_of(of, tile, chosen)
    d = np.column_stack([np.ones(len(xyz)), xyz - about])
    return np.asarray(d.T @ d)


def binned(
    of: TiledCloud, tile: Tile, values: Callable[..., F64], *more: object
) -> tuple[I64, I64]:
    """Bins of the values (k,) that a tile has, ascending, and how many there are in each."""
    return counted(bins_of(values(of, tile, *more)))


def values_in(
    of: TiledCloud, tile: Tile, low: int, high: int, values: Callable[..., F64], *more: object
) -> F64:
    """Those (k,) in bins from ``low`` to ``high``."""
    found = values(of, tile, *more)
    bins = bins_of(found)
    return found[(bins >= low) & (bins <= high)]
