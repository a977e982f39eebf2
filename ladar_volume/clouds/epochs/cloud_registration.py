"""A later cloud laid on an earlier one by what did not change between them.

``icp`` turns and shifts it (:mod:`ladar_volume.registration.icp`: point to plane, residuals of a
cell correlated). Points in cells where the surfaces are not alike are left out, and told again
after each refinement: the flank of a pile that grew would draw the whole cloud. ``height`` lifts
it by what the surfaces differ by where they are alike, which is all that level ground can tell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.change.epoch_change import within_outline
from ladar_volume.change.surface_difference import difference
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.sampling.pair_registration import (
    CHANCE,
    UnchangedPart,
    cell_means,
    unchanged_cells,
)
from ladar_volume.model.errors import RegistrationError, VolumeError
from ladar_volume.model.records import F64, I32, I64, Tin
from ladar_volume.model.verdict import Doubt
from ladar_volume.registration.icp import IDENTITY, IcpResult, refine
from ladar_volume.registration.transform import Transform
from ladar_volume.tin.full_tin import footprint_areas

#: Partners are searched within so many spacings; points that are asked, at most; cells along the
#: site within which residuals may be correlated.
REACH, ASKED, CELLS = 20.0, 50_000, 25.0
#: Points of the earlier surface, at most, and neighbours that tell the normal of each.
HELD, NEIGHBOURS = 200_000, 40
#: Least mean square of slopes, over that of their noise; least share of the points that agree.
SHAPE, LEAST_OVERLAP = 3.0, 0.4
#: Refinements, each among the points that are alike after the one before; where fewer than this
#: share are, all are asked.
PASSES, LEAST_SAME = 4, 0.15


@dataclass(frozen=True)
class Registration:
    """How a later cloud was moved. transform : to the earlier one's frame, with its covariance ·
    how : ``icp``, ``height`` or the name of a file · facts : as plain values · doubts : about it
    """

    transform: Transform
    how: str
    facts: dict[str, Any]
    doubts: tuple[Doubt, ...] = ()


def spacing_of(surface: CloudSurface) -> float:
    """How far apart the vertices of a surface lie, m: the side of the square that each has."""
    tin = surface.representation.tin
    area = float(footprint_areas(tin.vertices, tin.triangles[tin.relevant]).sum())
    return math.sqrt(2.0 * area / max(int(np.count_nonzero(tin.relevant)), 1))


class Normals(NamedTuple):
    """unit : (n, 3), upward · sigma : (n,) of their horizontal components for noise of 1 m"""

    unit: F64
    sigma: F64


def plane_normals(points: F64) -> Normals:
    """Normals of the planes through the neighbours of points (n, 3): of so many that the noise
    tilts them little, which would draw the fit towards no motion at all.
    """
    k = min(NEIGHBOURS, len(points))
    near = points[np.asarray(cKDTree(points[:, :2]).query(points[:, :2], k)[1]).reshape(-1, k)]
    d = near - near.mean(axis=1, keepdims=True)
    xx, xy, yy = (np.einsum("nk,nk->n", d[..., i], d[..., j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    xz, yz = (np.einsum("nk,nk->n", d[..., i], d[..., 2]) for i in (0, 1))
    scale = np.maximum(xx * yy - xy * xy, 1e-300)
    normal = np.column_stack(
        [-(yy * xz - xy * yz) / scale, -(xx * yz - xy * xz) / scale, np.ones(len(points))]
    )
    unit = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return Normals(unit, np.sqrt(0.5 * (xx + yy) / scale))


def check_shape(normals: Normals, used: I64, noise_m: float) -> None:
    """Raises :class:`RegistrationError` (icp_level) where the slopes of the points ``used`` (k,)
    are those that noise alone gives level ground: they tell no shift sideways.
    """
    n, own = normals.unit[used, :2], float(np.mean((normals.sigma[used] * noise_m) ** 2))
    least = float(np.linalg.eigvalsh(np.cov(n.T))[0] if len(n) > 2 else 0.0)
    if least < SHAPE * own:
        words = "the ground that did not change is level within its noise, and tells no shift aside"
        raise RegistrationError(words, reason="icp_level", value=least)


def used_rows(triangles: I32, most: int) -> I64:
    """Vertices of triangles (m, 3), at most so many of them, evenly."""
    rows = np.unique(triangles).astype(np.int64)
    return rows[:: max(1, math.ceil(len(rows) / most))]


def at_origin(T: Transform | None, middle: F64) -> Transform:
    """A transform of coordinates about ``middle`` (3,) m as one of the map's own."""
    return IDENTITY if T is None else replace(T, t=T.t + middle, pivot=T.pivot + middle)


def alike(new: Tin, previous: Tin, points: F64, T: Transform) -> F64:
    """Those of the later surface's points (n, 3) that lie in cells where the two surfaces are
    alike, once it is moved; all of them where that cannot be told.
    """
    try:
        upper = replace(new, vertices=T.apply(new.vertices))
        tin = difference(upper, previous).common()
    except VolumeError:  # not yet on each other
        return points
    cells = cell_means(tin)
    found = unchanged_cells(cells)
    if found is None:
        return points
    same = np.abs(cells.mean - found.offset_m) <= CHANCE * found.scatter_m
    at = np.floor((T.apply(points)[:, :2] - cells.low) / cells.side).astype(np.int64)
    names = cells.cell[same] @ [1 << 32, 1]
    out: F64 = points[np.isin(at @ [1 << 32, 1], names)]
    return out if len(out) >= LEAST_SAME * len(points) else points


def by_icp(
    new: CloudSurface, previous: CloudSurface, reach_m: float | None, stable: F64 | None = None
) -> Registration:
    """The later surface turned and shifted onto the earlier one; stable : (c, 2) m, corners of
    ground that did not change, None to look for it. Raises :class:`RegistrationError` where the
    ground leaves a motion undetermined.
    """
    one, two = new.representation.tin, previous.representation.tin
    reach = REACH * max(spacing_of(new), spacing_of(previous)) if reach_m is None else reach_m
    asked = within_outline(one, stable)
    source = one.vertices[used_rows(one.triangles[asked.relevant], ASKED)]
    target = used_rows(two.triangles[two.relevant], HELD)
    middle = np.floor(two.vertices[target].mean(axis=0))  # far coordinates cost digits
    cell = float(np.ptp(source[:, :2], axis=0).max(initial=0.0)) / CELLS
    held = two.vertices[target] - middle
    normals = plane_normals(held)
    start: Transform | None = None
    try:
        for _ in range(PASSES if stable is None else 1):
            some = source
            if stable is None:
                some = alike(one, two, source, at_origin(start, middle))
            found = refine(some - middle, held, normals.unit, start, reach_m=reach, cell_m=cell)
            start = found.transform
        check_shape(normals, found.pairs[:, 1], float(np.sqrt(previous.vertex_variance.mean())))
    except RegistrationError as error:
        words = f"{error}; --register height lifts alone"
        raise RegistrationError(words, reason=error.reason, value=error.value) from error
    return as_registration(at_origin(found.transform, middle), found, source, reach)


def as_registration(T: Transform, found: IcpResult, source: F64, reach_m: float) -> Registration:
    """What was found as a registration. T : of the map's own coordinates · source : (n, 3) m,
    points of the later surface that were asked
    """
    moved, overlap = T.apply(source) - source, len(found.pairs) / len(source)
    facts = {
        "how": "icp",
        "matrix": T.matrix().tolist(),
        "moved_m": float(np.sqrt((moved**2).sum(axis=1).mean())),
        "lift_m": float(moved[:, 2].mean()),
        "sigma_rotation_rad": np.sqrt(np.diag(T.C)[:3]).tolist(),
        "sigma_shift_m": np.sqrt(np.diag(T.C)[3:6]).tolist(),
        "pairs": len(found.pairs),
        "overlap": overlap,
        "reach_m": reach_m,
        "converged": found.converged,
    }
    doubts = []
    if not found.converged:
        words = "the refinement ended before its pairs stayed the same: give --reach, or spheres"
        doubts.append(Doubt("icp_unfinished", words, float(found.rounds)))
    if overlap < LEAST_OVERLAP:
        words = (
            f"only {100 * overlap:.0f} % of the later cloud agrees with the earlier one after the "
            "refinement: more changed than stayed; give --transform, or --register height"
        )
        doubts.append(Doubt("icp_overlap", words, overlap))
    return Registration(T, "icp", facts, tuple(doubts))


def by_height(new: CloudSurface, unchanged: UnchangedPart) -> Registration:
    """The later surface lifted to where the two are alike."""
    C = np.zeros((7, 7))
    C[5, 5] = unchanged.sigma_m**2
    pivot = new.representation.tin.vertices.mean(axis=0)
    shift = np.array([0.0, 0.0, -unchanged.offset_m])
    T = replace(IDENTITY, t=pivot + shift, pivot=pivot, C=C)
    facts = {
        "how": "height",
        "matrix": T.matrix().tolist(),
        "moved_m": abs(unchanged.offset_m),
        "lift_m": -unchanged.offset_m,
        "sigma_shift_m": [0.0, 0.0, unchanged.sigma_m],
        "share": unchanged.share,
    }
    return Registration(T, "height", facts)
