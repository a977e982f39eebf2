"""Processes that this one starts, and Ctrl-C: a terminal sends it to all of them at once."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


@contextmanager
def interrupts_wait() -> Iterator[None]:
    """Within the block Ctrl-C waits; threads and processes that are started there never hear of it,
    and end when this process ends them.
    """
    resource_tracker.ensure_running()  # its start would let interrupts in
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
