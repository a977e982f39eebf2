"""Libraries that load others only where these are installed, for what is not wanted here."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def left_out(name: str) -> Iterator[None]:
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
