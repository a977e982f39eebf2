"""What the kernels of the cover share: the sorted cloud, numbers, what cells know and what becomes
of points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.filter.sharp_planes import MOST
from ladar_volume.math.array_types import F64, I8, I32, I64, Bool
from ladar_volume.math.kernels import kernel


class Cells(NamedTuple):
    """A cloud sorted by voxel. keys : (v,), table : their hash table · first : (v + 1,) first point
    of each · r : (n, 3) m
    """

    keys: I64
    table: I32
    first: I64
    r: F64


class CellRule(NamedTuple):
    """Numbers the kernels need. ball : radius of a neighbourhood, m · degree : 2 with quadrics ·
    least : fewest points of a surface · iterations : most refits · snap : points beyond an edge are
    set onto it · trials : random planes, from seed
    """

    ball: float
    degree: int
    least: int
    iterations: int
    snap: bool
    trials: int
    seed: int


class CellNoise(NamedTuple):
    """By cell (v,), m: sigma, threshold of an outlier, and width below which points are a line."""

    sigma: F64
    threshold: F64
    width: F64


class NeighbourPlanes(NamedTuple):
    """By cell: planes (v, OFFERED, 4) that it offers, found (v,) of them; sets (v, MOST, 4) of
    planes that it chose, sizes (v,) of these, −1 for a quadric
    """

    planes: F64
    counts: I64
    sets: F64
    sizes: I64


class CellOutcome(NamedTuple):
    """order : (n,) place of each sorted point among those given · by point given: mine, whether it
    is to be projected, q, normal : (n, 3), variance : (n,) m², reason : (n,) · by cell: kind (v,),
    misfit (v,), chosen (v, MOST, 4)
    """

    order: I64
    mine: Bool
    q: F64
    normal: F64
    variance: F64
    reason: I8
    kind: I64
    misfit: F64
    planes: F64


class Cell(NamedTuple):
    """Cell v in a turn. x : m points (m, 3) about ``origin`` (3,), m · slots : (n,) rows of all
    gathered ones · sigma, threshold, width : m, as :class:`CellNoise`
    """

    v: int
    turn: int
    x: F64
    m: int
    slots: I64
    origin: F64
    sigma: float
    threshold: float
    width: float


class Pieces(NamedTuple):
    """Planes of a cell, with room for MOST. planes : (k, 4), means : (k, 3), inverses : (k, 3, 3),
    used : (k,) of the fit · side : (k, k) which bounds which · label : (m,) plane of each point
    """

    planes: F64
    means: F64
    inverses: F64
    used: F64
    side: I64
    label: I64


class Quadric(NamedTuple):
    """centre, normal, tangent : (3,) · beta : (6,) · inverse : (6, 6)"""

    centre: F64
    normal: F64
    tangent: F64
    beta: F64
    inverse: F64


class PointSample(NamedTuple):
    """What a set of planes is to describe. x : m points, the first n (n, 3) about the cell's origin
    · m : number of points that these are a sample of · sigma, threshold : m, as :class:`CellNoise`
    """

    x: F64
    n: int
    m: int
    sigma: float
    threshold: float


class PieceBounds(NamedTuple):
    """side : (MOST, MOST) which plane bounds which · label : (n,) plane of each point. Working
    arrays of those who compare sets of planes.
    """

    side: I64
    label: I64


class NeighbourSets(NamedTuple):
    """Sets of planes that neighbours chose. planes : (k, MOST, 4) · sizes : (k,)"""

    planes: F64
    sizes: I64


class BestSet(NamedTuple):
    """The best of the neighbours' sets: number of planes, length of its description, and how well
    it explains the points, 0 to 2.
    """

    size: int
    cost: float
    quality: int


@kernel
def pieces_of(m: int) -> Pieces:
    """Room for the planes of m points."""
    return Pieces(
        np.zeros((MOST, 4)),
        np.zeros((MOST, 3)),
        np.zeros((MOST, 3, 3)),
        np.zeros(MOST),
        np.zeros((MOST, MOST), np.int64),
        np.empty(m, np.int64),
    )


@kernel
def no_quadric() -> Quadric:
    """Room for a quadric."""
    return Quadric(np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(6), np.zeros((6, 6)))


@kernel
def whole_sample(cell: Cell) -> PointSample:
    """All points of a cell."""
    return PointSample(cell.x, cell.m, cell.m, cell.sigma, cell.threshold)
