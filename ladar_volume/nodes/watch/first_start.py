"""A node's first start: its kernels are compiled, which takes minutes and is told meanwhile."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator

from ladar_volume.process.compile_progress import COMPILING

#: How often it is told how far the compiler is, s.
EVERY_S = 1.0


@contextlib.contextmanager
def compiling_told(tell: Callable[[str], None], every_s: float = EVERY_S) -> Iterator[None]:
    """While the block runs and has to compile, ``tell`` is called with how far it is, and stderr
    has it, too.
    """
    before, over = COMPILING.count, threading.Event()

    def watch() -> None:
        while not over.wait(every_s):
            if COMPILING.count > before:
                tell(COMPILING.words())

    watching = threading.Thread(target=watch, name="compiling", daemon=True)
    watching.start()
    COMPILING.aloud = True
    try:
        yield
    finally:
        over.set()
        watching.join()
