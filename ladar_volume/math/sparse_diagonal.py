"""Sparse diagonal matrices as arrays, for SciPy from 1.11 on (Ubuntu 24.04), which has no
constructors of arrays for them.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ladar_volume.math.array_types import F64


def diagonal_matrix(values: F64) -> sparse.csr_array:
    """The matrix (n, n) with these values (n,) on its diagonal."""
    n = len(values)
    at = np.arange(n + 1, dtype=np.int32 if n < 2**31 - 1 else np.int64)
    return sparse.csr_array((values, at[:n], at), shape=(n, n))


def identity_matrix(n: int) -> sparse.csr_array:
    """The identity (n, n)."""
    return diagonal_matrix(np.ones(n))
