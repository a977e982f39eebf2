"""Two pieces of work at a time: while one is in a kernel or in NumPy, which release the
interpreter's lock, the other goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")


def run_concurrently(one: Callable[[], A], two: Callable[[], B]) -> tuple[A, B]:
    """Results of both, the second made in a thread of its own. They must not write what the other
    reads. Raises what either raises, the first before the second, when both have ended.
    """
    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(two)
        return one(), other.result()
