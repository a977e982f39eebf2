"""What lies beyond the outline of a body whose toe runs out thinly.

An outline drawn where a surface meets the noise of its ground leaves the rest of a thin toe
outside. Just inside it the profile of a toe that falls in proportion to its height, as the tail of
a dune or of what rain has washed out, is ``h exp(x / L)``, and ``h L`` lies beyond each metre of
outline. The height h at the outline is that of a parabola through the heights of a band, and L is
such that the exponential has their mean. A sharp toe has h = 0; an outline that goes beyond it runs
over ground that is level, or rises outwards.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from ladar_volume.clouds.cloud_noise import nearest_in_plane
from ladar_volume.model.records import F64, Bool, Tin
from ladar_volume.tin.boundary import border
from ladar_volume.tin.full_tin import footprint_areas, vertex_mask

#: The band of the profile, in radii of a disc of the outline's area, and fewest points in it.
BAND, FEWEST = 0.35, 60
#: Vertices of a body that tell its profile; of more, evenly many are left out.
ENOUGH = 30_000
#: Places on each side of the outline.
PARTS = 9
#: A height at the outline is one beyond so many standard deviations.
CHANCE = 2.0
#: Mean over height at the outline where it falls over one band; from where on the height is none.
E_1, MOST = math.e - 1.0, 1e6


def volume_beyond(tin: Tin, mask: Bool, height: F64) -> float:
    """Volume, m³, that a thin toe of the triangles (m,) of a body holds beyond its outline; height
    (n,) m of the vertices above the base. 0 where too few points show the profile, or it is sharp.
    """
    ends, length, is_open = border(tin, mask)
    ends, length = ends[~is_open], length[~is_open]
    area = float(footprint_areas(tin.vertices, tin.triangles[mask]).sum())
    body = np.flatnonzero(vertex_mask(tin, mask))
    body = body[:: step_of(len(body))]
    a, b = (tin.vertices[ends[:, k], :2] for k in range(2))
    line = Outline(a, b, float(length.sum()), area)
    return beyond_profile(line, tin.vertices[body, :2], height[body])


class Outline(NamedTuple):
    """Where the surface goes on beyond a body: a, b (s, 2) m, ends of the sides · length_m : of all
    of them · area_m2 : of the body
    """

    a: F64
    b: F64
    length_m: float
    area_m2: float


def step_of(count: int) -> int:
    """Every how many of so many vertices the profile is told from."""
    return max(1, count // ENOUGH)


def beyond_profile(outline: Outline, xy: F64, height: F64) -> float:
    """The same from some vertices of the body: xy (n, 2) m, height (n,) m above the base."""
    if not len(outline.a) or not outline.area_m2 > 0.0:
        return 0.0
    band = BAND * math.sqrt(outline.area_m2 / math.pi)
    part = np.linspace(0.0, 1.0, PARTS)[:, None, None]
    line = ((1.0 - part) * outline.a + part * outline.b).reshape(-1, 2)
    d = nearest_in_plane(line, xy, 1)[1][:, 0]
    near = d < band
    if np.count_nonzero(near) < FEWEST:
        return 0.0
    x, h = d[near] / band, height[near]
    X = np.stack([np.ones_like(x), x, x * x], axis=1)
    fit, _, rank, _ = np.linalg.lstsq(X, h, rcond=1e-6)
    if rank < 3:  # two rows of a grid show no parabola
        return 0.0
    scatter = float(np.sum((h - X @ fit) ** 2)) / (len(x) - 3)
    sigma = np.sqrt(np.diag(np.linalg.inv(X.T @ X)) * scatter)
    up = math.copysign(1.0, fit[0])
    edge, rise, mean = up * fit[0], up * fit[1], up * (fit @ (1.0, 1.0 / 2.0, 1.0 / 3.0))
    if edge <= CHANCE * sigma[0] or rise < -CHANCE * sigma[1] or mean <= edge:
        return 0.0
    steep = mean / edge
    # a fall of less than one band is none of a toe; a height of nothing is none either
    falls = brentq(lambda y: math.expm1(y) / y - steep, 1.0, 60.0) if E_1 < steep < MOST else 1.0
    return outline.length_m * float(edge) * band / falls if steep < MOST else 0.0
