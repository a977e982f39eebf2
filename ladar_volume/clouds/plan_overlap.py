"""Where triangles of one surface lie over one another in plan: what is no function of the place
there.

Every pair whose footprints meet, found in the box tree, is clipped (Sutherland & Hodgman 1974); the
areas of the common parts are summed. Triangles that share an edge or a corner have none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I64, Tin
from ladar_volume.tin.locate import search_boxes, triangle_index
from ladar_volume.volume.overlay import placed_corners
from ladar_volume.volume.triangle_clipping import CORNERS, ROWS, A, B, clip_pair

#: Common parts narrower than this share of the triangles' size are rounding.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Overlap:
    """area_m2 : of the common parts, each pair counted · pairs : how many · at_xy : (2,) m, the
    middle of the largest, NaN without any
    """

    area_m2: float
    pairs: int
    at_xy: F64


@kernel
def are_disjoint(p: F64, q: F64) -> bool:
    """Whether two triangles (3, 3) have no area in common by their boxes, or by an edge that they
    share from its two sides.
    """
    for c in range(2):
        if max(p[0, c], p[1, c], p[2, c]) <= min(q[0, c], q[1, c], q[2, c]):
            return True
        if max(q[0, c], q[1, c], q[2, c]) <= min(p[0, c], p[1, c], p[2, c]):
            return True
    for i in range(3):
        a, b = p[i], p[(i + 1) % 3]
        for j in range(3):
            c, d = q[j], q[(j + 1) % 3]
            if a[0] == d[0] and a[1] == d[1] and b[0] == c[0] and b[1] == c[1]:
                return True
    return False


@kernel
def overlap_kernel(corners: F64, boxes: F64, rounding_m: float) -> tuple[float, int, F64]:
    """See :func:`overlaps`; corners (m, 3, 3) counter-clockwise in the order of the boxes."""
    m = len(corners)
    w, stack, box = np.zeros((ROWS, CORNERS)), np.empty(128, np.int64), np.empty(4)
    found: I64 = np.empty(256, np.int64)
    total, largest, pairs, at = 0.0, 0.0, 0, np.full(2, np.nan)
    for t in range(m):
        x0, y0, long = corners[t, 0, 0], corners[t, 0, 1], 0.0
        box[0], box[1], box[2], box[3] = x0, y0, x0, y0
        for k in range(1, 3):
            box[0], box[1] = min(box[0], corners[t, k, 0]), min(box[1], corners[t, k, 1])
            box[2], box[3] = max(box[2], corners[t, k, 0]), max(box[3], corners[t, k, 1])
        long = max(box[2] - box[0], box[3] - box[1])
        count = search_boxes(boxes, m, box, stack, found)
        if count > len(found):
            found = np.empty(2 * count, np.int64)
            count = search_boxes(boxes, m, box, stack, found)
        for k in range(3):
            w[A, k], w[A + 1, k] = corners[t, k, 0] - x0, corners[t, k, 1] - y0
        for i in range(count):
            o = found[i]
            if o <= t or are_disjoint(corners[t], corners[o]):
                continue
            for k in range(3):
                w[B, k], w[B + 1, k] = corners[o, k, 0] - x0, corners[o, k, 1] - y0
            s, n, _ = clip_pair(w)
            area, cx, cy = 0.0, 0.0, 0.0
            for k in range(n):
                j = k + 1 if k + 1 < n else 0
                area += 0.5 * (w[s, k] * w[s + 1, j] - w[s, j] * w[s + 1, k])
                cx, cy = cx + w[s, k], cy + w[s + 1, k]
            if area > (ROUNDING * long + rounding_m) * long:
                total, pairs = total + area, pairs + 1
                if area > largest:
                    largest, at[0], at[1] = area, x0 + cx / n, y0 + cy / n
    return total, pairs, at


def overlaps(tin: Tin) -> Overlap:
    """What the relevant triangles, counter-clockwise, have in common in plan."""
    index = triangle_index(tin, tin.relevant)
    corners = placed_corners(tin.vertices, tin.triangles, index.order)
    step = 4.0 * float(np.spacing(np.abs(tin.vertices[:, :2]).max()))
    area, pairs, at = overlap_kernel(corners, index.boxes, step)
    return Overlap(float(area), int(pairs), np.asarray(at))
