"""The formulas of volumes in another form than the kernels have: divided differences, integrals
strip by strip, sparse matrices. Slow, short, and independent of what they check.
"""

import itertools

import numpy as np
from scipy import sparse

from ladar_volume.math.sparse_diagonal import diagonal_matrix, identity_matrix
from ladar_volume.volume.prismoids import positive_part

#: A step along the imaginary axis: the derivative of an analytic function, without a difference.
STEP = 1e-30
#: Gauss-Legendre on (0, 1), exact for the cubics that are met.
AT, SHARE = np.polynomial.legendre.leggauss(3)
AT, SHARE = 0.5 * (AT + 1.0), 0.5 * SHARE


def positive_mean(h):
    """Means (m,) over triangles of ``max(height, 0)`` for three different heights h (m, 3), real or
    complex: twice the divided difference of the function whose second derivative is ``max(x, 0)``
    (Hermite and Genocchi).
    """
    total = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        cube = np.where(h[:, i].real > 0.0, h[:, i], 0.0) ** 3
        total = total + cube / ((h[:, i] - h[:, j]) * (h[:, i] - h[:, k]))
    return total / 3.0


def positive_slopes(h):
    """Derivatives (m, 3) of :func:`positive_mean` by the heights (m, 3)."""
    return np.stack(
        [positive_mean(h + 1j * STEP * np.eye(3)[i]).imag / STEP for i in range(3)], axis=1
    )


def complex_gradient(function, x):
    """Derivatives (*x.shape, ...) of ``function`` of an array x, by complex steps."""
    rows = []
    for i in range(x.size):
        moved = x.astype(complex).ravel()
        moved[i] += 1j * STEP
        rows.append(np.asarray(function(moved.reshape(x.shape))).imag / STEP)
    return np.array(rows).reshape(*x.shape, *np.shape(rows[0]))


def barycentric(corners):
    """Barycentric coordinates of a triangle (3, 2) as rows (3, 3): of 1, x and y."""
    return np.linalg.inv(np.c_[np.ones(3), corners].T)


def strip_integrals(rings, functions, half=(0.0, 0.0, 0.0)):
    """Integrals (k,) of the linear functions (k, 3) of 1, x, y over the common part of simple
    polygons (n, 2) and of the half plane where ``half`` (3,) is not negative.

    The plane is cut at every x where a side begins, ends or meets another; between two of these
    the integral over y is a quadratic of x.
    """
    functions, (a, b, c) = np.asarray(functions, float), half
    sides = np.concatenate([np.stack([r, np.roll(r, -1, axis=0)], axis=1) for r in rings])
    owner = np.repeat(np.arange(len(rings)), [len(r) for r in rings])
    p, d = sides[:, 0], sides[:, 1] - sides[:, 0]
    cuts = [p[:, 0]]
    with np.errstate(all="ignore"):
        cross = d[:, None, 0] * d[None, :, 1] - d[:, None, 1] * d[None, :, 0]
        gap = p[None] - p[:, None]
        s = (gap[..., 0] * d[None, :, 1] - gap[..., 1] * d[None, :, 0]) / cross
        met = np.isfinite(s) & (s >= 0.0) & (s <= 1.0)
        cuts.append((p[:, None, 0] + s * d[:, None, 0])[met])
        s = -(a + p @ (b, c)) / (d @ (b, c))
        cuts.append((p[:, 0] + s * d[:, 0])[np.isfinite(s) & (s >= 0.0) & (s <= 1.0)])
    if b and not c:
        cuts.append([-a / b])
    x_cuts, total = np.unique(np.concatenate(cuts)), np.zeros(len(functions))
    for low, high in itertools.pairwise(x_cuts):
        if high - low < 1e-13:
            continue
        for x, weight in zip(low + (high - low) * AT, (high - low) * SHARE, strict=True):
            at = (sides[:, 0, 0] < x) != (sides[:, 1, 0] < x)
            y = p[at, 1] + (x - p[at, 0]) / d[at, 0] * d[at, 1]
            ends = np.sort(np.r_[y, [-(a + b * x) / c] if c else []])
            for bottom, top in itertools.pairwise(ends):
                middle = 0.5 * (bottom + top)
                inside = all((y[owner[at] == r] > middle).sum() % 2 for r in range(len(rings)))
                if inside and a + b * x + c * middle >= 0.0:
                    y1, y2 = top - bottom, 0.5 * (top**2 - bottom**2)
                    total += weight * (functions @ (y1, x * y1, y2))
    return total


def sequence_plain(h, area, levels):
    """Cut and area above (m, 2): every level (m,) is held against every triangle (n, 3)."""
    out = np.zeros((len(levels), 2))
    for k, z in enumerate(levels):
        mean, slope = positive_part(h - z)
        out[k] = area @ mean, area @ slope.sum(axis=1) - area[(h == z).all(axis=1)].sum()
    return out


def neighbourhoods(tin):
    """Sparse (n, n): 1 for each vertex and those an edge away."""
    n, t = len(tin.vertices), tin.triangles
    pairs = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    links = sparse.csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    near = sparse.csr_array(links + links.T + identity_matrix(n))
    near.data[:] = 1.0
    return near


def plane_rows(member, rows, xy):
    """Weights (r, n), sparse, with which the heights of a vertex' neighbourhood, ``member`` (r, n),
    give the plane's height at it.
    """
    x, y = xy.T
    sums = member @ np.c_[np.ones(len(x)), x, y, x * x, x * y, y * y]
    n, cx, cy = sums[:, 0], sums[:, 1] / sums[:, 0], sums[:, 2] / sums[:, 0]
    sxx, sxy, syy = (
        sums[:, 3] - cx * sums[:, 1],
        sums[:, 4] - cx * sums[:, 2],
        sums[:, 5] - cy * sums[:, 2],
    )
    det, dx, dy = sxx * syy - sxy * sxy, x[rows] - cx, y[rows] - cy
    good = det > 1e-9 * (sxx + syy) ** 2
    det = np.where(good, det, 1.0)
    px, py = (
        np.where(good, (syy * dx - sxy * dy) / det, 0.0),
        np.where(good, (sxx * dy - sxy * dx) / det, 0.0),
    )
    S, own = member.copy(), np.repeat(np.arange(len(rows)), np.diff(member.indptr))
    S.data = (1.0 / n - px * cx - py * cy)[own] + px[own] * x[S.indices] + py[own] * y[S.indices]
    return S


def smoother(tin, h, variance, wanted, rings):
    """What :class:`Smooth` does, sparse (n, n): smoothed heights are ``S h``, the
    adjoint is ``Sᵀ``.
    """
    rows, near = np.flatnonzero(wanted).astype(np.int64), neighbourhoods(tin)
    xy = tin.vertices[:, :2] - tin.vertices[:, :2].mean(axis=0)
    S, member, alive = (
        identity_matrix(len(h)),
        identity_matrix(len(h))[rows],
        np.ones(len(rows), bool),
    )
    for _ in range(rings if len(rows) else 0):
        member = sparse.csr_array(member @ near)
        member.data[:] = 1.0
        new = plane_rows(member, rows, xy)
        level = new @ h
        own, count = np.repeat(np.arange(len(rows)), np.diff(member.indptr)), np.diff(member.indptr)
        square = np.bincount(
            own,
            (h[member.indices] - level[own]) ** 2 / np.maximum(variance[member.indices], 1e-300),
            len(rows),
        )
        alive &= square <= count + 3.0 * np.sqrt(2.0 * count)
        keep = np.ones(len(h))
        keep[rows[alive]] = 0.0
        lift = sparse.csr_array(
            (np.ones(alive.sum()), (rows[alive], np.flatnonzero(alive))), shape=(len(h), len(rows))
        )
        S = sparse.csr_array(diagonal_matrix(keep) @ S + lift @ new)
    return S
