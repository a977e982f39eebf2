"""The heights of a surface along the outline of a pile: its toe line."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ladar_volume.change.surface_difference import interpolation
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, Bool, Tin
from ladar_volume.tin.locate import TriangleIndex, height_at, triangle_index
from ladar_volume.tin.relevant import edge_lengths

#: Most places along an outline.
MOST = 1200
#: Share of an outline that must have a surface below it.
LEAST_SEEN = 0.5


@dataclass(frozen=True)
class ToeLine:
    """xy : (t, 2) m, places along the outline, its corners among them · at_m : (t,) distance along
    it · length_m : (t,) length that each place stands for, 0 where there is no surface · height_m :
    (t,) of the surface; between their neighbours where there is none · by_vertex : (t, n) shares of
    the vertices in these heights · seen : (t,) whether there is a surface · outward_m : (t,) by how
    much the surface is higher on the line than one usual edge outside it, beyond the tilt of the
    whole line: what the heights depend on where exactly the outline was drawn
    """

    xy: F64
    at_m: F64
    length_m: F64
    height_m: F64
    by_vertex: csr_array
    seen: Bool
    outward_m: F64


@dataclass(frozen=True)
class PlacedSurface:
    """A surface whose heights are asked at many places. spacing_m : usual length of the edges of
    the triangles that count · index : of these
    """

    tin: Tin
    spacing_m: float
    index: TriangleIndex

    @classmethod
    def of(cls, tin: Tin) -> PlacedSurface:
        """What is asked for again and again, told once."""
        spacing_m = float(np.median(edge_lengths(tin)[tin.relevant]))
        return cls(tin, spacing_m, triangle_index(tin, tin.relevant))


def places_along(ring: F64, step_m: float) -> tuple[F64, F64]:
    """Places (t, 2), m, along a ring (k, 2), its corners and as many between them as keep them
    within ``step_m``; and their distances (t,) m along it.
    """
    out = []
    for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        count = max(1, math.ceil(float(np.hypot(*(b - a))) / step_m))
        out.append(a + (b - a) * (np.arange(count) / count)[:, None])
    xy = np.concatenate(out)
    step = np.hypot(*(np.roll(xy, -1, axis=0) - xy).T)
    return xy, np.r_[0.0, np.cumsum(step)[:-1]]


def perimeter(ring: F64) -> float:
    """Length, m, of a ring (k, 2)."""
    return float(np.hypot(*(np.roll(ring, -1, axis=0) - ring).T).sum())


def toe_line(surface: PlacedSurface, ring: F64, step_m: float = 0.0) -> ToeLine:
    """The toe line along a ring (k, 2), m; step_m : most between its places, by default the usual
    edge of the surface, no shorter than makes :data:`MOST` of them. Raises :class:`VolumeError`
    (pile_toe) where most of the outline lies beyond the surface.
    """
    tin, step = surface.tin, step_m or max(surface.spacing_m, perimeter(ring) / MOST)
    xy, at = places_along(ring, step)
    corner, weight, seen = interpolation(tin, xy, surface.index)
    if np.count_nonzero(seen) < max(3.0, LEAST_SEEN * len(seen)):
        share = 100.0 * np.count_nonzero(seen) / len(seen)
        raise VolumeError(
            f"{share:.0f} % of the outline lie above the surface: no toe line can be read; draw it "
            "within what was surveyed, or choose a base that is not made from it",
            reason="pile_toe",
            value=share,
        )
    t, n = len(xy), len(tin.vertices)
    rows = np.repeat(np.arange(t), 3)
    B = csr_array((weight.ravel(), (rows, corner.ravel())), shape=(t, n))
    B = csr_array(gap_weights(at, perimeter(ring), seen) @ B)
    step_to = np.diff(np.r_[at, perimeter(ring)])
    length = np.where(seen, 0.5 * (step_to + np.roll(step_to, 1)), 0.0)
    height = np.asarray(B @ tin.vertices[:, 2])
    higher = np.where(seen, rise_inward(surface, xy, height, length), 0.0)
    return ToeLine(xy, at, length, height, B, seen, higher)


def rise_inward(surface: PlacedSurface, xy: F64, height_m: F64, length_m: F64) -> F64:
    """By how much (t,) m a surface is higher at places (t, 2) along a closed line,
    counter-clockwise, than one usual edge outside, beyond the plane through the line; 0 where there
    is no surface outside.
    """
    ahead = np.roll(xy, -1, axis=0) - np.roll(xy, 1, axis=0)
    size = np.hypot(*ahead.T)
    normal = np.column_stack([ahead[:, 1], -ahead[:, 0]]) / np.where(size > 0.0, size, 1.0)[:, None]
    out = xy + surface.spacing_m * normal
    w = np.sqrt(length_m)
    X = np.column_stack([np.ones(len(xy)), xy - xy.mean(axis=0)])
    slope = np.linalg.lstsq(X * w[:, None], w * height_m, rcond=None)[0][1:]
    rise: F64 = height_m - height_at(surface.tin, out, surface.index) + (out - xy) @ slope
    return np.where(np.isfinite(rise), rise, 0.0)


def gap_weights(at_m: F64, around_m: float, seen: Bool) -> csr_array:
    """Weights (t, t) that take places along a closed line at distances (t,) m over from the nearest
    seen ones on either side, linear between them.
    """
    t, rows = len(at_m), np.arange(len(at_m))
    own = rows[seen]
    place = np.searchsorted(own, rows, side="right")
    before, after = own[place - 1], own[place % len(own)]
    behind = (at_m - at_m[before]) % around_m
    ahead = (at_m[after] - at_m) % around_m
    # a single seen place before and after itself: all of it
    total = np.where(behind + ahead > 0.0, behind + ahead, 1.0)
    to_after = np.where(seen, 0.0, behind / total)
    data = np.r_[1.0 - to_after, to_after]
    return csr_array((data, (np.r_[rows, rows], np.r_[before, after])), shape=(t, t))
