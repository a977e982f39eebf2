"""Small dense algebra for the kernels: normal equations up to six unknowns and one-pass
selection.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.math.array_types import F64
from ladar_volume.math.kernels import kernel, leaf_kernel

#: A pivot of the scaled normal matrix below this share of its diagonal means the points do not
#: determine the term.
PIVOT = 1e-6
#: Sweeps of the Jacobi iteration; it converges quadratically, three by three in four or five.
SWEEPS = 12


@leaf_kernel
def basis(u: float, v: float, p: int, x: F64) -> None:
    """``x[:p] = (1, u, v[, u², uv, v²])``."""
    x[0] = 1.0
    x[1] = u
    x[2] = v
    if p == 6:
        x[3] = u * u
        x[4] = u * v
        x[5] = v * v


@kernel
def invert(A: F64, p: int, inverse: F64) -> Any:
    """Inverse of a symmetric positive (p, p) matrix by Cholesky; False where a pivot is too
    small.
    """
    L = np.zeros((6, 6))
    for j in range(p):
        s = A[j, j]
        for k in range(j):
            s -= L[j, k] * L[j, k]
        if not s > PIVOT * A[j, j]:
            return False
        L[j, j] = np.sqrt(s)
        for i in range(j + 1, p):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = s / L[j, j]
    y = np.zeros(6)
    for c in range(p):
        for i in range(p):
            s = 1.0 if i == c else 0.0
            for k in range(i):
                s -= L[i, k] * y[k]
            y[i] = s / L[i, i]
        for i in range(p - 1, -1, -1):
            s = y[i]
            for k in range(i + 1, p):
                s -= L[k, i] * y[k]
            y[i] = s / L[i, i]
            inverse[i, c] = y[i]
    return True


@leaf_kernel
def jacobi_rotation(S: F64, vector: F64, p: int, q: int) -> None:
    """One Jacobi rotation: the symmetric S (3, 3) gets a zero at (p, q), the columns of ``vector``
    turn with it.
    """
    if S[p, q] == 0.0:
        return
    theta = 0.5 * (S[q, q] - S[p, p]) / S[p, q]
    t = (1.0 if theta >= 0.0 else -1.0) / (abs(theta) + np.sqrt(theta * theta + 1.0))
    c = 1.0 / np.sqrt(t * t + 1.0)
    s, o = t * c, 3 - p - q
    S[p, p] -= t * S[p, q]
    S[q, q] += t * S[p, q]
    S[p, q] = S[q, p] = 0.0
    a, b = S[o, p], S[o, q]
    S[o, p] = S[p, o] = c * a - s * b
    S[o, q] = S[q, o] = s * a + c * b
    for k in range(3):
        a, b = vector[k, p], vector[k, q]
        vector[k, p], vector[k, q] = c * a - s * b, s * a + c * b


@leaf_kernel
def eigen(S: F64, value: F64, vector: F64) -> None:
    """Eigenvalues (3,), ascending, and eigenvectors, the columns of ``vector`` (3, 3), of the
    symmetric S (3, 3), which is used up: by cyclic Jacobi rotations (Golub and Van Loan, Matrix
    Computations, section 8.5), at this size far faster than LAPACK.
    """
    vector[:] = 0.0
    for k in range(3):
        vector[k, k] = 1.0
    for _ in range(SWEEPS):
        off = abs(S[0, 1]) + abs(S[0, 2]) + abs(S[1, 2])
        if not off > 1e-17 * (abs(S[0, 0]) + abs(S[1, 1]) + abs(S[2, 2])):
            break
        jacobi_rotation(S, vector, 0, 1)
        jacobi_rotation(S, vector, 0, 2)
        jacobi_rotation(S, vector, 1, 2)
    for k in range(3):
        value[k] = S[k, k]
    for a, b in ((0, 1), (1, 2), (0, 1)):
        if value[b] < value[a]:
            value[a], value[b] = value[b], value[a]
            for k in range(3):
                vector[k, a], vector[k, b] = vector[k, b], vector[k, a]


@kernel
def select_kth(a: F64, n: int, k: int) -> Any:
    """The k-th smallest of ``a[:n]`` (k from 0); reorders ``a``."""
    lo, hi = 0, n - 1
    while lo < hi:
        pivot = a[(lo + hi) // 2]
        i, j = lo, hi
        while i <= j:
            while a[i] < pivot:
                i += 1
            while a[j] > pivot:
                j -= 1
            if i <= j:
                a[i], a[j] = a[j], a[i]
                i += 1
                j -= 1
        if k <= j:
            hi = j
        elif k >= i:
            lo = i
        else:
            break
    return a[k]
