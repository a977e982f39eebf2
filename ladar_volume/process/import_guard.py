"""Libraries that load others only where these are installed, for what is not wanted here."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext

from ladar_volume.process.switch import is_own_process


@contextlib.contextmanager
def hide_module(name: str) -> Iterator[None]:
    """Within, module ``name`` counts as not installed; nothing changes where it is loaded
    already.
    """
    if name in sys.modules:
        yield
        return
    sys.modules[name] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules[name]


def block_import(name: str) -> AbstractContextManager[None]:
    """:func:`hide_module` in a process of our own; in one of others nothing."""
    return hide_module(name) if is_own_process() else nullcontext()
