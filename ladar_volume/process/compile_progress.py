"""Progress of compiling kernels: counted where kernels are compiled, read where it is shown. It
imports no compiler, since nodes without kernels show it, too.
"""

from __future__ import annotations

import sys
import time

#: Time between two lines on stderr, s.
REPORT_EVERY_S = 10.0


class CompileProgress:
    """How many kernels this process compiled; ``to_stderr``: whether lines go to stderr."""

    def __init__(self) -> None:
        self.count, self.to_stderr = 0, False
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

    def words(self) -> str:
        """Kernels so far, and the time they took."""
        seconds = time.monotonic() - self._began
        return f"compiling kernels, {self.count} so far in {seconds:.0f} s"


COMPILE_PROGRESS = CompileProgress()
