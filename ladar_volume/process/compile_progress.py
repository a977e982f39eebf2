"""Progress of compiling kernels: counted where kernels are compiled, read where it is shown. It
imports no compiler, since nodes without kernels show it, too.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

#: Time between two lines on stderr, s.
REPORT_EVERY_S = 10.0


class CompileProgress:
    """How many kernels were compiled for this process; ``to_stderr``: whether lines go to stderr,
    ``ticks``: whether a dot for each kernel goes to stdout; ``apart``: has another process compile
    what is missing, None where this one compiles.
    """

    def __init__(self) -> None:
        self.count, self.to_stderr, self.ticks = 0, False, False
        self.apart: Callable[[], None] | None = None
        self._began = self._reported = 0.0

    def begin_kernel(self) -> None:
        """Count one more kernel, about to be compiled."""
        now = time.monotonic()
        self._began = self._began if self.count else now
        if self.to_stderr and (not self.count or now - self._reported >= REPORT_EVERY_S):
            self._reported = now
            rest = "once, some minutes; they are kept" if not self.count else "the rest follows"
            sys.stderr.write(f"ladar_volume: {self.words()}: {rest}\n")
        self.count += 1
        if self.ticks:
            sys.stdout.write(".")
            sys.stdout.flush()

    def compile_apart(self) -> bool:
        """Have another process compile, where one may and has not yet. Returns whether it has."""
        apart, self.apart = self.apart, None
        if apart is None:
            return False
        apart()
        return True

    def words(self) -> str:
        """Kernels so far, and the time they took."""
        seconds = time.monotonic() - self._began
        return f"compiling kernels, {self.count} so far in {seconds:.0f} s"


COMPILE_PROGRESS = CompileProgress()
