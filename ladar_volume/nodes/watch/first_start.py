"""A node's first start: its kernels are compiled, which takes minutes and is reported meanwhile."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator

from ladar_volume.process.compile_progress import COMPILE_PROGRESS

#: Time between two reports, s.
EVERY_S = 1.0


@contextlib.contextmanager
def compilation_reports(report: Callable[[str], None], every_s: float = EVERY_S) -> Iterator[None]:
    """While the block compiles kernels, ``report`` is called with the progress, which also goes to
    stderr.
    """
    before, over = COMPILE_PROGRESS.count, threading.Event()

    def watch() -> None:
        while not over.wait(every_s):
            if COMPILE_PROGRESS.count > before:
                report(COMPILE_PROGRESS.words())

    watching = threading.Thread(target=watch, name="compiling", daemon=True)
    watching.start()
    COMPILE_PROGRESS.to_stderr = True
    try:
        yield
    finally:
        over.set()
        watching.join()
