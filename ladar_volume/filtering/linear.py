"""Small dense algebra for the kernels: normal equations up to six unknowns and one-pass selection."""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.model.kernels import kernel

#: A pivot of the scaled normal matrix below this share of its diagonal means the points do not determine the term.
PIVOT = 1e-6


@kernel
def basis(u: Any, v: Any, p: Any, x: Any) -> None:
    """``x[:p] = (1, u, v[, u², uv, v²])``."""
    x[0] = 1.0
    x[1] = u
    x[2] = v
    if p == 6:
        x[3] = u * u
        x[4] = u * v
        x[5] = v * v


@kernel
def invert(A: Any, p: Any, inverse: Any) -> Any:
    """Inverse of a symmetric positive (p, p) matrix by Cholesky; False where a pivot is too small."""
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


@kernel
def select_kth(a: Any, n: Any, k: Any) -> Any:
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
