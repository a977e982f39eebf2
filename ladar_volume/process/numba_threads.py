"""Numba's threads are OpenMP's: beside another library's TBB (Open3D brings one) the default falls
back to a layer that aborts the process when two Python threads enter parallel kernels at once, as
an estimate does.
"""

from __future__ import annotations

from types import ModuleType


def choose_openmp(numba: ModuleType) -> None:
    """Choose OpenMP where neither the user (``NUMBA_THREADING_LAYER``) nor the program that imports
    the package chose otherwise.
    """
    if numba.config.THREADING_LAYER == "default":
        numba.config.THREADING_LAYER = "omp"
