"""SciPy asks NumPy for all its names, and thereby loads the tools for tests and for Fortran: 8 MB
that no node needs.
"""

from __future__ import annotations

from ladar_volume.process.switch import is_own_process

_UNWANTED = {"testing", "f2py"}


def hide_numpy_tools() -> None:
    """Take the tools out of what ``from numpy import *`` loads; ``numpy.testing`` and
    ``numpy.f2py`` are there for who asks for them by name. Nothing in a process of others.
    """
    if not is_own_process():
        return
    import numpy as np

    np.__all__ = [name for name in np.__all__ if name not in _UNWANTED]
    # what dir() tells beside those
    getattr(np, "__numpy_submodules__", set()).difference_update(_UNWANTED)
