"""Errors in time: a survey-constant part, a Gauss-Markov part and a white part of one total
variance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ladar_volume.math.kernels import kernel

F64 = npt.NDArray[np.float64]


class Errors(NamedTuple):
    """Drawn errors: the sum of all parts (n, k) at the asked times, and the constant part (k,)
    within it.
    """

    total: F64
    bias: F64


@kernel
def markov(keep: F64, steps: F64) -> F64:
    """A Gauss-Markov process (n, k) of unit variance from independent steps (n, k), of whose state
    ``keep`` (n,) is kept.
    """
    out = steps.copy()
    for i in range(1, len(keep)):
        new = math.sqrt(1.0 - keep[i] ** 2)
        for c in range(out.shape[1]):
            out[i, c] = keep[i] * out[i - 1, c] + new * steps[i, c]
    return out


def draw_errors(
    t_s: F64,
    sigma: F64,
    bias_share: float,
    white_share: float,
    tau_s: float,
    rng: np.random.Generator,
) -> Errors:
    """Errors at increasing times (n,) s with total sigmas (k,); the shares are of the variance, the
    rest is Gauss-Markov.
    """
    n, k = len(t_s), len(sigma)
    markov_share = max(0.0, 1.0 - bias_share - white_share)
    bias = rng.normal(size=k) * np.sqrt(bias_share)
    white = rng.normal(size=(n, k)) * np.sqrt(white_share)
    steps = rng.normal(size=(n, k))
    keep = np.exp(-np.diff(t_s, prepend=t_s[:1]) / tau_s)
    total: F64 = (bias + white + markov(keep, steps) * np.sqrt(markov_share)) * sigma
    return Errors(total, bias * sigma)
