"""One pass over a whole cloud: every cell finds its surface, one quadric or several planes, and
projects its own points.

The choice is by the Bayesian information criterion on residuals cut off at the outlier threshold: a
quadric costs six parameters, a plane three. All residuals are distances to the surface along its
normal.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.clouds.filter import plane_em
from ladar_volume.clouds.filter.cell_planes import (
    OFFERED,
    cell_at,
    neighbour_candidates,
    neighbour_sets,
)
from ladar_volume.clouds.filter.cell_records import (
    BestSet,
    Cell,
    CellNoise,
    CellOutcome,
    CellRule,
    Cells,
    NeighbourPlanes,
    PieceBounds,
    Pieces,
    Quadric,
    no_quadric,
    pieces_of,
    whole_sample,
)
from ladar_volume.clouds.filter.orthogonal_quadric import foot_on_quadric
from ladar_volume.clouds.filter.plane_agreement import consensus_planes
from ladar_volume.clouds.filter.plane_set_selection import (
    best_neighbour_set,
    fit_quality,
    select_planes,
)
from ladar_volume.clouds.filter.sharp_planes import MOST, nearest_piece, plane_share
from ladar_volume.clouds.filter.single_surface import (
    fit_curved_quadric,
    fit_single_plane,
    nearest_to_origin,
)
from ladar_volume.math.array_types import F64, I64
from ladar_volume.math.kernels import inlined, kernel, leaf_kernel
from ladar_volume.rmls.patch_fit import AROUND
from ladar_volume.rmls.tangent_frame import second_tangent

KEPT, OUTLIER, FEW_POINTS, NO_SURFACE, BEYOND_EDGE, UNSUPPORTED = 0, 1, 2, 3, 4, 5
#: Turns: leaders search their planes; the others take over what a neighbour found where it explains
#: their points, and else search too; in the last one cells of several planes, and such as are not
#: explained, choose again among what all around them found, or take the planes that these agree in.
TURNS = 3
LAST = TURNS - 1
#: Support of a projected point: this many points within the radius that holds PATCH of them on a
#: full surface.
SUPPORT, PATCH = 4, 20


@leaf_kernel
def is_supported(x: F64, m: int, origin: F64, q: F64, square: float) -> Any:
    """Whether enough points (m, 3) about ``origin`` lie around q: planes end nowhere, surfaces
    do.
    """
    near = 0
    for i in range(m):
        d = 0.0
        for k in range(3):
            d += (x[i, k] + origin[k] - q[k]) ** 2
        near += d <= square
        if near > SUPPORT:  # one of them is the projected point itself
            return True
    return False


@leaf_kernel
def foot_on_planes(x: F64, origin: F64, pieces: Pieces, count: int, q: F64, n_out: F64) -> Any:
    """Foot point q and normal on the nearest piece of planes about ``origin``; returns (distance,
    variance of the plane there over sigma², 0 inside the piece, 1 on an edge, 2 in a vertex).
    """
    for k in range(3):
        n_out[k] = x[k] - origin[k]
    a, square, on = nearest_piece(n_out, pieces.planes, count, pieces.side, q)
    share = plane_share(q, pieces.used[a], pieces.means[a], pieces.inverses[a])
    for k in range(3):
        q[k] += origin[k]
        n_out[k] = pieces.planes[a, k]
    return np.sqrt(square), share, on


@inlined
def surface_of(
    cell: Cell,
    cells: Cells,
    rule: CellRule,
    known: NeighbourPlanes,
    candidates: F64,
    pieces: Pieces,
    quadric: Quadric,
) -> Any:
    """Several planes for the cell, not yet refined, and its quadric. Returns (number of planes; sum
    of truncated squares of the quadric, infinite where it is not wanted). What neighbours found
    comes first: it makes search and quadric superfluous where it leaves no more than the noise.
    """
    v, planes, bounds = cell.v, pieces.planes, PieceBounds(pieces.side, pieces.label)
    sets = neighbour_sets(v, cells, known, cell.origin)
    whole, reach = whole_sample(cell), 0.5 * rule.ball
    count, cost = best_neighbour_set(whole, reach, sets, rule.least, planes, bounds)
    own = cells.r[cells.first[v] : cells.first[v + 1]] - cell.origin
    if cell.turn == LAST and count > 0 and known.sizes[v] > 1:
        best = BestSet(count, cost, 0)
        return consensus_planes(whole, own, reach, sets, best, rule.least, planes, bounds), np.inf
    quality = fit_quality(whole, own, planes, count, bounds) if count > 0 else 0
    if quality == 2:
        return count, np.inf
    best = BestSet(count, cost, quality)
    return _search_surface(cell, cells, rule, candidates, best, pieces, quadric)


@inlined
def _search_surface(
    cell: Cell,
    cells: Cells,
    rule: CellRule,
    candidates: F64,
    best: BestSet,
    pieces: Pieces,
    quadric: Quadric,
) -> Any:
    """As :func:`surface_of`, where the neighbours' sets do not do."""
    count, curve, most = best.size, np.inf, MOST
    if rule.degree == 2:
        curve, most = fit_curved_quadric(
            cell, cells.r, cells.keys[cell.v], candidates, rule, quadric
        )
    if most == 0:
        return 0, curve
    if cell.turn < LAST and best.quality == 0:
        found, bounds = np.empty((MOST, 4)), PieceBounds(pieces.side, pieces.label)
        size, length = select_planes(
            whole_sample(cell), candidates, rule.least, most, found, bounds
        )
        if length < best.cost:
            count = size
            pieces.planes[:count] = found[:count]
    return count, curve


@inlined
def _refine_planes(cell: Cell, ball: float, count: int, pieces: Pieces) -> Any:
    """Planes refitted to a fixed point; returns (their number, length of their description, sum of
    truncated squares).
    """
    whole, support = whole_sample(cell), np.empty(MOST, np.int64)
    rounds = plane_em.ROUNDS if cell.turn == LAST or count == 1 else plane_em.FIRST_ROUNDS
    count = plane_em.refine(whole, ball, pieces, count, rounds, cell.width)
    length, square = plane_em.pieces_cost(whole, pieces.planes, count, pieces.side, np.inf, support)
    return count, length, square


@inlined
def _describe_cell(
    cell: Cell,
    cells: Cells,
    rule: CellRule,
    known: NeighbourPlanes,
    pieces: Pieces,
    quadric: Quadric,
) -> Any:
    """Planes and quadric of a cell; returns (number of planes, length of their description, sum of
    their truncated squares, that of the quadric).
    """
    m, sigma, threshold = cell.m, cell.sigma, cell.threshold
    candidates = np.empty((OFFERED * AROUND, 4))
    candidates = candidates[: neighbour_candidates(cell.v, cells, known, cell.origin, candidates)]
    price, limit = sigma * sigma * np.log(m), threshold * threshold
    length, square, curve, count = limit * m, limit * m, np.inf, 0
    if len(candidates) > 0:
        pieces.planes[0] = candidates[nearest_to_origin(candidates, len(candidates))]
        allowed = 3 * price if rule.degree == 2 else np.inf
        count, pieces.used[0], square = fit_single_plane(cell, rule.ball, allowed, pieces)
    if count == 0:
        count, curve = surface_of(cell, cells, rule, known, candidates, pieces, quadric)
        if count > 0:
            count, length, square = _refine_planes(cell, rule.ball, count, pieces)
    return count, length, square, curve


@inlined
def _project(
    cell: Cell,
    cells: Cells,
    rule: CellRule,
    pieces: Pieces,
    count: int,
    quadric: Quadric,
    out: CellOutcome,
) -> None:
    """The cell's own points onto ``count`` planes, onto the quadric where that is −1."""
    x, m, origin, sigma = cell.x, cell.m, cell.origin, cell.sigma
    side, reach = np.empty(3), rule.ball * rule.ball * PATCH / m + 4.0 * sigma * sigma
    second_tangent(quadric.normal, quadric.tangent, side)
    for i in range(cells.first[cell.v], cells.first[cell.v + 1]):
        to = out.order[i]
        if not out.mine[to]:
            continue
        r, q, n_out = cells.r[i], out.q[to], out.normal[to]
        if count < 0:
            d, share = foot_on_quadric(r, quadric, side, q, n_out)
            on = 0
        else:
            d, share, on = foot_on_planes(r, origin, pieces, count, q, n_out)
        out.variance[to] = share * sigma * sigma
        if d > cell.threshold:
            out.reason[to] = OUTLIER
        elif on > 0 and not rule.snap:
            out.reason[to] = BEYOND_EDGE
        else:
            out.reason[to] = KEPT if is_supported(x, m, origin, q, reach) else UNSUPPORTED


@inlined
def filter_cell(
    cell: Cell, cells: Cells, rule: CellRule, known: NeighbourPlanes, out: CellOutcome
) -> Any:
    """Surface of one cell, and its own points projected. Returns (number of planes, −1 for a
    quadric, 0 for none; mean truncated square of all points near the cell over sigma²).
    """
    m, sigma, origin = cell.m, cell.sigma, cell.origin
    if m < rule.least:
        mark_cell(cell.v, cells, FEW_POINTS, out)
        return 0, 9.0
    pieces, quadric = pieces_of(m), no_quadric()
    count, length, square, curve = _describe_cell(cell, cells, rule, known, pieces, quadric)
    price = sigma * sigma * np.log(m)
    curved = curve + 6 * price < length + 3 * count * price
    if not curved and count == 0:
        mark_cell(cell.v, cells, NO_SURFACE, out)
        return 0, 9.0
    _project(cell, cells, rule, pieces, -1 if curved else count, quadric, out)
    planes, chosen = pieces.planes, out.planes[cell.v]
    for a in range(count):
        chosen[a] = planes[a]
        chosen[a, 3] += (
            planes[a, 0] * origin[0] + planes[a, 1] * origin[1] + planes[a, 2] * origin[2]
        )
    return -1 if curved else count, (curve if curved else square) / (m * sigma * sigma)


@kernel
def mark_cell(v: int, cells: Cells, why: int, out: CellOutcome) -> None:
    """One reason for all points of a cell."""
    for i in range(cells.first[v], cells.first[v + 1]):
        if out.mine[out.order[i]]:
            out.reason[out.order[i]] = why


@kernel
def filter_cells(
    which: I64,
    turn: int,
    cells: Cells,
    rule: CellRule,
    noise: CellNoise,
    known: NeighbourPlanes,
    out: CellOutcome,
) -> None:
    """The cells ``which`` of a sorted cloud: each writes to ``out`` what becomes of those of its
    own points that are ``mine``.
    """
    for v in which:
        cell = cell_at(v, turn, cells, rule, noise)
        out.kind[v], out.misfit[v] = filter_cell(cell, cells, rule, known, out)
