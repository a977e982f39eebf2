"""How far the compiler of kernels is: counted where kernels are compiled, read by who shows it. It
imports no compiler, since nodes without kernels show it, too.
"""

from __future__ import annotations

import sys
import time

#: How often stderr hears how far the compiler is, s.
TOLD_S = 10.0


class Compiling:
    """How many kernels this process found in no cache; ``aloud``: stderr hears of it."""

    def __init__(self) -> None:
        self.count, self.aloud = 0, False
        self._began = self._told = 0.0

    def begins(self) -> None:
        """One more is compiled."""
        now = time.monotonic()
        self._began = self._began if self.count else now
        if self.aloud and (not self.count or now - self._told >= TOLD_S):
            self._told = now
            rest = "once, some minutes; they are kept" if not self.count else "the rest follows"
            sys.stderr.write(f"ladar_volume: {self.words()}: {rest}\n")
        self.count += 1

    def words(self) -> str:
        """How far it is."""
        seconds = time.monotonic() - self._began
        return f"compiling kernels, {self.count} so far in {seconds:.0f} s"


COMPILING = Compiling()
