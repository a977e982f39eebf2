"""The cache of compiled kernels, which never takes the tool down: what is damaged is thrown away
and built again, and where nothing can be written the tool runs without.
"""

# mypy: allow-untyped-calls
from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numba.core.caching import FunctionCache

from ladar_volume.process.compile_progress import COMPILE_PROGRESS

if TYPE_CHECKING:
    from collections.abc import Callable

    from numba.core.base import BaseContext
    from numba.core.dispatcher import Dispatcher
    from numba.core.typing.templates import Signature

_said: set[str] = set()


def _say(line: str) -> None:
    """One line on stderr, once in a process."""
    if line not in _said:
        _said.add(line)
        sys.stderr.write(f"ladar_volume: {line}\n")


class KernelCache(FunctionCache):
    """Numba's own cache of one function; its errors cost a compilation, no more."""

    def load_overload(self, sig: Signature, target_context: BaseContext) -> Any:
        """The machine code of a signature; None where it is to be compiled."""
        found = self._read(sig, target_context)
        if found is None and COMPILE_PROGRESS.compile_apart():
            found = self._read(sig, target_context)
        if found is None:
            COMPILE_PROGRESS.begin_kernel()
        return found

    def _read(self, sig: Signature, target_context: BaseContext) -> Any:
        """What the cache has of a signature; a damaged file is thrown away."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # a damaged pickle may raise anything
            self._throw_away(error)
            return None

    def save_overload(self, sig: Signature, data: object) -> None:
        """Keep machine code, where that can be done."""
        try:
            super().save_overload(sig, data)
        except Exception as error:
            self.disable()
            reason = error.strerror if isinstance(error, OSError) else type(error).__name__
            _say(f"compiled kernels are not kept in {self.cache_path}: {reason}")

    def _throw_away(self, error: Exception) -> None:
        folder = Path(self.cache_path)
        _say(f"damaged cache of compiled kernels in {folder} ({type(error).__name__}): built again")
        base = f"{self._impl.filename_base}."
        try:
            for name in os.listdir(folder):
                if name.startswith(base) and name.endswith((".nbi", ".nbc")):
                    (folder / name).unlink(missing_ok=True)
        except OSError:
            self.disable()


def keep(compiled: Dispatcher | Callable[..., object]) -> None:
    """Give a compiled function its cache; without one where no folder can hold it."""
    if not hasattr(compiled, "enable_caching"):  # the compiler is switched off
        return
    dispatcher: Any = compiled
    try:
        dispatcher._cache = KernelCache(dispatcher.py_func)
    except (RuntimeError, OSError):
        _say("no folder for compiled kernels can be written: compiled anew at each start")
