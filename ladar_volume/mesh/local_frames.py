"""Neighbours of every point, its tangent plane, and how one neighbour lies in it: what a mesher
without a direction of its own needs.

Normals say up to their sign which way a surface faces. Signs are carried over the cloud along its
smoothest connections first (Hoppe et al. 1992, with union and find in the place of a tree); across
an edge the sign is the one by which the connection runs along both faces. A neighbour on another
face is unfolded: turned about the line in which both tangent planes meet, so that lengths on both
faces stay true.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ladar_volume.math.kernels import kernel, parallel_kernel, signed
from ladar_volume.model.records import F64, I64

#: Neighbours that carry the sign of a normal, and those a plane is fitted to where no normals are
#: given.
LINKS, PLANE = 10, 12
#: Normals that enclose less than this are of one smooth piece (cosine of 25 degrees); beyond it, a
#: neighbour is unfolded.
SMOOTH = 0.906
#: Normals that enclose more than this belong to two sheets, back to back (cosine of 150 degrees).
OPPOSITE = -0.866
#: A connection may leave the surface by this slope (its sine), and by this part of the spacing: of
#: two sheets that face the same way and are closer than their points, one is noise (a filter can
#: split a thick band into two).
SLOPE, SLACK = 0.3, 1.25
#: How sure a smooth connection carries a sign, how sure two faces are of theirs, and as if by how
#: many more connections that say nothing.
SURE, LEAST, FEW = 0.65, 0.1, 4
#: Slope beyond which parallel planes are two.
STEEP = 0.5
#: Least share of the flux of the position in its length by which a part shows which side of it is
#: outside.
FLAT = 0.02


def neighbours(points: F64, count: int, at: I64 | None = None) -> tuple[F64, I64]:
    """Distances and indices (n, k) of the nearest ``count`` other points of each point (or of those
    ``at``), nearest first; k is smaller in a small cloud. No two points may be equal.
    """
    k = min(count, len(points) - 1)
    chosen = points if at is None else points[at]
    found = cKDTree(points, balanced_tree=False, compact_nodes=False).query(
        chosen, k + 1, workers=numba.get_num_threads()
    )
    distance, index = np.asarray(found[0]), np.asarray(found[1])
    return np.ascontiguousarray(distance[:, 1:]), np.ascontiguousarray(index[:, 1:], np.int64)


def spatial_order(points: F64) -> I64:
    """The order of points in which neighbours follow each other, for the sake of the cache."""
    return np.asarray(
        cKDTree(points, leafsize=64, balanced_tree=False, compact_nodes=False).indices, np.int64
    )


def neighbours_within(points: F64, radius: float) -> tuple[I64, I64]:
    """The points within a radius of each point, itself among them, in ascending order: where each
    list begins (n + 1,), and all lists.
    """
    pair = cKDTree(points).query_pairs(radius, output_type="ndarray").astype(np.int64)
    n = len(points)
    key = np.concatenate(
        [pair[:, 0] * n + pair[:, 1], pair[:, 1] * n + pair[:, 0], np.arange(n) * (n + 1)]
    )
    key.sort()
    return np.searchsorted(key, np.arange(n + 1) * n).astype(np.int64), key % n


def plane_normals(points: F64, index: I64) -> F64:
    """Normals (n, 3) of the planes through each point and its neighbours (n, k): the direction of
    least scatter.
    """
    arm = points[index] - points[:, None]
    middle = arm.sum(axis=1, keepdims=True) / (index.shape[1] + 1)
    arm = np.concatenate([arm, np.zeros_like(middle)], axis=1) - middle
    normals: F64 = np.linalg.eigh(np.einsum("nki,nkj->nij", arm, arm))[1][:, :, 0]
    return np.ascontiguousarray(normals)


@kernel
def offset_from_surface(
    ox: float, oy: float, oz: float, normals: F64, i: int, j: int, s: float
) -> float:
    """By how much an offset leaves the surface between points with unit normals n_i and s n_j: its
    part along their mean direction.
    """
    bx, by, bz = (
        normals[i, 0] + s * normals[j, 0],
        normals[i, 1] + s * normals[j, 1],
        normals[i, 2] + s * normals[j, 2],
    )
    off: float = abs(ox * bx + oy * by + oz * bz) / max(
        math.sqrt(bx * bx + by * by + bz * bz), 1e-12
    )
    return off


@parallel_kernel
def link_signs(points: F64, normals: F64, index: I64) -> F64:
    """For each point and neighbour (n, k) the sign their normals have to each other, times how sure
    it is: by how much more the connection leaves the surface for the other sign. Over smooth parts,
    the sign of the normals' product and 1 or little less.
    """
    n, k = index.shape
    sign = np.empty((n, k))
    for i in numba.prange(n):
        for c in range(k):
            j = index[i, c]
            x, y, z = (
                points[j, 0] - points[i, 0],
                points[j, 1] - points[i, 1],
                points[j, 2] - points[i, 2],
            )
            length = math.sqrt(x * x + y * y + z * z)
            dot = (
                normals[i, 0] * normals[j, 0]
                + normals[i, 1] * normals[j, 1]
                + normals[i, 2] * normals[j, 2]
            )
            s = 1.0 if dot >= 0.0 else -1.0
            off, other = offset_from_surface(x, y, z, normals, signed(i), j, s) / length, 1.0
            if abs(dot) < SMOOTH:
                other = offset_from_surface(x, y, z, normals, signed(i), j, -s) / length
                if other < off:
                    s, off, other = -s, other, off
            # between parallel planes, one over the other, a connection says nothing
            sign[i, c] = s * (other - off) if other < 1.0 or off < STEEP else 0.0
    return sign


@kernel
def carry_signs(a: I64, b: I64, relative: F64, n: int) -> tuple[F64, I64]:
    """Signs (n,) so that ``sign[a] relative = sign[b]`` along the links in their order, where no
    earlier ones decide, and the parts.
    """
    parent, sign = np.arange(n), np.ones(n)
    for e in range(len(a)):
        i, j, si, sj = a[e], b[e], 1.0, 1.0
        while parent[i] != i:
            p = parent[i]
            if parent[p] != p:  # path halving keeps the sign relative to the new parent
                sign[i] *= sign[p]
                parent[i] = parent[p]
            si *= sign[i]
            i = parent[i]
        while parent[j] != j:
            p = parent[j]
            if parent[p] != p:
                sign[j] *= sign[p]
                parent[j] = parent[p]
            sj *= sign[j]
            j = parent[j]
        if i != j:
            low, high = min(i, j), max(i, j)
            parent[high] = low
            sign[high] = si * sj * relative[e]
    root, total = np.empty(n, np.int64), np.empty(n)
    for i in range(n):  # a parent has a lower number, so it is done
        p = parent[i]
        root[i], total[i] = (i, 1.0) if p == i else (root[p], sign[i] * total[p])
    return total, root


def consistent_normals(points: F64, normals: F64, index: I64) -> F64:
    """Normals (n, 3) with signs that agree over each connected part, pointing outward: away from
    its middle, or up where it is flat.

    Signs are carried over smooth connections first; faces that these make then decide together, all
    connections of two faces as one; at last none is left with more against it than for it.
    """
    near = np.ascontiguousarray(index[:, :LINKS])
    sure = link_signs(points, normals, near).ravel()
    a, b = np.repeat(np.arange(len(points)), near.shape[1]), near.ravel()
    smooth = (np.abs(np.einsum("ni,ni->n", normals[a], normals[b])) > SMOOTH) & (
        np.abs(sure) > SURE
    )
    order = np.flatnonzero(smooth)[np.argsort(-np.abs(sure[smooth]), kind="stable")]
    signs, part = carry_signs(a[order], b[order], np.sign(sure[order]), len(points))
    across = np.flatnonzero(part[a] != part[b])
    low, high = np.minimum(part[a], part[b])[across], np.maximum(part[a], part[b])[across]
    pair, which, count = np.unique(
        low * len(points) + high, return_inverse=True, return_counts=True
    )
    vote: F64 = np.bincount(which, (sure * signs[a] * signs[b])[across], len(pair)).astype(
        np.float64
    )
    # the longest common edges first: there the sum is largest
    order = np.argsort(-np.abs(vote), kind="stable")
    order = order[np.abs(vote[order]) > LEAST * (count[order] + FEW)]
    one, other = pair[order] // len(points), pair[order] % len(points)
    turn, whole = carry_signs(one, other, np.sign(vote[order]), len(points))
    turn = flip_to_agree(turn, one, other, vote[order])
    return outward_normals(points, normals * (signs * turn[part])[:, None], whole[part])


def flip_to_agree(turn: F64, a: I64, b: I64, vote: F64) -> F64:
    """Signs (n,) of faces of which none has more against it than for it among its connections ``a
    b`` (e,) with their votes.

    A tree hears one connection of each face only; a strip of noise along a concave edge can outvote
    it there, but not the others. The face that most speaks against turns first; each turn adds to
    the sum of ``sign[a] vote sign[b]``, so it ends.
    """
    n, out = len(turn), turn.copy()
    joined = csr_matrix(
        (np.tile(vote, 2), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(n, n)
    )
    for_it: F64 = out * np.asarray(joined @ out)
    while True:
        worst = int(np.argmin(for_it))
        if for_it[worst] >= -1e-9 * float(np.abs(vote).max(initial=0.0)):
            return out
        row = slice(joined.indptr[worst], joined.indptr[worst + 1])
        near = joined.indices[row]
        for_it[near] -= 2.0 * out[worst] * joined.data[row] * out[near]
        for_it[worst] = -for_it[worst]
        out[worst] = -out[worst]


def outward_normals(points: F64, normals: F64, part: I64) -> F64:
    """Normals (n, 3) of each part turned away from its middle, or up where the part is flat."""
    n = len(points)
    size = np.maximum(np.bincount(part, minlength=n), 1)
    middle = (
        np.stack([np.bincount(part, points[:, k], n) for k in range(3)], axis=1) / size[:, None]
    )
    arm = points - middle[part]
    # the flux of the position through a closed surface is three times what it holds
    flux = np.bincount(part, np.einsum("ni,ni->n", arm, normals), n)
    reach = np.bincount(part, np.linalg.norm(arm, axis=1), n)
    side = np.where(np.abs(flux) > FLAT * reach, flux, np.bincount(part, normals[:, 2], n))
    turned: F64 = normals * np.where(side < 0.0, -1.0, 1.0)[part][:, None]
    return turned


@kernel
def tangent_coordinates(
    points: F64, normals: F64, i: int, j: int, slack: float
) -> tuple[float, float, bool]:
    """Where point j lies in the tangent plane of point i, in a right-handed frame that depends on i
    alone, and whether it is on the same sheet. Lengths along the surface are kept: over smooth
    parts the distance, over an edge both ways to the line where the planes meet.
    """
    n, m = normals[i], normals[j]
    ox, oy, oz = (
        points[j, 0] - points[i, 0],
        points[j, 1] - points[i, 1],
        points[j, 2] - points[i, 2],
    )
    length = math.sqrt(ox * ox + oy * oy + oz * oz)
    dot = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
    # a frame from the normal alone (Duff et al. 2017)
    g = math.copysign(1.0, n[2])
    h = -1.0 / (g + n[2])
    tx, ty, tz = 1.0 + g * n[0] * n[0] * h, g * n[0] * n[1] * h, -g * n[0]
    bx, by, bz = n[0] * n[1] * h, g + n[1] * n[1] * h, -n[1]
    if dot < OPPOSITE:
        return ox * tx + oy * ty + oz * tz, ox * bx + oy * by + oz * bz, False
    off = offset_from_surface(ox, oy, oz, normals, i, j, 1.0)
    same = off <= (SLOPE + math.sqrt(max(0.0, 0.5 - 0.5 * dot))) * length + slack
    if dot > SMOOTH:
        sx, sy, sz = n[0] + m[0], n[1] + m[1], n[2] + m[2]
        w = (ox * sx + oy * sy + oz * sz) / (sx * sx + sy * sy + sz * sz)
        ex, ey, ez = ox - w * sx, oy - w * sy, oz - w * sz
        x, y = ex * tx + ey * ty + ez * tz, ex * bx + ey * by + ez * bz
        short = math.sqrt(x * x + y * y)
        scale = math.sqrt(ex * ex + ey * ey + ez * ez) / short if short > 1e-12 * length else 1.0
        return x * scale, y * scale, same
    ax, ay, az = n[1] * m[2] - n[2] * m[1], n[2] * m[0] - n[0] * m[2], n[0] * m[1] - n[1] * m[0]
    sine = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / sine, ay / sine, az / sine
    ux, uy, uz = ay * n[2] - az * n[1], az * n[0] - ax * n[2], ax * n[1] - ay * n[0]
    across = ((ox * m[0] + oy * m[1] + oz * m[2]) - (ox * n[0] + oy * n[1] + oz * n[2])) / sine
    along = ox * ax + oy * ay + oz * az
    ex, ey, ez = along * ax + across * ux, along * ay + across * uy, along * az + across * uz
    return ex * tx + ey * ty + ez * tz, ex * bx + ey * by + ez * bz, same
