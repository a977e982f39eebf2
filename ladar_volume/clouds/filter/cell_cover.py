"""The order-independent cover: a grid of cells over the whole cloud, each with a surface of its
own, in parallel.

Points of one region share the radius of their neighbourhoods. A cell is a good half as wide as that
radius; where regions of several radii meet, each is covered by its own grid over all points. A
region's radius suits most of it: the points of a cell in which no surface is found, as where a thin
part bends away on both sides or several curved surfaces meet, are covered once more with the next
smaller radius.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ladar_volume.clouds.filter import cell_surface
from ladar_volume.clouds.filter.cell_planes import OFFERED, main_planes
from ladar_volume.clouds.filter.cell_records import (
    CellNoise,
    CellOutcome,
    CellRule,
    Cells,
    NeighbourPlanes,
)
from ladar_volume.clouds.filter.plane_set_selection import ENOUGH
from ladar_volume.clouds.filter.point_reduction import sorted_by_voxel
from ladar_volume.clouds.filter.sharp_planes import MOST
from ladar_volume.math.kernels import run_in_threads
from ladar_volume.model.parameters import FilterParameters
from ladar_volume.model.records import F64, I32, I64, Bool
from ladar_volume.rmls import refit_kernels
from ladar_volume.rmls.patch_fit import REACH
from ladar_volume.rmls.voxel_store import BITS

I8 = npt.NDArray[np.int8]

#: Width of a cell over the radius of its neighbourhood: from half on, the cells two away hold all
#: of it.
CELL = 0.7
#: A cell looks for planes within the ball's radius over this; it is offered those of its neighbours
#: too.
NARROWER = 2.5


@dataclass(frozen=True)
class Regions:
    """ball_m : (l,), radius of the neighbourhoods of each level, ascending · level : (n,) level of
    each point · least : (n,) lowest level it may have where no surface is found · sigma_m : (n,)
    noise along the normal · threshold_m : (n,) farthest a point lies from its surface ·
    across : second extent of the points of a plane, over the radius, below which they are a line
    and no plane
    """

    ball_m: F64
    level: I64
    least: I64
    sigma_m: F64
    threshold_m: F64
    across: float = 0.0


@dataclass(frozen=True)
class Projection:
    """Per point (n,): foot point q (n, 3) m, normal (n, 3), variance m² along it, reason, kind of
    its cell's surface (number of planes, −1 for a quadric, 0 for none), mean truncated square of
    the residuals around that cell over sigma², and level of its radius.
    """

    q: F64
    normal: F64
    variance: F64
    reason: I8
    kind: I8
    misfit: F64
    level: I64
    cells: int


def project_on_cells(
    r: F64, regions: Regions, parameters: FilterParameters, degree: int, mine: Bool | None = None
) -> Projection:
    """Project points (n, 3) m, near the origin, onto the surfaces of their cells; only those that
    are ``mine`` (n,), by default all.
    """
    n, count, at = len(r), 0, regions.level.copy()
    out = Projection(
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.zeros(n),
        np.full(n, cell_surface.NO_SURFACE, np.int8),
        np.zeros(n, np.int8),
        np.zeros(n),
        at,
        0,
    )
    open_ = np.ones(n, np.bool_) if mine is None else mine
    part, task = np.arange(n), _Task(r, regions, parameters, degree)
    while open_.any():
        around = np.zeros(n, np.bool_)
        for level, ball in enumerate(regions.ball_m):
            own = open_ & (at == level)
            if own.any():
                count += _cover_level(task, part, own, float(ball), out, around)
        open_ = open_ & (out.reason == cell_surface.NO_SURFACE) & (at > regions.least)
        at[open_] -= 1
        part = np.flatnonzero(around)
    return replace(out, cells=count)


@dataclass(frozen=True)
class _Task:
    """Points r (n, 3) m to be covered, and how."""

    r: F64
    regions: Regions
    parameters: FilterParameters
    degree: int


def _cover_level(
    task: _Task, part: I64, own: Bool, ball: float, out: Projection, around: Bool
) -> int:
    """Cover the points that are ``own`` (n,); returns the number of cells. part : the points that
    may count, all near enough. Those that may count with a smaller radius where a cell found no
    surface are marked in ``around`` (n,).
    """
    r = task.r
    order, keys, first, table = sorted_by_voxel(r if len(part) == len(r) else r[part], CELL * ball)
    order = part[order]
    cells = Cells(keys, table, first, r[order])
    wanted = np.add.reduceat(own[order], first[:-1], dtype=np.int64) > 0
    kind, misfit = np.zeros(len(keys), np.int64), np.zeros(len(keys))
    chosen = np.zeros((len(keys), MOST, 4))
    _cell_batches(
        task,
        cells,
        ball,
        wanted,
        CellOutcome(order, own, out.q, out.normal, out.variance, out.reason, kind, misfit, chosen),
    )
    of = np.repeat(np.arange(len(keys)), np.diff(first))
    mine = own[order]
    out.kind[order[mine]], out.misfit[order[mine]] = kind[of[mine]], misfit[of[mine]]
    close = _near_marked(wanted & (kind == 0), keys, table)  # these offer planes,
    around[order[_near_marked(close, keys, table)[of]]] = (
        True  # and those near them are what their planes are told from
    )
    return int(np.count_nonzero(wanted))


def _cell_batches(task: _Task, cells: Cells, ball: float, wanted: Bool, out: CellOutcome) -> None:
    """Planes of the cells near those ``wanted`` (v,), and these cells' surfaces, in turns."""
    number, parameters = len(cells.keys), task.parameters
    rule = CellRule(
        ball,
        task.degree,
        parameters.min_points,
        parameters.refit_iterations,
        parameters.edge == "snap",
        parameters.trials,
        parameters.seed,
    )
    noise = _cell_noise(task.regions, cells, out.order, ball)
    known = NeighbourPlanes(
        np.zeros((number, OFFERED, 4)),
        np.zeros(number, np.int64),
        np.zeros((number, MOST, 4)),
        np.zeros(number, np.int64),
    )
    near = np.flatnonzero(_near_marked(wanted, cells.keys, cells.table))
    run_in_threads(main_planes, near, cells, rule._replace(ball=ball / NARROWER), noise, known)
    lead = _block_cells(cells.keys)
    for turn, some in enumerate((wanted & lead, wanted & ~lead, wanted)):
        if turn == cell_surface.LAST:
            some = some & ((out.kind > 1) | (out.kind != 0) & (out.misfit > ENOUGH))
        run_in_threads(
            cell_surface.filter_cells, np.flatnonzero(some), turn, cells, rule, noise, known, out
        )
        known.sets[some], known.sizes[some] = out.planes[some], out.kind[some]


def _cell_noise(regions: Regions, cells: Cells, order: I64, ball: float) -> CellNoise:
    """Noise of each cell: that of its points, which differ only where regions meet."""
    first = cells.first
    size = np.diff(first)
    return CellNoise(
        np.add.reduceat(regions.sigma_m[order], first[:-1]) / size,
        np.add.reduceat(regions.threshold_m[order], first[:-1]) / size,
        np.full(len(size), regions.across * ball),
    )


def _near_marked(marked: Bool, keys: I64, table: I32) -> Bool:
    """Which voxels (n,) lie near one that is ``marked`` (n,)."""
    near = np.zeros(len(keys), np.bool_)
    refit_kernels.mark_around(np.flatnonzero(marked), keys, table, REACH, near)
    return near


def _block_cells(keys: I64) -> Bool:
    """One cell of each block of two by two by two."""
    one = np.int64(1)
    lead: Bool = ((keys >> (2 * BITS) | keys >> BITS | keys) & one) == 0
    return lead
