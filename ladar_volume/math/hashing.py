"""The hash by which points are chosen without regard to their order (splitmix64's finaliser)."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ladar_volume.math.array_types import U64
from ladar_volume.math.kernels import leaf_kernel

if TYPE_CHECKING:
    X = TypeVar("X", np.uint64, U64)


def splitmix64(x: X) -> X:
    """Every bit of a number, or of numbers (n,), reaches every bit of the answer."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


#: The same of one number, for kernels.
mix_bits = leaf_kernel(splitmix64)
