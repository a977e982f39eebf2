"""A lock that one process holds on an open file and that the system drops when the file is closed
or the process ends: ``flock`` where there is one, else a byte far behind the end (Windows).
"""

from __future__ import annotations

import importlib
import os
from typing import Any

#: The byte that is locked where files have no ``flock``: no file reaches so far.
FAR = 1 << 40


def _module(name: str) -> Any:
    """A module of the system, or None where it has none of this name."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def lock(descriptor: int) -> None:
    """Lock an open file. Raises BlockingIOError where another holds it, and OSError on disks
    without locks.
    """
    posix, windows = _module("fcntl"), _module("msvcrt")
    if posix is not None:
        posix.flock(descriptor, posix.LOCK_EX | posix.LOCK_NB)
    elif windows is not None:
        at = os.lseek(descriptor, 0, os.SEEK_CUR)
        os.lseek(descriptor, FAR, os.SEEK_SET)
        try:
            windows.locking(descriptor, windows.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(error.errno, error.strerror) from error
        finally:
            os.lseek(descriptor, at, os.SEEK_SET)
    else:
        raise OSError("this system has no locks of files")
