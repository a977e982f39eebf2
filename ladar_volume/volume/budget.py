"""The budget of one volume: a variance per source, adding up to sigma², and the totals printed beside it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ladar_volume.georeference.budget import calibration_covariance
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, Bool, FilteredPoints, Patches
from ladar_volume.volume.navigation import NavigationBins, matrix_root, navigation_loads, navigation_variance
from ladar_volume.volume.propagation import (
    SurfaceGeometry,
    calibration_marginals,
    calibration_sensitivity,
    calibration_variance,
    independent_covariance,
    navigation_sensitivity,
    patch_loads,
    surface_geometry,
    tangential_variance,
)
from ladar_volume.volume.roughness import Roughness, field_variance
from ladar_volume.volume.second_order import BORESIGHT, SecondOrder, boresight_curvature, second_order


@dataclass(frozen=True)
class GroundField:
    """Weights (n,) m² at xy (n, 2) m with which the ground's deviation from the base enters the volume; point : (n,) whether at a point or
    spread over a triangle."""

    xy: F64
    weight: F64
    point: Bool
    rough: Roughness


@dataclass(frozen=True)
class Budget:
    """lines : m⁶ by source, all uncorrelated · C_results : (k, k) independent-noise covariance of all results · sigma_tau_range
    : m³, with all correlation times divided by 3 and multiplied by 3 · sigma_naive : m³, as if every point erred alone · within : m⁶,
    marginals of the line ``calibration`` where its sources are correlated · second : the second order of the boresight, a line by its
    mean square"""

    lines: dict[str, float]
    C_results: F64
    sigma_tau_range: tuple[float, float]
    sigma_naive: float
    within: dict[str, float]
    second: SecondOrder

    @property
    def sigma(self) -> float:
        """Standard deviation of the volume, m³."""
        return math.sqrt(sum(self.lines.values()))


class Sources:
    """Every error source of one filtered surface, ready to be propagated to results."""

    def __init__(self, points: FilteredPoints, patches: Patches, navigation: NavigationBins, parameters: Parameters) -> None:
        self.points, self.patches, self.navigation, self.parameters = points, patches, navigation, parameters
        self.geometry: SurfaceGeometry = surface_geometry(points, patches)
        beams = (patches.M_cal.shape[2] - 11) // 2
        self.C_cal = calibration_covariance(parameters.budget, beams, parameters.georeference.pose_source)

    def budget(self, gradient: F64, field: GroundField | None) -> Budget:
        """Budget of the first of k results with gradients (n, k, 3) per point; the others get their independent covariance only."""
        q = patch_loads(gradient, self.patches, self.geometry)
        C_results = independent_covariance(q, self.patches, self.geometry)
        first = np.ascontiguousarray(q[:, :, 0])
        J_nav, bins = navigation_sensitivity(first, self.patches)
        loads = navigation_loads(J_nav, bins, self.navigation, self.parameters.georeference.max_position_gap_s)
        J_cal, C_b = calibration_sensitivity(first, self.patches), self.C_cal[BORESIGHT, BORESIGHT]
        once = float(J_cal[BORESIGHT] @ C_b @ J_cal[BORESIGHT])
        second = second_order(boresight_curvature(first, self.patches, self.navigation), C_b, once)
        lines = {
            "noise": max(0.0, float(C_results[0, 0])),
            "noise_tangential": tangential_variance(gradient[:, 0], self.points),
            **calibration_variance(J_cal, self.C_cal), "boresight_second_order": second.line_m6,
            **navigation_variance(loads, self.parameters.budget),
            "base_surface": 0.0 if field is None else field_variance(field.xy, field.weight, field.point, field.rough),
        }
        rest = sum(lines.values()) - lines["position"] - lines["attitude"]
        low, high = (math.sqrt(rest + sum(navigation_variance(loads, self.parameters.budget, f).values())) for f in (1.0 / 3.0, 3.0))
        within = calibration_marginals(J_cal, self.C_cal) if "calibration" in lines else {}
        return Budget(lines, C_results, (min(low, high), max(low, high)), self._naive(gradient[:, 0]), within, second)

    def _naive(self, gradient: F64) -> float:
        along = np.einsum("nc,nc->n", gradient, self.patches.normal[self.geometry.row])
        return math.sqrt(float((along**2 * self.total_variance).sum()) + tangential_variance(gradient, self.points))

    @cached_property
    def total_variance(self) -> F64:
        """Variance (n,) m² of each point along its patch's normal from all sources; navigation of one patch counts as fully correlated."""
        M, X, row = self.patches.M_cal, self.geometry.X, self.geometry.row
        shared = np.einsum("mpc,mqc->mpq", M @ self.C_cal, M, optimize=True)
        unique, index = np.unique(self.patches.nav_bin, return_inverse=True)
        C, _ = self.navigation.mean(unique)
        owner = np.repeat(np.arange(len(self.patches)), np.diff(self.patches.nav_start))
        for block in (slice(0, 3), slice(3, 6)):
            rows = (self.patches.M_nav[:, :, block] @ matrix_root(C[:, block, block])[index.ravel()]).reshape(len(owner), -1)
            S = np.stack([np.bincount(owner, rows[:, c], len(self.patches)) for c in range(rows.shape[1])], axis=1)
            S = S.reshape(len(self.patches), M.shape[1], 3)
            shared += S @ np.swapaxes(S, 1, 2)
        out: F64 = self.points.variance + np.einsum("np,npq,nq->n", X, shared[row], X, optimize=True)
        return out


def vertical_sigma(sources: Sources, points: FilteredPoints) -> F64:
    """Total standard deviation (n,) m of each point's height: that along the normal over the normal's vertical component, of which no less
    than 0.05 is taken (walls)."""
    out: F64 = np.sqrt(sources.total_variance) / np.maximum(np.abs(points.normal[:, 2]), 0.05)
    return out
