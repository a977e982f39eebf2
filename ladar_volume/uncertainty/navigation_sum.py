"""How navigation errors, correlated in time, add up over a survey (UNCERTAINTY step 4).

Per time bin e a result has a sensitivity J_e to position and attitude. Each variance is split into
a part constant over the survey, a Gauss-Markov part and a white part. With ``y_e = C_e^{1/2} J_eᵀ``
(symmetric root, so covariances may change in time) the parts are ``|Σ y_e|²``, ``Σ_ef y_e·y_f
exp(−|t_e − t_f| / tau)`` and ``Σ |y_e|² / n_e``. Position and attitude have different correlation
times, so their cross covariance, where a pose source gives one, is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.math.kernels import kernel
from ladar_volume.math.se3 import matrix_from_quaternion
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import F64, I64, Bool, PlatformStates


class NavigationBins:
    """Mean C_nav and pose of the platform states in every time bin, and how many fixes they come
    from; the sums run in order of time, whatever the batches.

    bin_s : length of a bin, s. Bin index is ``floor(t / bin_s)``.
    """

    def __init__(self, bin_s: float) -> None:
        self.bin_ns = round(bin_s * 1e9)
        self.index: I64 = np.zeros(0, np.int64)
        self.count: I64 = np.zeros(0, np.int64)
        self._sum: F64 = np.zeros((0, 6, 6))
        self.pose_sums: F64 = np.zeros((0, 4, 3))
        # time that states cover, s, and its product with the time between fixes, s²
        self.fix_sums: F64 = np.zeros((0, 2))
        self._last_ns: int | None = None
        self._roots: F64 = np.zeros((0, 2, 3, 3))
        self._rooted: Bool = np.zeros(0, np.bool_)

    def add(self, states: PlatformStates) -> None:
        """Take in new states."""
        bins = states.t_ns // self.bin_ns
        index = np.union1d(self.index, bins)
        if len(index) != len(self.index):
            old = np.searchsorted(index, self.index)
            self.index = index
            self._sum, self.pose_sums, self.fix_sums, self.count, self._roots, self._rooted = (
                spread(of, old, len(index))
                for of in (
                    self._sum,
                    self.pose_sums,
                    self.fix_sums,
                    self.count,
                    self._roots,
                    self._rooted,
                )
            )
        row = np.searchsorted(self.index, bins)
        pose = np.concatenate(
            [states.p_map_body[:, None], matrix_from_quaternion(states.q_map_body)], axis=1
        )
        np.add.at(self.pose_sums, row, pose)
        np.add.at(
            self._sum, row, states.C_nav
        )  # one by one, in order: the same bits for any batching
        np.add.at(self.count, row, 1)
        np.add.at(self.fix_sums, row, self._covered(states))
        self._rooted[row] = False

    def _covered(self, states: PlatformStates) -> F64:
        """What states add to the sums of fixes (n, 2): a state covers the time since the one
        before, no more than from fix to fix.
        """
        gap = np.full(len(states), np.nan) if states.fix_gap_s is None else states.fix_gap_s
        if not len(states):
            return np.zeros((0, 2))
        first = states.t_ns[0] if self._last_ns is None else self._last_ns
        self._last_ns = int(states.t_ns[-1])
        since_s = np.diff(states.t_ns, prepend=first) * 1e-9
        covered = np.where(since_s > gap, gap, since_s)
        return np.stack([covered, covered * gap], axis=1)

    def sums(self) -> tuple[I64, I64, F64, F64]:
        """Bins (k,), number of states (k,), sums of their C_nav (k, 6, 6) and of position and
        R_map_body (k, 4, 3).
        """
        return self.index, self.count, self._sum, self.pose_sums

    @classmethod
    def from_sums(
        cls,
        bin_s: float,
        index: I64,
        count: I64,
        C_nav: F64,
        pose: F64,
        fix_sums: F64 | None = None,
    ) -> NavigationBins:
        """The inverse of :meth:`sums`, with ``fix_sums`` (k, 2) where they are known."""
        out = cls(bin_s)
        out.fix_sums = np.full((len(index), 2), np.nan) if fix_sums is None else fix_sums
        out.index, out.count, out._sum, out.pose_sums = index, count, C_nav, pose
        out._roots, out._rooted = np.zeros((len(index), 2, 3, 3)), np.zeros(len(index), np.bool_)
        return out

    @property
    def newest(self) -> int:
        """The last bin with a state, -1 without one."""
        return int(self.index[-1]) if len(self.index) else -1

    def mean(self, bins: I64) -> tuple[F64, I64]:
        """Mean C_nav (k, 6, 6) and number of states (k,) of bins (k,). Raises :class:`VolumeError`
        for a bin without a state.
        """
        row = self._rows(bins)
        return self._sum[row] / np.maximum(self.count[row], 1)[:, None, None], self.count[row]

    def fixes(self, bins: I64, longest_s: float) -> F64:
        """Fixes with errors of their own that the position in bins (k,) is a mean of: the time
        covered over the mean time from fix to fix, where a long interval counts as long as it is.
        At least one. Where it is not known, fixes ``longest_s`` apart. Raises as :meth:`mean`.
        """
        time_s, product = self.fix_sums[self._rows(bins)].T
        known = product > 0.0
        count = np.full(len(bins), self.bin_ns * 1e-9 / longest_s)
        count[known] = time_s[known] ** 2 / product[known]
        out: F64 = np.maximum(count, 1.0)
        return out

    def roots(self, bins: I64) -> tuple[F64, F64]:
        """Symmetric roots (k, 3, 3) each of the mean covariances of position and attitude in bins
        (k,), made once for a bin that no state is added to. Raises as :meth:`mean`.
        """
        row = self._rows(bins)
        new = row[~self._rooted[row]]
        mean = self._sum[new] / np.maximum(self.count[new], 1)[:, None, None]
        self._roots[new, 0], self._roots[new, 1] = (
            matrix_root(mean[:, :3, :3]),
            matrix_root(mean[:, 3:, 3:]),
        )
        self._rooted[new] = True
        return self._roots[row, 0], self._roots[row, 1]

    def mean_pose(self, bins: I64) -> tuple[F64, F64]:
        """Mean position (k, 3) m and mean of R_map_body (k, 3, 3), short of a rotation where the
        platform turned, of bins (k,). Raises as :meth:`mean`.
        """
        row = self._rows(bins)
        mean = self.pose_sums[row] / np.maximum(self.count[row], 1)[:, None, None]
        return np.ascontiguousarray(mean[:, 0]), np.ascontiguousarray(
            mean[:, 1:]
        )  # of one bin as of many, for kernels compiled once

    def _rows(self, bins: I64) -> I64:
        row = np.minimum(np.searchsorted(self.index, bins), max(len(self.index) - 1, 0))
        if len(bins) and (len(self.index) == 0 or not np.array_equal(self.index[row], bins)):
            raise VolumeError(
                "the platform's covariance is not known for every time of the surface",
                reason="volume_no_navigation",
            )
        return row


def spread(of: npt.NDArray[Any], old: I64, n: int) -> npt.NDArray[Any]:
    """Rows ``of`` (k, ...) at places ``old`` (k,) of n, zeros between."""
    out = np.zeros((n, *of.shape[1:]), of.dtype)
    out[old] = of
    return out


def matrix_root(C: F64) -> F64:
    """Symmetric roots of positive semi-definite matrices (k, 3, 3); negative eigenvalues of
    rounding size count as zero.
    """
    value, vector = np.linalg.eigh(C)
    out: F64 = (vector * np.sqrt(np.maximum(value, 0.0))[:, None, :]) @ np.swapaxes(vector, 1, 2)
    return out


@kernel
def markov_sum(t: F64, y: F64, tau: float) -> float:
    """``Σ_ef y_e·y_f exp(−|t_e − t_f| / tau)`` for ascending times t (n,) s and rows y (n, k), by
    the exact recursion in O(n).
    """
    total = 0.0
    state = np.zeros(y.shape[1])
    for e in range(len(t)):
        decay = math.exp(-(t[e] - t[e - 1]) / tau) if e else 0.0
        for c in range(y.shape[1]):
            state[c] *= decay
            total += y[e, c] * (y[e, c] + 2.0 * state[c])
            state[c] += y[e, c]
    return total


@dataclass(frozen=True)
class NavigationLoads:
    """Sensitivities of one result per time bin.

    t_s : (k,) ascending, s · position, attitude : (k, 3), ``C^{1/2} J`` in the result's unit ·
    fixes, samples : (k,) numbers of independent white errors per bin
    """

    t_s: F64
    position: F64
    attitude: F64
    fixes: F64
    samples: F64


def navigation_loads(
    J: F64, bins: I64, known: NavigationBins, max_fix_gap_s: float
) -> NavigationLoads:
    """Loads of sensitivities J (k, 6) at ascending bins (k,).

    The white part of the position is divided by the number of fixes in the bin, that of the
    attitude by the number of states. Where the fixes are not known they lie ``max_fix_gap_s``
    apart, the longest interval that is bridged.
    """
    (position_root, attitude_root), count = known.roots(bins), known.mean(bins)[1]
    position = np.einsum("kij,kj->ki", position_root, J[:, :3])
    attitude = np.einsum("kij,kj->ki", attitude_root, J[:, 3:])
    bin_s = known.bin_ns * 1e-9
    t_s = (bins - (bins[0] if len(bins) else 0)) * bin_s
    fixes = known.fixes(bins, max_fix_gap_s)
    return NavigationLoads(
        t_s.astype(np.float64), position, attitude, fixes, np.maximum(count, 1).astype(np.float64)
    )


def part_variance(
    t_s: F64, y: F64, independent: F64, bias: float, white: float, tau_s: float
) -> float:
    """Variance of one group (position or attitude) from its loads y (k, 3): bias, Gauss-Markov and
    white parts.
    """
    if bias + white > 1.0:
        raise VolumeError(
            f"bias and white fractions add up to {bias + white:g}, more than 1",
            reason="volume_fractions",
            value=bias + white,
        )
    total = y.sum(axis=0)
    constant = bias * float(total @ total)
    markov = (1.0 - bias - white) * float(markov_sum(t_s, np.ascontiguousarray(y), tau_s))
    return constant + markov + white * float(((y * y).sum(axis=1) / independent).sum())


def navigation_variance(
    loads: NavigationLoads, budget: BudgetParameters, tau_factor: float = 1.0
) -> dict[str, float]:
    """Variances of the position and attitude lines, with both correlation times multiplied by
    ``tau_factor``.
    """
    b = budget
    return {
        "position": part_variance(
            loads.t_s,
            loads.position,
            loads.fixes,
            b.position_bias_fraction,
            b.position_white_fraction,
            b.tau_position_s * tau_factor,
        ),
        "attitude": part_variance(
            loads.t_s,
            loads.attitude,
            loads.samples,
            b.attitude_bias_fraction,
            b.attitude_white_fraction,
            b.tau_attitude_s * tau_factor,
        ),
    }
