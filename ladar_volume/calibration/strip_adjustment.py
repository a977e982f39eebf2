"""Least squares over all patches: calibration and navigation errors as unknowns with priors, the
planes eliminated.

A point's height above its plane is ``e + a_cal·theta + a_nav·y − X beta = noise``. With rows over
sigma and ``Q`` an orthonormal basis of each patch's design, the planes drop out (Schur complement):
``N = AᵀA − (QᵀA)ᵀ(QᵀA) + prior``.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from ladar_volume.calibration.navigation_drift import Drift
from ladar_volume.calibration.strip_patches import Overlap
from ladar_volume.georeference.point_jacobian import (
    PointGeometry,
    beam_jacobian,
    calibration_jacobian,
)
from ladar_volume.model.records import CAL_COLUMNS, F64, I64, MappedPoints, select

_CHUNK = 65_536


@dataclass(frozen=True)
class Observations:
    """Rows over sigma, in order of their navigation knots.

    e : (n,) heights · shared_jacobian : (n, 11), own_jacobian : (n, 2) to the calibration shared by
    all beams and to the point's own · ring : (n,) · nav : (n, 6) · knot : (n,) ascending, share :
    (n,) · Q : (n, 3) · patch, group : (n,) · scale : (n,) 1 / sigma, 1/m
    """

    e: F64
    shared_jacobian: F64
    own_jacobian: F64
    ring: I64
    nav: F64
    knot: I64
    share: F64
    Q: F64
    patch: I64
    group: I64
    scale: F64

    def blocks(self, columns: I64, beams: int) -> Iterator[tuple[slice, I64, F64]]:
        """Points of one knot interval at a time: their rows, the unknowns they touch, and the
        design (k, c) on those.
        """
        edges = np.append(np.flatnonzero(np.diff(self.knot, prepend=-1)), len(self.knot))
        for lo, hi in itertools.pairwise(edges.tolist()):
            part = slice(lo, hi)
            full = np.zeros((hi - lo, len(CAL_COLUMNS) + 2 * beams))
            full[:, : len(CAL_COLUMNS)] = self.shared_jacobian[part]
            rows = np.arange(hi - lo)
            full[rows, len(CAL_COLUMNS) + self.ring[part]] = self.own_jacobian[part, 0]
            full[rows, len(CAL_COLUMNS) + beams + self.ring[part]] = self.own_jacobian[part, 1]
            f = self.share[part, None]
            design = np.hstack([full[:, columns], self.nav[part] * (1.0 - f), self.nav[part] * f])
            first = len(columns) + 6 * int(self.knot[lo])
            yield (
                part,
                np.concatenate([np.arange(len(columns)), np.arange(first, first + 12)]),
                design,
            )


def observations(
    points: MappedPoints, geometry: PointGeometry, found: Overlap, drift: Drift, sigma: F64
) -> Observations:
    """Observations of the points on patches; sigma (n,) m is the noise of every one of ``points``
    along its patch's normal.
    """
    knot, share = drift.place(points.t_ns[found.point])
    order = np.argsort(knot, kind="stable")
    index, patch = found.point[order], found.patch[order]
    normal, scale = found.steady[patch], 1.0 / sigma[order]
    shared, own, nav = (
        np.empty((len(index), len(CAL_COLUMNS))),
        np.empty((len(index), 2)),
        np.empty((len(index), 6)),
    )
    for start in range(0, len(index), _CHUNK):  # the Jacobians take half a kilobyte per point
        part = slice(start, start + _CHUNK)
        g, n = select(geometry, index[part]), normal[part]
        shared[part] = np.einsum("ni,nij->nj", n, calibration_jacobian(g))
        own[part] = np.einsum("ni,nij->nj", n, beam_jacobian(g))
        nav[part] = drift.rows(n, g)
    X = found.X[order] * scale[:, None]
    gram = np.stack(
        [np.bincount(patch, X[:, a] * X[:, b]) for a in range(3) for b in range(3)], axis=1
    ).reshape(-1, 3, 3)
    Q = np.einsum("nij,nj->ni", np.linalg.inv(np.linalg.cholesky(gram))[patch], X)
    s = scale[:, None]
    return Observations(
        found.height[order] * scale,
        shared * s,
        own * s,
        points.ring[index].astype(np.int64),
        nav * s,
        knot[order],
        share[order],
        Q,
        patch,
        found.group[order],
        scale,
    )


@dataclass(frozen=True)
class Solution:
    """x : (u,) unknowns, calibration first · C : (c, c) their covariance, calibration only · chi2 :
    minimum of the sum of squares, priors included · freedom : of chi2 · residual : (n,) over sigma
    """

    x: F64
    C: F64
    chi2: float
    freedom: int
    residual: F64


def solve(
    o: Observations, drift: Drift, columns: I64, beams: int, precision: F64, theta: F64
) -> Solution:
    """One step: unknowns are the calibration ``columns`` (c,), counted from theta (c,) at which the
    observations were made, with prior mean −theta and ``precision`` (c, c), and the navigation's
    knots.
    """
    c, patches = len(columns), int(o.patch.max()) + 1
    size = c + drift.unknowns
    N, g = np.zeros((size, size)), np.zeros(size)
    G, h = (
        np.zeros((3, patches, size)),
        np.stack([np.bincount(o.patch, o.Q[:, a] * o.e, patches) for a in range(3)]),
    )
    for part, at, design in o.blocks(columns, beams):
        N[np.ix_(at, at)] += design.T @ design
        g[at] += design.T @ o.e[part]
        touched, local = np.unique(o.patch[part], return_inverse=True)
        for a in range(3):
            spread = sparse.csr_matrix(
                (o.Q[part, a], (local, np.arange(len(local)))), shape=(len(touched), len(local))
            )
            G[a][np.ix_(touched, at)] += np.asarray(spread @ design)
    flat = G.reshape(-1, size)
    N -= flat.T @ flat
    g -= flat.T @ h.ravel()
    N[:c, :c] += precision
    g[:c] += precision @ theta
    N[c:, c:] += drift.prior()
    constant = float(o.e @ o.e - (h * h).sum() + theta @ precision @ theta)
    factor = cho_factor(N)
    x = -cho_solve(factor, g)
    C = cho_solve(factor, np.eye(size)[:, :c])[:c]
    residual = o.e.copy()
    for part, at, design in o.blocks(columns, beams):
        residual[part] += design @ x[at]
    return Solution(
        x, 0.5 * (C + C.T), constant + float(g @ x), len(o.e) - 3 * patches, off_plane(o, residual)
    )


def off_plane(o: Observations, values: F64) -> F64:
    """Values (n,) over sigma less what a plane per patch takes of them."""
    out = values.copy()
    for a in range(3):
        out -= o.Q[:, a] * np.bincount(o.patch, o.Q[:, a] * values)[o.patch]
    return out


def drop_patches(o: Observations, patches: I64) -> Observations:
    """The observations less those on some patches, patches and groups numbered anew."""
    kept = select(o, ~np.isin(o.patch, patches))
    patch, group = (np.unique(label, return_inverse=True)[1] for label in (kept.patch, kept.group))
    return dataclasses.replace(kept, patch=patch, group=group)
