"""What two triangles have in common: clipped (Sutherland & Hodgman 1974) and integrated in closed
form.

Scratch ``w`` (ROWS, CORNERS): the ring in rows 0, 1 or 2, 3 (x and y), distances from the clipping
line in row 4, at the ring's corners the difference of heights and the barycentric coordinates in
both triangles in rows 5 to 9; the two triangles in rows A, B (x, y and height each); the integrals
of a piece above and below in rows PAIR and PAIR + 1. One array, since each costs at every call.
"""

from __future__ import annotations

from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64

#: Corners a ring can have: a triangle clipped by three lines, and some for rounding.
CORNERS = 12
#: Rows of the scratch array.
A, B, PAIR, ROWS = 10, 13, 16, 18


@kernel
def clip_line(
    w: F64, s: int, n: int, ux: float, uy: float, px: float, py: float
) -> tuple[int, int, bool]:
    """The part of the ring of n corners in rows s, s + 1 to the left of the line through p along u:
    its row, its length, and whether something was cut off.
    """
    below = above = False
    for i in range(n):
        f = ux * (w[s + 1, i] - py) - uy * (w[s, i] - px)
        w[4, i] = f
        below = below or f < 0.0
        above = above or f > 0.0
    if not below:
        return s, n, False
    if not above:
        return s, 0, True
    t, m, last = 2 - s, 0, n - 1
    for i in range(n):
        before, f = w[4, last], w[4, i]
        if (f > 0.0 and before < 0.0) or (f < 0.0 and before > 0.0):
            share = before / (before - f)
            w[t, m] = w[s, last] + share * (w[s, i] - w[s, last])
            w[t + 1, m] = w[s + 1, last] + share * (w[s + 1, i] - w[s + 1, last])
            m += 1
        if f >= 0.0:
            w[t, m], w[t + 1, m] = w[s, i], w[s + 1, i]
            m += 1
        last = i
    return t, m, True


@kernel
def clip_pair(w: F64) -> tuple[int, int, int]:
    """The common part of the two triangles, counter-clockwise: its row in ``w``, its number of
    corners, and in bits 0 to 2 which edges of b, by the corner opposite, cut something off.
    """
    for i in range(3):
        w[0, i], w[1, i] = w[A, i], w[A + 1, i]
    s, n, cut = 0, 3, 0
    for k in range(3):
        i, j = (k + 1 if k < 2 else 0), (k - 1 if k > 0 else 2)
        s, n, off = clip_line(
            w, s, n, w[B, j] - w[B, i], w[B + 1, j] - w[B + 1, i], w[B, i], w[B + 1, i]
        )
        if n < 3:
            return s, 0, 0
        if off:
            cut |= 1 << k
    return s, n, cut


@kernel
def tip(d0: float, d1: float, d2: float) -> tuple[float, float, float, float]:
    """Over the tip of a triangle at its corner 0, cut off by the zero line of the linear function
    with corner values d: means over the whole triangle of the function and of the three barycentric
    coordinates, each counted on the tip only (seed 000 section 4.1).
    """
    s, t = d0 / (d0 - d1), d0 / (d0 - d2)
    share = s * t
    one, two = share * s / 3.0, share * t / 3.0
    return share * d0 / 3.0, share - one - two, one, two


@kernel
def add_fan(area: float, w: F64, i: int) -> None:
    """Adds the fan triangle of a ring's corners 0, i, i + 1 to the integrals above and below the
    zero of the difference d: area, ∫p, ∫q, ∫|d|, ∫r, ∫s, with d, p, q, r, s in rows 5 to 9 of w.
    """
    j = i + 1
    d0, d1, d2 = w[5, 0], w[5, i], w[5, j]
    if d0 >= 0.0 and d1 >= 0.0 and d2 >= 0.0:
        side, lone = 0, -1
    elif d0 <= 0.0 and d1 <= 0.0 and d2 <= 0.0:
        side, lone = 1, -1
    else:  # one corner is alone on its side of zero: the one whose sign no other shares
        a0, a1, a2 = d0 > 0.0, d1 > 0.0, d2 > 0.0
        lone = 0 if a1 == a2 else (1 if a0 == a2 else 2)
        side = 1 if (a0, a1, a2)[lone] else 0
    mean = (d0 + d1 + d2) / 3.0
    w[PAIR + side, 0] += area
    w[PAIR + side, 3] += area * (mean if side == 0 else -mean)
    for c in range(4):
        w[PAIR + side, 1 + c + c // 2] += area * (w[6 + c, 0] + w[6 + c, i] + w[6 + c, j]) / 3.0
    if lone < 0:
        return
    if lone == 0:
        mean, w0, w1, w2 = tip(d0, d1, d2)
    elif lone == 1:
        mean, w1, w2, w0 = tip(d1, d2, d0)
    else:
        mean, w2, w0, w1 = tip(d2, d0, d1)
    share, other = w0 + w1 + w2, 1 - side
    w[PAIR + other, 0] += area * share
    w[PAIR + side, 0] -= area * share
    w[PAIR + other, 3] += area * abs(mean)
    w[PAIR + side, 3] += area * abs(mean)  # the signed mean held the tip with the other sign
    for c in range(4):
        part = area * (w0 * w[6 + c, 0] + w1 * w[6 + c, i] + w2 * w[6 + c, j])
        w[PAIR + other, 1 + c + c // 2] += part
        w[PAIR + side, 1 + c + c // 2] -= part


@kernel
def add_same_sign(w: F64, s: int, n: int, side: int) -> None:
    """As :func:`add_fan` for the whole ring, where the difference has one sign."""
    area = d = p = q = r = u = 0.0
    x0, y0 = w[s, 0], w[s + 1, 0]
    ex, ey = w[s, 1] - x0, w[s + 1, 1] - y0
    for i in range(1, n - 1):
        fx, fy = w[s, i + 1] - x0, w[s + 1, i + 1] - y0
        share = 0.5 * (ex * fy - ey * fx)
        area += share
        d += share * (w[5, 0] + w[5, i] + w[5, i + 1])
        p += share * (w[6, 0] + w[6, i] + w[6, i + 1])
        q += share * (w[7, 0] + w[7, i] + w[7, i + 1])
        r += share * (w[8, 0] + w[8, i] + w[8, i + 1])
        u += share * (w[9, 0] + w[9, i] + w[9, i + 1])
        ex, ey = fx, fy
    w[PAIR + side, 0], w[PAIR + side, 1], w[PAIR + side, 2], w[PAIR + side, 3] = (
        area,
        p / 3.0,
        q / 3.0,
        abs(d) / 3.0,
    )
    w[PAIR + side, 4], w[PAIR + side, 5] = r / 3.0, u / 3.0


@kernel
def add_piece(t: int, sign: float, w: F64, s: int, n: int, out: F64) -> float:
    """Integrates the ring of n corners in rows s, s + 1, the common part of the two triangles, of
    which A has its corner 0 at the origin. Adds area, ∫p, ∫q, ∫|d| to ``out[t]`` (2, 4), leaves
    these and ∫r, ∫s in rows PAIR, PAIR + 1; returns the area.

    The coordinates p, q in the triangle A and r, s in B, kept within them, give the difference of
    heights d.
    """
    for c in range(6):
        w[PAIR, c] = w[PAIR + 1, c] = 0.0
    ax, ay, bx, by = w[A, 1], w[A + 1, 1], w[A, 2], w[A + 1, 2]
    x0, y0 = w[B, 0], w[B + 1, 0]
    ux, uy, vx, vy = w[B, 1] - x0, w[B + 1, 1] - y0, w[B, 2] - x0, w[B + 1, 2] - y0
    area_a, area_b = ax * by - ay * bx, ux * vy - uy * vx
    if area_a <= 0.0 or area_b <= 0.0:  # a sliver whose area rounds to nothing holds no volume
        return 0.0
    area_a, area_b, low, high = 1.0 / area_a, 1.0 / area_b, 0.0, 0.0
    base, a1, a2 = w[A + 2, 0] - w[B + 2, 0], w[A + 2, 1] - w[A + 2, 0], w[A + 2, 2] - w[A + 2, 0]
    b1, b2 = w[B + 2, 1] - w[B + 2, 0], w[B + 2, 2] - w[B + 2, 0]
    for i in range(n):
        x, y = w[s, i], w[s + 1, i]
        p = min(max((x * by - y * bx) * area_a, 0.0), 1.0)
        q = min(max((ax * y - ay * x) * area_a, 0.0), 1.0 - p)
        dx, dy = x - x0, y - y0
        r = min(max((dx * vy - dy * vx) * area_b, 0.0), 1.0)
        u = min(max((ux * dy - uy * dx) * area_b, 0.0), 1.0 - r)
        d = sign * (base + (p * a1 + q * a2 - r * b1 - u * b2))
        w[5, i], w[6, i], w[7, i], w[8, i], w[9, i] = d, p, q, r, u
        low, high = min(low, d), max(high, d)
    if low >= 0.0 or high <= 0.0:
        add_same_sign(w, s, n, 0 if low >= 0.0 else 1)
    else:
        for i in range(1, n - 1):
            ex, ey = w[s, i] - w[s, 0], w[s + 1, i] - w[s + 1, 0]
            fx, fy = w[s, i + 1] - w[s, 0], w[s + 1, i + 1] - w[s + 1, 0]
            add_fan(0.5 * (ex * fy - ey * fx), w, i)
    for side in range(2):
        for c in range(4):
            out[t, side, c] += w[PAIR + side, c]
    return float(w[PAIR, 0] + w[PAIR + 1, 0])
