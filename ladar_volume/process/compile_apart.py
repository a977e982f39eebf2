"""Kernels that are not in their cache, compiled by a process that ends afterwards: a compiler at
work leaves 250 MB to the process that ran it, and one that loads needs none of them.
"""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator, Sequence

from ladar_volume.process.compile_progress import COMPILE_PROGRESS


@contextlib.contextmanager
def compiled_apart(command: Sequence[str]) -> Iterator[None]:
    """While the block loads kernels, the first one that its cache lacks runs ``command``, which
    compiles all of them and writes a dot to stdout for each. What is missing after it, as where no
    cache can be written, this process compiles.
    """
    COMPILE_PROGRESS.apart = lambda: _follow(command)
    try:
        yield
    finally:
        COMPILE_PROGRESS.apart = None


def _follow(command: Sequence[str]) -> None:
    """Run the command and count its dots."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL) as process:
        try:
            while process.stdout is not None and process.stdout.read(1):
                COMPILE_PROGRESS.begin_kernel()
        except BaseException:  # a signal: this process ends
            process.kill()
            raise
