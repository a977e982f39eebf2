"""Four pits with exact volumes, two of them overhanging: volume to a free pole, and what a missing
boundary ring costs.

The ground before and after is sampled on its faces and, four times as densely, on its creases, so
that a triangulation through the points is the exact surface.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.truth import F64
from ladar_volume.change.sight_ring import ring_over
from ladar_volume.change.spherical_tin import build_spherical
from ladar_volume.change.two_surfaces import published_difference, two_surfaces


def quad(corners: Any, h: float) -> F64:
    """Points on a plane quadrangle (4, 3): its edges at steps of h / 4, its inside at steps of
    h.
    """
    c = np.asarray(corners, dtype=float)
    size = (
        max(np.linalg.norm(c[1] - c[0]), np.linalg.norm(c[3] - c[2])),
        max(np.linalg.norm(c[2] - c[1]), np.linalg.norm(c[0] - c[3])),
    )
    nu, nv = (max(2, int(np.ceil(s / h))) for s in size)
    u, v = (g.ravel()[:, None] for g in np.meshgrid(np.arange(1, nu) / nu, np.arange(1, nv) / nv))
    inside = (1 - v) * ((1 - u) * c[0] + u * c[1]) + v * ((1 - u) * c[3] + u * c[2])
    edges = []
    for a, b in zip(c, np.roll(c, -1, axis=0), strict=True):
        n = max(2, int(np.ceil(4 * np.linalg.norm(b - a) / h)))
        edges.append(a + (b - a) * np.linspace(0, 1, n, endpoint=False)[:, None])
    return np.concatenate([inside, *edges])


def frame_of(opening: tuple[float, ...], margin: float) -> list[list[list[float]]]:
    """Quadrangles around a rectangular opening (x0, x1, y0, y1) at z = 0, ``margin`` wide."""
    x0, x1, y0, y1 = opening
    m = margin
    boxes = [
        (x0 - m, x1 + m, y0 - m, y0),
        (x0 - m, x1 + m, y1, y1 + m),
        (x0 - m, x0, y0, y1),
        (x1, x1 + m, y0, y1),
    ]
    return [[[a, c, 0], [b, c, 0], [b, d, 0], [a, d, 0]] for a, b, c, d in boxes]


def pit(
    opening: tuple[float, ...],
    floor: tuple[float, ...],
    depth: float,
    h: float,
    margin: float = 1.0,
) -> tuple[F64, F64, float]:
    """Points before and after a pit between a rectangular opening at z = 0 and a floor rectangle at
    −depth, and its volume.
    """
    x0, x1, y0, y1 = opening
    top = np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]], float)
    f0, f1, g0, g1 = floor
    low = np.array([[f0, g0, -depth], [f1, g0, -depth], [f1, g1, -depth], [f0, g1, -depth]], float)
    walls = [[top[i], top[(i + 1) % 4], low[(i + 1) % 4], low[i]] for i in range(4)]
    before = np.unique(
        np.concatenate([quad(q, h) for q in frame_of(opening, margin)] + [quad(top, h)]).round(12),
        axis=0,
    )
    after = np.unique(
        np.concatenate([quad(q, h) for q in [*frame_of(opening, margin), low, *walls]]).round(12),
        axis=0,
    )
    a, b = (x1 - x0) * (y1 - y0), (f1 - f0) * (g1 - g0)
    middle = 0.25 * (x1 - x0 + f1 - f0) * (y1 - y0 + g1 - g0)
    return before, after, depth / 6.0 * (a + 4.0 * middle + b)


#: opening, floor, depth, scanner: upright walls, sloping walls, one wall overhanging by 27°, a slit
#: leaning by 45°.
PITS: dict[str, Any] = {
    "box": ((0, 4, 0, 2), (0, 4, 0, 2), 2.0, (2.0, 1.0, 1.5)),
    "frustum": ((0, 5, 0, 4), (1, 4, 1, 3), 2.0, (2.5, 2.0, 1.5)),
    "overhang": ((0, 3, 0, 3), (-1, 2, 0, 3), 2.0, (2.9, 1.5, 0.8)),
    "slit": ((0, 2, 0, 3), (-1.5, 0.5, 0.2, 2.8), 1.5, (1.9, 1.5, 0.6)),
}


def rim(opening: tuple[float, ...], margin: float) -> F64:
    """The polygon (4, 2) at a distance from an opening."""
    x0, x1, y0, y1 = opening
    return np.array(
        [
            [x0 - margin, y0 - margin],
            [x1 + margin, y0 - margin],
            [x1 + margin, y1 + margin],
            [x0 - margin, y1 + margin],
        ],
        float,
    )


def without_ring(after: F64, opening: tuple[float, ...], margin: float = 1.0) -> F64:
    """The points of a pit without the outermost of the ground, at more than nine tenths of the
    margin.
    """
    x0, x1, y0, y1 = opening
    m = 0.9 * margin
    beyond = (
        (after[:, 0] < x0 - m)
        | (after[:, 0] > x1 + m)
        | (after[:, 1] < y0 - m)
        | (after[:, 1] > y1 + m)
    )
    return after[~((after[:, 2] == 0) & beyond)]


def run(spacings: tuple[float, ...] = (0.2, 0.1)) -> dict[str, float | int | str]:
    """Errors in % of each pit's volume: over the common ring with all points and without the
    outermost, and the published way without.
    """
    out: dict[str, float | int | str] = {}
    for h in spacings:
        for name, (opening, floor, depth, scanner) in PITS.items():
            before, after, truth = pit(opening, floor, depth, h)
            eye, ring = np.array(scanner), ring_over(rim(opening, 0.4), 3.0, h)
            part = without_ring(after, opening)
            found, without = (two_surfaces(before, b, ring, eye, eye) for b in (after, part))
            cost = published_difference(
                build_spherical(before, eye), build_spherical(part, eye), eye
            )
            key = f"{name}, points at {100 * h:g} cm"
            out[f"{key}: error over the common ring, %"] = 100.0 * (found.removed_m3 / truth - 1.0)
            out[f"{key}: the same without the outermost points of B, %"] = 100.0 * (
                without.removed_m3 / truth - 1.0
            )
            out[f"{key}: largest change over nine poles, relative"] = found.pole_spread_m3 / truth
            out[f"{key}: published, without the outermost points of B, %"] = 100.0 * (
                cost / truth - 1.0
            )
    return out
