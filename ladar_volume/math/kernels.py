"""Compiled kernels: decorators for one thread, for what is a part of another kernel, and for the
parallel case.

All release the GIL and cache their machine code. Parallel kernels write each output element from
exactly one iteration and never reduce a float over iterations, so results do not depend on the
number of threads.

The index of a parallel loop is unsigned while the loop is lowered and signed before: a kernel that
takes it is compiled for both, unless it is handed ``signed(index)``.

A parallel kernel that takes a record (a NamedTuple of arrays) writes to its arrays only through a
kernel of one thread that its loop calls: numba's parallel pass does not see that a field is one of
the arguments, and drops a write to it in the loop itself as dead.

A kernel's twin is another formulation in plain NumPy, which the tests compare with it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from ladar_volume.process.import_guard import block_import

with block_import("coverage"):  # 5 MB, and nothing to measure where it does not run yet
    import numba

from ladar_volume.process.kernel_cache import keep
from ladar_volume.process.numba_threads import choose_openmp

choose_openmp(numba)

#: An entry for C takes a twentieth of the time of a compilation, and nothing calls it.
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
#: Numba's own option, absent from its type stubs.
NO_COUNTS: dict[str, Any] = {"_nrt": False}

#: Parts of an index that are shared out to the threads.
PARTS = 64
#: From so many elements on, a pass over them is shared out; a thread costs what some of them do.
MANY = 400_000

F = TypeVar("F", bound=Callable[..., Any])
A = TypeVar("A")
B = TypeVar("B")


def kernel(function: F) -> F:
    """Compile ``function`` for one thread; IEEE semantics, no fast-math."""
    compiled: Any = numba.njit(**OPTIONS)(function)
    keep(compiled)
    result: F = compiled
    return result


def inlined(function: F) -> F:
    """As :func:`kernel`, for what one other kernel calls in one place: it becomes part of that."""
    compiled: Any = numba.njit(**OPTIONS, inline="always")(function)
    keep(compiled)
    result: F = compiled
    return result


def leaf_kernel(function: F) -> F:
    """As :func:`kernel`, for small functions in hot loops that neither allocate nor return arrays
    (numba refuses those that do): rows ``x[i]`` handed to others are not counted as references,
    which costs more than what is done with them.
    """
    compiled: Any = numba.njit(**OPTIONS, **NO_COUNTS)(function)
    keep(compiled)
    result: F = compiled
    return result


@leaf_kernel
def signed(index: int) -> Any:
    """The index of a parallel loop as any other."""
    return np.int64(index)


def parallel_kernel(function: F) -> F:
    """Compile ``function`` with ``numba.prange`` loops shared over the cores."""
    compiled: Any = numba.njit(**OPTIONS, parallel=True)(function)
    keep(compiled)
    result: F = compiled
    return result


def in_threads(work: Callable[[A], B], parts: Sequence[A]) -> list[B]:
    """What ``work`` makes of each part, in as many threads as parallel kernels take. Raises what it
    raises.
    """
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        return list(pool.map(work, parts))


def run_in_threads(
    kernel_of: Callable[..., object], index: npt.NDArray[np.int64], *arguments: Any
) -> None:
    """Call a kernel of one thread with parts of the index (n,) and these arguments, in as many
    threads as parallel kernels take; each index writes elements of its own. It compiles in a third
    of the time that a parallel loop takes, and since parts are many, a thread that is done with
    easy ones takes the next.
    """
    parts = np.array_split(index, min(PARTS, max(len(index), 1)))
    in_threads(lambda part: kernel_of(part, *arguments), parts)


def run_in_ranges(kernel_of: Callable[..., object], count: int, *arguments: Any) -> None:
    """Call a kernel of one thread with (first, end, *arguments) for ranges of so many elements, in
    several threads where they are many; each element writes its own part of an array.
    """
    if count < MANY:
        kernel_of(0, count, *arguments)
        return
    edges = np.linspace(0, count, PARTS + 1).astype(np.int64).tolist()
    in_threads(lambda part: kernel_of(*part, *arguments), list(itertools.pairwise(edges)))
