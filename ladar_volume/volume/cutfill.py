"""Cut and fill of a surface against a level, a plane or a second surface, and their sequences over
many levels (seed 000 chapter 4).

Over one triangle with heights z0 ≤ z1 ≤ z2 the cut volume is a cubic of the level on each side of
z1, a line below z0 and zero above z2. The pieces of all triangles are collected on a binary tree
over the sorted levels, each where its range of levels begins and ends, as polynomials about the
middle of a node's own levels: O((n + m) log m) for n triangles and m levels, and without the
cancellation of powers about one origin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.math.kernels import kernel
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, I32, Bool, Plane, Tin
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.volume.prismoids import gather, positive_part


@dataclass(frozen=True)
class Sequence:
    """Volumes of one surface over levels.

    level_m : (m,), as given · cut_m3, fill_m3 : (m,), both positive · above_m2 : (m,) area where
    the surface is above the level, which is minus the derivative of the cut volume by the level ·
    below_m2 : (m,) where it is below · area_m2 : of the footprint
    """

    level_m: F64
    cut_m3: F64
    fill_m3: F64
    above_m2: F64
    below_m2: F64
    area_m2: float

    @property
    def net_m3(self) -> F64:
        """Cut minus fill (m,), m³."""
        return self.cut_m3 - self.fill_m3


def with_net(cut_m3: float, fill_m3: float, more_m3: float) -> tuple[float, float]:
    """Cut and fill when the net grows: a heap has more to cut, a pit less to fill."""
    if cut_m3 >= fill_m3:
        return cut_m3 + more_m3, fill_m3
    return cut_m3, fill_m3 - more_m3


@kernel
def add_piece(
    tree: F64, centre: F64, low: int, high: int, origin: float, c0: float, c1: float, c3: float
) -> None:
    """Adds ``c0 + c1 x + c3 x³``, x = level − origin, for the levels low..high−1 to the nodes of
    the tree (2 k, 4) that make them up.
    """
    leaves = len(tree) // 2
    i, j = low + leaves, high + leaves
    while i < j:
        if i & 1:
            x = centre[i] - origin
            tree[i, 0] += c0 + (c1 + c3 * x * x) * x
            tree[i, 1] += c1 + 3.0 * c3 * x * x
            tree[i, 2] += 3.0 * c3 * x
            tree[i, 3] += c3
            i += 1
        if j & 1:
            j -= 1
            x = centre[j] - origin
            tree[j, 0] += c0 + (c1 + c3 * x * x) * x
            tree[j, 1] += c1 + 3.0 * c3 * x * x
            tree[j, 2] += 3.0 * c3 * x
            tree[j, 3] += c3
        i >>= 1
        j >>= 1


@kernel
def count_below(levels: F64, z: float) -> int:
    """Number of ascending levels (m,) below z."""
    low, high = 0, len(levels)
    while low < high:
        middle = (low + high) // 2
        if levels[middle] < z:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def sequence_kernel(h: F64, area: F64, levels: F64) -> F64:
    """Cut volumes and areas above (m, 2) at ascending levels (m,) of triangles with heights h (n,
    3) and footprints area (n,).
    """
    m, leaves = len(levels), 1
    while leaves < m:
        leaves *= 2
    centre, tree = np.empty(2 * leaves), np.zeros((2 * leaves, 4))
    first, last = np.empty(2 * leaves), np.empty(2 * leaves)
    for i in range(leaves):
        first[leaves + i] = last[leaves + i] = levels[min(i, m - 1)]
    for node in range(leaves - 1, 0, -1):
        first[node], last[node] = first[2 * node], last[2 * node + 1]
    for node in range(1, 2 * leaves):
        centre[node] = (
            first[node] if first[node] == last[node] else 0.5 * (first[node] + last[node])
        )
    for t in range(len(h)):
        z0, z1, z2 = min(h[t, 0], h[t, 1], h[t, 2]), 0.0, max(h[t, 0], h[t, 1], h[t, 2])
        z1 = max(min(h[t, 0], h[t, 1]), min(max(h[t, 0], h[t, 1]), h[t, 2]))
        k0, k1, k2 = count_below(levels, z0), count_below(levels, z1), count_below(levels, z2)
        a = area[t]
        # levels below z1: the signed volume; from z0 on with the tip below the level added back
        add_piece(tree, centre, 0, k1, z0, a * ((z1 - z0) + (z2 - z0)) / 3.0, -a, 0.0)
        if k1 > k0:
            add_piece(tree, centre, k0, k1, z0, 0.0, 0.0, a / (3.0 * (z1 - z0) * (z2 - z0)))
        if k2 > k1:
            add_piece(tree, centre, k1, k2, z2, 0.0, 0.0, -a / (3.0 * (z2 - z0) * (z2 - z1)))
    for node in range(1, leaves):
        p0, p1, p2, p3 = tree[node, 0], tree[node, 1], tree[node, 2], tree[node, 3]
        for child in (2 * node, 2 * node + 1):
            x = centre[child] - centre[node]
            tree[child, 0] += p0 + (p1 + (p2 + p3 * x) * x) * x
            tree[child, 1] += p1 + (2.0 * p2 + 3.0 * p3 * x) * x
            tree[child, 2] += p2 + 3.0 * p3 * x
            tree[child, 3] += p3
    out = np.empty((m, 2))
    out[:, 0], out[:, 1] = tree[leaves : leaves + m, 0], -tree[leaves : leaves + m, 1]
    return out


def triangle_heights(tin: Tin, base: Plane | None, mask: Bool | None) -> tuple[F64, F64, I32]:
    """Heights (n, 3) above the base, footprints (n,) m² and vertices (n, 3) of the chosen
    triangles.

    Raises :class:`VolumeError` where there is none.
    """
    triangles = tin.triangles[tin.relevant if mask is None else mask]
    if len(triangles) == 0:
        raise VolumeError("there is no triangle to take a volume of", reason="volume_no_triangle")
    z = height_above(tin.vertices, base)
    return np.ascontiguousarray(z[triangles]), footprint_areas(tin.vertices, triangles), triangles


def cut_sequence(
    tin: Tin, levels_m: F64, base: Plane | None = None, mask: Bool | None = None
) -> Sequence:
    """Cut and fill at all levels (m,), m, in one pass; in any order, repeated or not. With ``base``
    the levels count from it.

    Cut and fill are exact zeros where the surface is wholly below or above. Raises
    :class:`VolumeError` without triangles, or for levels that are not finite numbers.
    """
    levels = np.asarray(levels_m, dtype=np.float64)
    if levels.ndim != 1 or len(levels) == 0 or not np.isfinite(levels).all():
        raise VolumeError(
            "levels are a list of at least one finite number",
            reason="volume_levels",
            value=levels_m,
        )
    h, area, _ = triangle_heights(tin, base, mask)
    order = np.argsort(levels, kind="stable")
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    up = sequence_kernel(h, area, np.ascontiguousarray(levels[order]))[back]
    down = sequence_kernel(-h, area, np.ascontiguousarray(-levels[order][::-1]))[::-1][back]
    for rows, empty in ((up, levels >= h.max()), (down, levels <= h.min())):
        rows[empty] = 0.0
        np.maximum(rows, 0.0, out=rows)
    return Sequence(levels, up[:, 0], down[:, 0], up[:, 1], down[:, 1], float(area.sum()))


def sequence_gradient(
    tin: Tin, levels_m: F64, weights: F64, base: Plane | None = None, mask: Bool | None = None
) -> F64:
    """Derivatives (n,) by the vertex heights of ``Σ_k weights_k cut(level_k)``; the adjoint of
    whatever is read off a sequence.
    """
    h, area, triangles = triangle_heights(tin, base, mask)
    slope = np.zeros_like(h)
    for z, w in zip(levels_m, weights, strict=True):
        slope += w * positive_part(h - z)[1]
    return gather((slope * area[:, None])[..., None], triangles, len(tin.vertices))[:, 0]
