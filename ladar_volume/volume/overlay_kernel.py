"""Kernels of the overlay of two triangulations: pairs of triangles, clipped and integrated."""

from __future__ import annotations

import numba
import numpy as np

from ladar_volume.model.kernels import kernel, parallel_kernel
from ladar_volume.model.records import F64
from ladar_volume.surface.locate import CHUNKS, search

#: Corners a ring can have: a triangle clipped by three lines, and some for rounding.
CORNERS = 12
#: Triangles that are looked up in the other surface's tree together.
GROUP = 4


@kernel
def clip_line(n: int, source: F64, ux: float, uy: float, px: float, py: float, target: F64) -> int:
    """The part of a ring, x and y in rows of ``source`` (2, n or more), to the left of the line through p along u, into ``target``;
    returns its length."""
    m, last = 0, n - 1
    before = ux * (source[1, last] - py) - uy * (source[0, last] - px)
    for i in range(n):
        x, y = source[0, i], source[1, i]
        f = ux * (y - py) - uy * (x - px)
        if (f > 0.0 and before < 0.0) or (f < 0.0 and before > 0.0):
            s = before / (before - f)
            target[0, m] = source[0, last] + s * (x - source[0, last])
            target[1, m] = source[1, last] + s * (y - source[1, last])
            m += 1
        if f >= 0.0:
            target[0, m], target[1, m] = x, y
            m += 1
        before, last = f, i
    return m


@kernel
def tip(d0: float, d1: float, d2: float) -> tuple[float, float, float, float]:
    """Over the tip of a triangle at its corner 0, cut off by the zero line of the linear function with corner values d: means over the
    whole triangle of the function and of the three barycentric coordinates, each counted on the tip only (seed 000 section 4.1)."""
    s, t = d0 / (d0 - d1), d0 / (d0 - d2)
    share = s * t
    one, two = share * s / 3.0, share * t / 3.0
    return share * d0 / 3.0, share - one - two, one, two


@kernel
def add_fan(area: float, d: F64, p: F64, q: F64, i: int, out: F64, t: int) -> None:
    """Adds the fan triangle of a ring's corners 0, i, i + 1 to ``out[t]`` (2, 4): above and below the zero of d, the area, ∫|d|, ∫p, ∫q."""
    j = i + 1
    d0, d1, d2 = d[0], d[i], d[j]
    mean_d, mean_p, mean_q = (d0 + d1 + d2) / 3.0, (p[0] + p[i] + p[j]) / 3.0, (q[0] + q[i] + q[j]) / 3.0
    if d0 >= 0.0 and d1 >= 0.0 and d2 >= 0.0:
        side, lone = 0, -1
    elif d0 <= 0.0 and d1 <= 0.0 and d2 <= 0.0:
        side, lone = 1, -1
    else:  # one corner is alone on its side of zero: the one whose sign no other shares
        a0, a1, a2 = d0 > 0.0, d1 > 0.0, d2 > 0.0
        lone = 0 if a1 == a2 else (1 if a0 == a2 else 2)
        side = 1 if (a0, a1, a2)[lone] else 0
    out[t, side, 0] += area
    out[t, side, 1] += area * (mean_d if side == 0 else -mean_d)
    out[t, side, 2] += area * mean_p
    out[t, side, 3] += area * mean_q
    if lone < 0:
        return
    if lone == 0:
        mean, w0, w1, w2 = tip(d0, d1, d2)
    elif lone == 1:
        mean, w1, w2, w0 = tip(d1, d2, d0)
    else:
        mean, w2, w0, w1 = tip(d2, d0, d1)
    share, mean_p, mean_q = w0 + w1 + w2, w0 * p[0] + w1 * p[i] + w2 * p[j], w0 * q[0] + w1 * q[i] + w2 * q[j]
    other = 1 - side
    out[t, other, 0] += area * share
    out[t, other, 1] += area * abs(mean)
    out[t, other, 2] += area * mean_p
    out[t, other, 3] += area * mean_q
    out[t, side, 0] -= area * share
    out[t, side, 1] += area * abs(mean)  # the signed mean held the tip with the other sign
    out[t, side, 2] -= area * mean_p
    out[t, side, 3] -= area * mean_q


@kernel
def apart(a: F64, b: F64) -> bool:
    """Whether an edge of triangle a (3, 2), counter-clockwise, has all of triangle b on its outer side."""
    for k in range(3):
        j = k + 1 if k < 2 else 0
        ux, uy, px, py = a[j, 0] - a[k, 0], a[j, 1] - a[k, 1], a[k, 0], a[k, 1]
        if (
            ux * (b[0, 1] - py) - uy * (b[0, 0] - px) <= 0.0
            and ux * (b[1, 1] - py) - uy * (b[1, 0] - px) <= 0.0
            and ux * (b[2, 1] - py) - uy * (b[2, 0] - px) <= 0.0
        ):
            return True
    return False


@kernel
def add_pair(a: F64, za: F64, t: int, b: F64, zb: F64, o: int, sign: float, one: F64, two: F64, d: F64, p: F64, q: F64, out: F64) -> None:
    """Adds what two triangles a, b (3, 2) with heights za[t], zb[o] have in common to ``out[t]`` (2, 4); a has its corner 0 at the
    origin. The ring's coordinates p, q in the triangle a, kept within it, give the difference of heights d; the rest is scratch."""
    for i in range(3):
        one[0, i], one[1, i] = a[i, 0], a[i, 1]
    n = clip_line(3, one, b[1, 0] - b[0, 0], b[1, 1] - b[0, 1], b[0, 0], b[0, 1], two)
    n = clip_line(n, two, b[2, 0] - b[1, 0], b[2, 1] - b[1, 1], b[1, 0], b[1, 1], one) if n > 0 else 0
    n = clip_line(n, one, b[0, 0] - b[2, 0], b[0, 1] - b[2, 1], b[2, 0], b[2, 1], two) if n > 0 else 0
    ux, uy, vx, vy = b[1, 0] - b[0, 0], b[1, 1] - b[0, 1], b[2, 0] - b[0, 0], b[2, 1] - b[0, 1]
    area_a, area_b = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0], ux * vy - uy * vx
    if n < 3 or area_a <= 0.0 or area_b <= 0.0:  # a sliver whose area rounds to nothing holds no volume
        return
    area_a, area_b = 1.0 / area_a, 1.0 / area_b
    for i in range(n):
        x, y = two[0, i], two[1, i]
        p[i] = min(max((x * a[2, 1] - y * a[2, 0]) * area_a, 0.0), 1.0)
        q[i] = min(max((a[1, 0] * y - a[1, 1] * x) * area_a, 0.0), 1.0 - p[i])
        dx, dy = x - b[0, 0], y - b[0, 1]
        r = min(max((dx * vy - dy * vx) * area_b, 0.0), 1.0)
        s = min(max((ux * dy - uy * dx) * area_b, 0.0), 1.0 - r)
        high = p[i] * (za[t, 1] - za[t, 0]) + q[i] * (za[t, 2] - za[t, 0]) - r * (zb[o, 1] - zb[o, 0]) - s * (zb[o, 2] - zb[o, 0])
        d[i] = sign * ((za[t, 0] - zb[o, 0]) + high)
    for i in range(1, n - 1):
        ex, ey = two[0, i] - two[0, 0], two[1, i] - two[1, 0]
        area = 0.5 * (ex * (two[1, i + 1] - two[1, 0]) - ey * (two[0, i + 1] - two[0, 0]))
        add_fan(area, d, p, q, i, out, t)


@kernel
def boxes_of(corners: F64) -> F64:
    """Boxes (m, 4) of triangles (m, 3, 2): low x, low y, high x, high y."""
    out = np.empty((len(corners), 4))
    for t in range(len(corners)):
        for c in range(2):
            out[t, c] = min(corners[t, 0, c], corners[t, 1, c], corners[t, 2, c])
            out[t, 2 + c] = max(corners[t, 0, c], corners[t, 1, c], corners[t, 2, c])
    return out


@kernel
def group_box(boxes: F64, start: int, stop: int, box: F64) -> None:
    """The box of triangles start..stop−1 into ``box`` (4,)."""
    for c in range(4):
        box[c] = boxes[start, c]
    for t in range(start + 1, stop):
        for c in range(2):
            box[c], box[2 + c] = min(box[c], boxes[t, c]), max(box[2 + c], boxes[t, 2 + c])


@kernel
def boxes_apart(a: F64, t: int, b: F64, o: int) -> bool:
    """Whether box t of ``a`` (m, 4) and box o of ``b`` have no area in common."""
    return bool(a[t, 0] >= b[o, 2] or a[t, 1] >= b[o, 3] or a[t, 2] <= b[o, 0] or a[t, 3] <= b[o, 1])


@parallel_kernel
def overlay_kernel(corners: F64, heights: F64, other: F64, other_heights: F64, tree: F64, sign: float) -> F64:
    """Integrals (m, 2, 4) over each triangle (m, 3, 2) with heights (m, 3), above and below the other surface: area, ∫|difference|,
    and those of the second and third barycentric coordinate. Both surfaces are in the order of their trees."""
    m, count = len(corners), len(other)
    out = np.zeros((m, 2, 4))
    boxes, other_boxes = boxes_of(corners), boxes_of(other)
    for chunk in numba.prange(CHUNKS):
        stack, found, box = np.empty(128, np.int64), np.empty(1024, np.int64), np.empty(4)
        one, two, d, p, q = np.empty((2, CORNERS)), np.empty((2, CORNERS)), np.empty(CORNERS), np.empty(CORNERS), np.empty(CORNERS)
        # about the subject's first corner: differences of large map coordinates are exact or nearly so, their products are not
        a, b = np.empty((3, 2)), np.empty((3, 2))
        end = (chunk + 1) * m // CHUNKS
        for start in range(chunk * m // CHUNKS, end, GROUP):
            stop = min(start + GROUP, end)
            group_box(boxes, start, stop, box)
            n = search(tree, count, box, stack, found)
            if n > len(found):
                found = np.empty(2 * n, np.int64)
                n = search(tree, count, box, stack, found)
            for t in range(start, stop):
                x0, y0 = corners[t, 0, 0], corners[t, 0, 1]
                for k in range(3):
                    a[k, 0], a[k, 1] = corners[t, k, 0] - x0, corners[t, k, 1] - y0
                for i in range(n):
                    o = found[i]
                    if boxes_apart(boxes, t, other_boxes, o):
                        continue
                    for k in range(3):
                        b[k, 0], b[k, 1] = other[o, k, 0] - x0, other[o, k, 1] - y0
                    if not (apart(a, b) or apart(b, a)):
                        add_pair(a, heights, t, b, other_heights, o, sign, one, two, d, p, q, out)
    return out
