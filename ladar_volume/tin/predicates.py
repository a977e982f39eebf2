"""Exact signs of the two geometric predicates of a Delaunay triangulation, compiled.

A floating-point filter decides almost always; where it cannot, the determinant is evaluated without
rounding as a non-overlapping expansion (Shewchuk 1997, "Adaptive precision floating-point
arithmetic and fast robust geometric predicates"). Exact as long as no product under- or overflows:
coordinates and their differences are zero or lie within 1e-60 to 1e60, which lengths in metres do.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64

EPSILON = 2.0**-53
SPLITTER = 2.0**27 + 1.0
ORIENT_BOUND = (3.0 + 16.0 * EPSILON) * EPSILON
INCIRCLE_BOUND = (10.0 + 96.0 * EPSILON) * EPSILON
#: Longest expansion of the incircle determinant: three products of 16 by 16 components.
WORKSPACE = (13, 1600)
#: Row of the workspace that counts how many orientations and how many incircle tests reached the
#: exact stage.
COUNTS = 12


class Expansion(NamedTuple):
    """The first n components (k,) of a number without rounding, the smallest first."""

    n: int
    x: F64


def workspace() -> F64:
    """Scratch rows for the exact evaluation, to be allocated once per triangulation: (13, 1600)
    float64.
    """
    return np.zeros(WORKSPACE)


@kernel
def two_sum(a: float, b: float) -> tuple[float, float]:
    """``a + b`` as rounded sum and exact remainder."""
    x = a + b
    bv = x - a
    return x, (a - (x - bv)) + (b - bv)


@kernel
def two_product(a: float, b: float) -> tuple[float, float]:
    """``a b`` as rounded product and exact remainder."""
    x = a * b
    c = SPLITTER * a
    ah = c - (c - a)
    al = a - ah
    c = SPLITTER * b
    bh = c - (c - b)
    bl = b - bh
    return x, al * bl - (((x - ah * bh) - al * bh) - ah * bl)


@kernel
def expansion_sum(ne: int, e: F64, nf: int, f: F64, h: F64) -> int:
    """Sum of two expansions into ``h`` without zero components; returns its length. ``h`` may not
    be ``e`` or ``f``.
    """
    i = j = n = 0
    q = 0.0
    for k in range(ne + nf):
        if j >= nf or (i < ne and abs(e[i]) < abs(f[j])):
            v = e[i]
            i += 1
        else:
            v = f[j]
            j += 1
        if k == 0:
            q = v
        else:
            q, r = two_sum(q, v)
            if r != 0.0:
                h[n] = r
                n += 1
    if q != 0.0:
        h[n] = q
        n += 1
    return n


@kernel
def expansion_scale(ne: int, e: F64, b: float, h: F64) -> int:
    """Product of an expansion and one number into ``h`` without zero components; returns its
    length.
    """
    n = 0
    if ne == 0 or b == 0.0:
        return 0
    q, r = two_product(e[0], b)
    if r != 0.0:
        h[n] = r
        n += 1
    for i in range(1, ne):
        hi, lo = two_product(e[i], b)
        s, r = two_sum(q, lo)
        if r != 0.0:
            h[n] = r
            n += 1
        q, r = two_sum(hi, s)
        if r != 0.0:
            h[n] = r
            n += 1
    if q != 0.0:
        h[n] = q
        n += 1
    return n


@kernel
def expansion_product(ne: int, e: F64, nf: int, f: F64, h: F64, s: F64, t: F64) -> int:
    """Product of two expansions into ``h``, with scratch rows ``s`` and ``t``; returns its
    length.
    """
    n = 0
    for j in range(nf):
        ns = expansion_scale(ne, e, f[j], s)
        nt = expansion_sum(n, h, ns, s, t)
        for i in range(nt):
            h[i] = t[i]
        n = nt
    return n


@kernel
def expansion_difference(a: float, b: float, h: F64) -> int:
    """``a - b`` exactly into ``h``; returns its length (0 to 2)."""
    x, y = two_sum(a, -b)
    n = 0
    if y != 0.0:
        h[n] = y
        n += 1
    if x != 0.0:
        h[n] = x
        n += 1
    return n


@kernel
def minor_exact(ax: Expansion, ay: Expansion, bx: Expansion, by: Expansion, h: F64, w: F64) -> int:
    """``ax by - bx ay`` of expansions into ``h``, with scratch rows ``w`` (4, ...); returns its
    length.
    """
    n1 = expansion_product(ax.n, ax.x, by.n, by.x, w[2], w[0], w[1])
    n2 = expansion_product(bx.n, bx.x, ay.n, ay.x, w[3], w[0], w[1])
    for i in range(n2):
        w[3, i] = -w[3, i]
    return expansion_sum(n1, w[2], n2, w[3], h)


@kernel
def orientation(ax: float, ay: float, bx: float, by: float, cx: float, cy: float, w: F64) -> float:
    """Positive where a, b, c turn counter-clockwise, negative where clockwise, zero exactly where
    collinear.
    """
    left = (ax - cx) * (by - cy)
    right = (ay - cy) * (bx - cx)
    det = left - right
    # a product that vanishes has a factor that vanishes, and differences vanish exactly
    if abs(det) > ORIENT_BOUND * (abs(left) + abs(right)) or left == 0.0 or right == 0.0:
        return det
    return orientation_exact(ax, ay, bx, by, cx, cy, w)


@kernel
def orientation_exact(
    ax: float, ay: float, bx: float, by: float, cx: float, cy: float, w: F64
) -> float:
    """A number of the sign of the orientation determinant, without rounding; counted in the
    workspace.
    """
    w[COUNTS, 0] += 1.0
    n0 = expansion_difference(ax, cx, w[4])
    n1 = expansion_difference(ay, cy, w[5])
    n2 = expansion_difference(bx, cx, w[6])
    n3 = expansion_difference(by, cy, w[7])
    n = minor_exact(
        Expansion(n0, w[4]), Expansion(n1, w[5]), Expansion(n2, w[6]), Expansion(n3, w[7]), w[8], w
    )
    return float(w[8, n - 1]) if n else 0.0


@kernel
def incircle_exact(xy: F64, a: int, b: int, c: int, d: int, w: F64) -> float:
    """A number of the sign of the incircle determinant of points a to d, without rounding; counted
    in the workspace.
    """
    w[COUNTS, 1] += 1.0
    if is_rectangle(xy, a, b, c, d) or is_rectangle(xy, a, c, b, d) or is_rectangle(xy, a, d, b, c):
        return 0.0
    short = incircle_short(xy, a, b, c, d)
    if short == short:
        return short
    # differences and squares in the tail of the scratch rows: six rows of two, three of four
    e = w[11]
    n = np.empty(9, np.int64)
    for i, v in enumerate((a, b, c)):
        for k in range(2):
            n[2 * i + k] = expansion_difference(
                xy[v, k], xy[d, k], e[8 * i + 4 * k : 8 * i + 4 * k + 4]
            )
    total = 0
    for i in range(3):
        j, k = 8 * ((i + 1) % 3), 8 * ((i + 2) % 3)
        nm = minor_exact(
            Expansion(n[j // 4], e[j:]),
            Expansion(n[j // 4 + 1], e[j + 4 :]),
            Expansion(n[k // 4], e[k:]),
            Expansion(n[k // 4 + 1], e[k + 4 :]),
            w[4],
            w,
        )
        x, y = e[8 * i : 8 * i + 4], e[8 * i + 4 : 8 * i + 8]
        nx = expansion_product(n[2 * i], x, n[2 * i], x, w[5], w[0], w[1])
        ny = expansion_product(n[2 * i + 1], y, n[2 * i + 1], y, w[6], w[0], w[1])
        nl = expansion_sum(nx, w[5], ny, w[6], w[7])
        nt = expansion_product(nm, w[4], nl, w[7], w[8], w[0], w[1])
        ns = expansion_sum(total, w[9], nt, w[8], w[10])
        for m in range(ns):
            w[9, m] = w[10, m]
        total = ns
    return float(w[9, total - 1]) if total else 0.0


@kernel
def is_rectangle(xy: F64, a: int, b: int, c: int, d: int) -> bool:
    """Whether a-b and c-d are the upright sides of an axis-parallel rectangle, whose corners are
    co-circular whatever their digits.

    This is the common case of the exact stage: heights on a raster.
    """
    if xy[a, 0] != xy[b, 0] or xy[c, 0] != xy[d, 0]:
        return False
    return bool(
        (xy[a, 1] == xy[c, 1] and xy[b, 1] == xy[d, 1])
        or (xy[a, 1] == xy[d, 1] and xy[b, 1] == xy[c, 1])
    )


@kernel
def exact_difference(a: float, b: float) -> float:
    """``a - b`` where that is exact, else NaN."""
    x, y = two_sum(a, -b)
    return x if y == 0.0 else np.nan


@kernel
def exact_product(a: float, b: float) -> float:
    """``a b`` where that is exact, else NaN."""
    x, y = two_product(a, b)
    return x if y == 0.0 else np.nan


@kernel
def incircle_short(xy: F64, a: int, b: int, c: int, d: int) -> float:
    """The incircle determinant where no operation of it rounds (grids of short numbers), else
    NaN.
    """
    adx, ady = exact_difference(xy[a, 0], xy[d, 0]), exact_difference(xy[a, 1], xy[d, 1])
    bdx, bdy = exact_difference(xy[b, 0], xy[d, 0]), exact_difference(xy[b, 1], xy[d, 1])
    cdx, cdy = exact_difference(xy[c, 0], xy[d, 0]), exact_difference(xy[c, 1], xy[d, 1])
    al = exact_difference(exact_product(adx, adx), -exact_product(ady, ady))
    bc = exact_difference(exact_product(bdx, cdy), exact_product(cdx, bdy))
    total = exact_product(al, bc)
    if total != total:
        return total
    bl = exact_difference(exact_product(bdx, bdx), -exact_product(bdy, bdy))
    ca = exact_difference(exact_product(cdx, ady), exact_product(adx, cdy))
    cl = exact_difference(exact_product(cdx, cdx), -exact_product(cdy, cdy))
    ab = exact_difference(exact_product(adx, bdy), exact_product(bdx, ady))
    return exact_difference(exact_difference(total, -exact_product(bl, ca)), -exact_product(cl, ab))


@kernel
def incircle(xy: F64, a: int, b: int, c: int, d: int, w: F64) -> float:
    """Positive where point d lies inside the circle through a, b, c (counter-clockwise), zero
    exactly on it.
    """
    adx, ady = xy[a, 0] - xy[d, 0], xy[a, 1] - xy[d, 1]
    bdx, bdy = xy[b, 0] - xy[d, 0], xy[b, 1] - xy[d, 1]
    cdx, cdy = xy[c, 0] - xy[d, 0], xy[c, 1] - xy[d, 1]
    bc, cb = bdx * cdy, cdx * bdy
    ca, ac = cdx * ady, adx * cdy
    ab, ba = adx * bdy, bdx * ady
    al, bl, cl = adx * adx + ady * ady, bdx * bdx + bdy * bdy, cdx * cdx + cdy * cdy
    det = al * (bc - cb) + bl * (ca - ac) + cl * (ab - ba)
    size = (abs(bc) + abs(cb)) * al + (abs(ca) + abs(ac)) * bl + (abs(ab) + abs(ba)) * cl
    if abs(det) > INCIRCLE_BOUND * size:
        return float(det)
    return incircle_exact(xy, a, b, c, d, w)
