"""Memory that a long-running node no longer needs goes back to the system. glibc's allocator keeps it otherwise: its arenas, one or more
per thread, grow to the peak of each thread and stay there. Elsewhere these calls do nothing."""

from __future__ import annotations

import contextlib
import ctypes
import gc

#: mallopt's number for the greatest number of arenas (malloc.h).
_M_ARENA_MAX = -8
#: How often a node gives memory back, s: the call takes milliseconds.
GIVE_BACK_S = 5.0


def few_arenas() -> None:
    """Let all threads share two arenas; to be called before they start."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 2)


def give_back() -> None:
    """Return what is free."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def tidy() -> None:
    """Collect what only cycles hold, then return what is free: after a start that compiled and imported much."""
    gc.collect()
    give_back()
