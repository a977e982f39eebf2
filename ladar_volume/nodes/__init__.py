"""The ROS graph. A process of nodes leaves out what SciPy would load of NumPy by asking for all its
names: the tools for tests and for Fortran, 8 MB. ``numpy.testing`` and ``numpy.f2py`` are there for
who asks for them by name.
"""

import numpy as np

_UNWANTED = {"testing", "f2py"}
np.__all__ = [name for name in np.__all__ if name not in _UNWANTED]
getattr(np, "__numpy_submodules__", set()).difference_update(
    _UNWANTED
)  # what dir() tells beside those
