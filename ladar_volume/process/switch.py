"""The one switch of this room, and the environment that it sets."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

#: Threads that have nothing to do sleep: by default they spin, which starves everything else on a
#: small or busy computer. Read by the OpenMP runtime when the first parallel kernel starts. So do
#: those of NumPy's linear algebra, for milliseconds after each product: they double the time of an
#: estimate, whose matrices are too small to share out, and would make its last digits those of the
#: number of cores. Read when NumPy is first imported.
THREADS = {"OMP_WAIT_POLICY": "passive", "OPENBLAS_NUM_THREADS": "1"}

_own: list[bool] = []


def own_process() -> None:
    """Say that this process is a program of the package: what this room does is done from now on.
    To be called before NumPy is imported. Variables that the user has set stay.
    """
    _own.append(True)
    for name, value in THREADS.items():
        os.environ.setdefault(name, value)


def is_own_process() -> bool:
    """Whether :func:`own_process` was called."""
    return bool(_own)


@contextlib.contextmanager
def children_of_one_thread() -> Iterator[None]:
    """Processes that start within compute with one thread each; the environment is as before
    afterwards.
    """
    names = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
