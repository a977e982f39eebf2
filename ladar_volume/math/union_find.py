"""Things that are joined have one root: the sets of union and find (Tarjan 1975)."""

from __future__ import annotations

from ladar_volume.math.array_types import I32, I64
from ladar_volume.math.kernels import leaf_kernel


@leaf_kernel
def root_of(root: I32 | I64, i: int) -> int:
    """The last of the roots (n,) from one on; paths are halved on the way."""
    while root[i] != i:
        root[i] = root[root[i]]
        i = root[i]
    return i
