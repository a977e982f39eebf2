"""The budget of one volume: a variance per source, adding up to sigma², and the totals printed
beside it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ladar_volume.georeference.error_budget import calibration_covariance
from ladar_volume.math.large_arrays import large_zeros
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I32, I64, LEAST_UPWARD, FilteredPoints, PatchTable
from ladar_volume.uncertainty.load_kernels import correlated_kernel, height_kernel, naive_kernel
from ladar_volume.uncertainty.navigation_sum import (
    NavigationBins,
    NavigationLoads,
    navigation_loads,
    navigation_variance,
)
from ladar_volume.uncertainty.packing import beam_count, calibration_rows
from ladar_volume.uncertainty.patch_errors import PatchErrors
from ladar_volume.uncertainty.propagation import (
    SurfaceGeometry,
    calibration_marginals,
    calibration_sensitivity,
    calibration_variance,
    independent_covariance,
    navigation_sensitivity,
    patch_loads,
    surface_geometry,
    tangential_variance,
    time_bins,
)
from ladar_volume.uncertainty.second_order import (
    BORESIGHT,
    AttitudeCurvature,
    SecondOrder,
    attitude_curvature,
    attitude_second_order,
    combine_second_orders,
    curvatures,
    second_order,
)
from ladar_volume.uncertainty.smoothing import Smoothing, smoothing_of

#: Share of their variance that independent errors of two samples keep, on average, where one is
#: interpolated between them.
BETWEEN = 2.0 / 3.0
#: Rows of a symmetric matrix that are computed at a time, and heights whose sigma is.
ROWS, AT_ONCE = 128, 1 << 17


@dataclass(frozen=True)
class Budget:
    """lines : m⁶ by source, all uncorrelated · C_results : (k, k) independent-noise covariance of
    all results · sigma_tau_range : m³, with all correlation times divided by 3 and multiplied by 3
    · sigma_naive : m³, as if every point erred alone · within : m⁶, marginals of the line
    ``calibration`` where its sources are correlated · second : the second order of boresight and
    attitude, each a line by its mean square · smoothing_m3 : what the result is too large by for
    that, with a line of its own
    """

    lines: dict[str, float]
    C_results: F64
    sigma_tau_range: tuple[float, float]
    sigma_naive: float
    within: dict[str, float]
    second: SecondOrder
    smoothing_m3: float

    @property
    def sigma(self) -> float:
        """Standard deviation of the volume, m³."""
        return math.sqrt(sum(self.lines.values()))


@dataclass(frozen=True)
class Sensitivities:
    """Of one result to every source. C_results : (k, k) covariance from the returns' noise, of all
    results · tangential_m6 : variance from their noise within the surface · J_cal : (c,) ·
    boresight_curvature : (3, 3) by the boresight · attitude_curvature : the same by the attitude ·
    navigation : by time bin · smoothing : what the fits smoothed away
    """

    C_results: F64
    tangential_m6: float
    J_cal: F64
    boresight_curvature: F64
    attitude_curvature: AttitudeCurvature
    navigation: NavigationLoads
    smoothing: Smoothing


class Sources:
    """Every error source of one filtered surface, ready to be propagated to results. Two threads
    may propagate at once as long as only one asks for :meth:`variance` or
    :meth:`shared_covariance`, which complete :attr:`errors`.

    Raises :class:`VolumeError` (volume_no_navigation) where no state is known for a time bin of the
    patches.
    """

    def __init__(
        self,
        points: FilteredPoints,
        patches: PatchTable,
        navigation: NavigationBins,
        parameters: Parameters,
    ) -> None:
        self.points, self.patches, self.navigation, self.parameters = (
            points,
            patches,
            navigation,
            parameters,
        )
        self.geometry: SurfaceGeometry = surface_geometry(points, patches)
        self.C_cal = calibration_covariance(
            parameters.budget, beam_count(patches), parameters.georeference.pose_source
        )
        #: Bins (b,) of the navigation sensitivities and the row (l,) of each one's own among them.
        self.time_bins: tuple[I64, I32] = time_bins(patches)
        #: What calibration and navigation do to the parameters of each patch.
        self.errors = PatchErrors(patches, navigation, self.C_cal, self.time_bins)

    def budget(
        self, s: Sensitivities, base_surface_m6: float, naive_m3: float = math.nan
    ) -> Budget:
        """Budget of a result with these sensitivities, with a variance from the ground's deviation
        from the base under it, and with its :meth:`naive_sigma` where known.
        """
        C_b = self.C_cal[BORESIGHT, BORESIGHT]
        navigation = navigation_variance(s.navigation, self.parameters.budget)
        second_order_lines, second = combine_second_orders(
            {
                "boresight_second_order": second_order(
                    s.boresight_curvature, C_b, float(s.J_cal[BORESIGHT] @ C_b @ s.J_cal[BORESIGHT])
                ),
                "attitude_second_order": attitude_second_order(
                    s.attitude_curvature, self.parameters.budget, navigation["attitude"]
                ),
            }
        )
        lines = {
            "noise": max(0.0, float(s.C_results[0, 0])),
            "noise_tangential": s.tangential_m6,
            **calibration_variance(s.J_cal, self.C_cal),
            **navigation,
            **second_order_lines,
            "smoothing": s.smoothing.variance_m6,
            "base_surface": base_surface_m6,
        }
        rest = sum(lines.values()) - lines["position"] - lines["attitude"]
        low, high = (
            math.sqrt(
                rest + sum(navigation_variance(s.navigation, self.parameters.budget, f).values())
            )
            for f in (1.0 / 3.0, 3.0)
        )
        within = calibration_marginals(s.J_cal, self.C_cal) if "calibration" in lines else {}
        tau, smoothing_m3 = (min(low, high), max(low, high)), s.smoothing.shift_m3
        return Budget(lines, s.C_results, tau, naive_m3, within, second, smoothing_m3)

    def sensitivities(self, gradient: F64) -> Sensitivities:
        """What each source does to the first of k results with gradients (n, k, 3) per point;
        C_results is of all of them.
        """
        q, tangential_m6 = (
            patch_loads(gradient, self.patches, self.geometry),
            tangential_variance(gradient[:, 0], self.points),
        )
        first: F64 = large_zeros(q.shape[:2])
        first[...] = q[:, :, 0]
        smoothing = smoothing_of(gradient[:, 0], first, self.patches, self.geometry.row)
        del gradient  # the largest of all that is held meanwhile
        H = curvatures(first, self.patches, self.navigation, self.time_bins)
        J_nav, bins = navigation_sensitivity(first, self.patches, self.time_bins)
        return Sensitivities(
            independent_covariance(q, self.patches, self.geometry),
            tangential_m6,
            calibration_sensitivity(first, self.patches),
            H.sum(axis=0),
            attitude_curvature(H, self.time_bins[0], self.navigation),
            navigation_loads(
                J_nav, bins, self.navigation, self.parameters.georeference.max_position_gap_s
            ),
            smoothing,
        )

    def naive_sigma(self, gradient: F64) -> float:
        """Sigma of a result with gradient (n, 3) per point if every point erred alone."""
        points, square = naive_kernel(gradient, self.patches.normal, self.geometry.row)
        return math.sqrt(
            float(square @ self.variance(points)) + tangential_variance(gradient, self.points)
        )

    def variance(self, points: I64) -> F64:
        """Variance (k,) m² of points (k,) along their patches' normals from all sources; navigation
        of one patch counts as correlated.
        """
        row = self.geometry.row[points]
        out: F64 = self.points.variance[points] + height_kernel(
            self.geometry.design(points), row, self.errors.covariance(row)
        )
        return out

    def shared_covariance(self, points: I64) -> tuple[I64, F64]:
        """The order in time of points (k,), each at its mean time, and in this order the covariance
        (k, k) m² of their heights from calibration and navigation, its upper triangle; white errors
        are shared as by the samples of a time bin.
        """
        order = np.argsort(self.points.t_ns[points], kind="stable")
        points = points[order]
        row, up = (
            self.geometry.row[points],
            np.maximum(np.abs(self.points.normal[points, 2]), LEAST_UPWARD),
        )
        X = self.geometry.design(points) / up[:, None]
        J = np.einsum("kp,kpc->kc", X, calibration_rows(self.patches, row, X.shape[1]))
        C: F64 = upper_product(J @ self.C_cal, J)
        b, t_ns, bin_ns = self.parameters.budget, self.points.t_ns[points], self.navigation.bin_ns
        apart_s = np.append(np.diff(t_ns), 0) * 1e-9
        longest_s = self.parameters.georeference.max_position_gap_s
        fixes = 1.0 / float((1.0 / self.navigation.fixes(self.time_bins[0], longest_s)).mean())
        # a mean time may lie where there are none
        states = max(1.0, float(self.navigation.mean(self.time_bins[0])[1].mean()))
        deviation = np.einsum("kp,kpc->kc", X, self.errors.deviation(row)[row])
        position = (b.position_bias_fraction, b.position_white_fraction, b.tau_position_s, fixes)
        attitude = (b.attitude_bias_fraction, b.attitude_white_fraction, b.tau_attitude_s, states)
        for d, (bias, white, tau, n) in (
            (deviation[:, :3], position),
            (deviation[:, 3:], attitude),
        ):
            shares = (bias, 1.0 - bias - white, white / n, white * BETWEEN)
            correlated_kernel(
                np.ascontiguousarray(d), np.exp(-apart_s / tau), t_ns // bin_ns, shares, C
            )
        return order, C


def upper_product(A: F64, B: F64) -> F64:
    """``A Bᵀ`` (k, k) of A and B (k, c) on and above the diagonal, and somewhat below."""
    out, k = np.zeros((len(A), len(A))), len(A)
    for first in range(0, k, ROWS):
        np.matmul(A[first : first + ROWS], B[first:].T, out=out[first : first + ROWS, first:])
    return out


def vertical_sigma(sources: Sources, points: I64) -> F64:
    """Total standard deviation (k,) m of the height of points (k,): that along the normal over the
    normal's vertical component, of which no less than 0.05 is taken (walls).
    """
    out: F64 = large_zeros((len(points),))
    for first in range(0, len(points), AT_ONCE):
        some = points[first : first + AT_ONCE]
        upward = np.maximum(np.abs(sources.points.normal[some, 2]), LEAST_UPWARD)
        out[first : first + AT_ONCE] = np.sqrt(sources.variance(some)) / upward
    return out
