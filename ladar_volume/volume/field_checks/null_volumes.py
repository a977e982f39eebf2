"""Null volumes: the outline laid on ground where nothing stands must give zero.

Outlines of the shape of the body's, whole or smaller, are laid side by side on the seen ground
around it. The base is fitted without the ground under each, as it is for the body, and predicts
it. What is above it is a null volume. Its variance is known from the field of the ground's
residuals (:mod:`ladar_volume.uncertainty.ground_field`), as that of the line ``base_surface`` is:
where the null volumes spread more, so does the base.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.special import chdtrc

from ladar_volume.ground.polynomial import (
    base_height,
    degree_of,
    design,
)
from ladar_volume.model.records import F64, Bool, Plane, Tin
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.full_tin import vertex_mask
from ladar_volume.uncertainty.ground_field import GroundField, Roughness

#: Sizes of the outlines, the first of which so many find room side by side, and the most of these.
SIZES, ENOUGH, MOST = (1.0, 0.7, 0.5, 0.35, 0.25), 6, 12
#: Cells of the grid along the longer side of the ground, and along an outline at least.
CELLS, ACROSS = 56, 8.0
#: Fewest points of ground under an outline, and most points of ground that are asked.
FEWEST, POINTS = 20, 4000
#: Probability from which down the spread speaks against the base's line, and below which it
#: refutes it; below which it is a doubt, and how much larger its variance then is at least.
SPEAKS, REFUTED, DOUBTED, LEAST = 0.2, 0.05, 1e-3, 2.25


class NullVolumes(NamedTuple):
    """height_m, sigma_m : (k,) mean heights of the ground above the base under each outline, and
    what is predicted · size : of the outlines over the body's
    """

    height_m: F64
    sigma_m: F64
    size: float

    @property
    def factor(self) -> float:
        """How much larger than predicted the mean square is; at most k independent ones."""
        return float(np.mean((self.height_m / self.sigma_m) ** 2)) if len(self.height_m) else 1.0

    @property
    def p_value(self) -> float:
        """Probability of so large a spread by chance."""
        k = len(self.height_m)
        return float(chdtrc(k, k * self.factor)) if k else 1.0

    @property
    def scale(self) -> float:
        """By how much the variance of the base's line is too small: 1 where nothing says so, the
        factor where the line is refuted, and in proportion to the probability between.
        """
        share = min(max((SPEAKS - self.p_value) / (SPEAKS - REFUTED), 0.0), 1.0)
        return 1.0 + share * max(0.0, self.factor - 1.0)


def shape_of(xy: F64, cell_m: float) -> Bool:
    """The cells (a, b), a and b odd, that an outline around points xy (n, 2) covers, about 0."""
    half = [math.ceil(float(np.abs(c).max()) / cell_m) for c in xy.T]
    out = np.zeros((2 * half[0] + 1, 2 * half[1] + 1), np.bool_)
    i, j = (np.rint(c / cell_m).astype(np.int64) + k for c, k in zip(xy.T, half, strict=True))
    out[i, j] = True
    return np.asarray(ndimage.binary_fill_holes(out), np.bool_)


def places(ground: Bool, shape: Bool) -> list[tuple[int, int]]:
    """Middles of outlines of a shape (a, b) side by side on the cells of the ground (c, d), the
    nearest to the middle of the ground first.
    """
    if shape.shape[0] > ground.shape[0] or shape.shape[1] > ground.shape[1]:
        return []
    free, found = ndimage.binary_erosion(ground, shape), []
    i, j = np.nonzero(free)
    far = (i - 0.5 * ground.shape[0]) ** 2 + (j - 0.5 * ground.shape[1]) ** 2
    taken = np.zeros_like(ground)
    half = shape.shape[0] // 2, shape.shape[1] // 2
    for n in np.argsort(far, kind="stable"):
        a, b = int(i[n]), int(j[n])
        window = taken[a - half[0] : a + half[0] + 1, b - half[1] : b + half[1] + 1]
        if (window & shape).any():
            continue
        window |= shape
        found.append((a, b))
        if len(found) == MOST:
            break
    return found


def outlines_on_ground(
    tin: Tin, inside_m2: F64, xy: F64, near_m: float
) -> tuple[list[Bool], float]:
    """Which of the ground's points xy (n, 2) lie under each outline (n,), and the size of these.
    near_m : points no further apart are of one ground.
    """
    own = tin.vertices[vertex_mask(tin, inside_m2 > 0.0), :2]
    own = own - [0.5 * (c.min() + c.max()) for c in own.T]
    low = np.array([c.min() for c in xy.T])
    extent = max(float(np.ptp(c)) for c in xy.T)
    for size in SIZES:
        wide = size * math.sqrt(float(inside_m2.sum()))
        cell = max(extent / CELLS, min(near_m, wide / ACROSS))
        at = ((xy - low) / cell).astype(np.int64)
        ground = np.zeros([int(c.max()) + 1 for c in at.T], np.bool_)
        ground[at[:, 0], at[:, 1]] = True
        ground = ndimage.binary_closing(ground, iterations=max(1, math.ceil(near_m / cell)))
        shape, found = shape_of(size * own, cell), []
        half = shape.shape[0] // 2, shape.shape[1] // 2
        for a, b in places(ground, shape):
            i, j = at[:, 0] - a + half[0], at[:, 1] - b + half[1]
            under = (i >= 0) & (i < shape.shape[0]) & (j >= 0) & (j < shape.shape[1])
            under[under] = shape[i[under], j[under]]
            if np.count_nonzero(under) >= FEWEST:
                found.append(under)
        if len(found) >= ENOUGH:
            return found, size
    return [], 0.0


def null_volumes(
    tin: Tin, base: Plane, inside_m2: F64, height_variance: F64, rough: Roughness
) -> NullVolumes:
    """The null volumes around an outline, inside_m2 (m,) m² of each triangle; none where the ground
    has no room for six. height_variance : (n,) m² of the vertices · rough : the ground's field.
    """
    step = max(1, math.ceil(len(base.support) / POINTS))
    some, apart = base.support[::step], math.sqrt(step) * rough.spacing_m
    xy = tin.vertices[some, :2]
    e = tin.vertices[some, 2] - base_height(base, xy)
    noise = height_variance[some]
    found, size = outlines_on_ground(tin, inside_m2, xy, 2.0 * apart)
    # half a length of the field is a cell fine enough
    coarse = dataclasses.replace(rough, spacing_m=max(apart, 0.5 * rough.length_m))
    X = design((xy - xy.mean(axis=0)) / max(float(np.ptp(xy)), 1e-9), np.zeros(2), degree_of(base))
    normal, heights, sigmas = X.T @ X, [], []
    for under in found:
        own, w = X[under], np.where(under, 1.0 / np.count_nonzero(under), 0.0)
        fit = np.linalg.lstsq(normal - own.T @ own, own.mean(axis=0), rcond=1e-12)[0]
        w[~under] = -X[~under] @ fit
        field = GroundField(tin.vertices, tin.triangles[:0], np.zeros(0), xy, w, coarse)
        heights.append(float(w @ e))
        sigmas.append(math.sqrt(field.variance_m6 + float(w**2 @ noise)))
    keep = np.asarray(sigmas) > 0.0
    return NullVolumes(np.asarray(heights)[keep], np.asarray(sigmas)[keep], size)


def null_volume_doubts(found: NullVolumes, area_m2: float, sigma_m3: float) -> list[Doubt]:
    """The base is not what it was fitted as. sigma_m3 : of its line, before it is scaled."""
    if found.p_value >= DOUBTED or found.factor < LEAST:
        return []
    rms = area_m2 * math.sqrt(float(np.mean(found.height_m**2)))
    words = (
        f"{len(found.height_m)} outlines laid on ground where nothing stands give up to "
        f"{1e3 * float(np.abs(found.height_m).max()):.2g} mm instead of zero, {rms:.3g} m³ over "
        f"the area of the body, {math.sqrt(found.factor):.2g} times what its roughness explains "
        f"(p = {found.p_value:.1g}); the line base_surface was {sigma_m3:.2g} m³ and is larger "
        "by that: set ground.degree or volume.ground_ring_m, or survey the empty site"
    )
    return [Doubt("null_volumes", words, found.factor)]
