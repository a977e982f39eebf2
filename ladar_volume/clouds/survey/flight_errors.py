"""What calibration and navigation do to a volume of georeferenced points, from the trajectory that
was flown.

At the time of each point the trajectory gives the pose, the LiDAR equation run backwards gives
range and direction in the body, and with them the Jacobians of UNCERTAINTY's list: those of a
survey from its raw returns. A surface moves at a fixed place by ``n · dr``, ``n = (-dh/dx, -dh/dy,
1)`` with the slopes of the surface; a result with gradients g by the heights moves by ``Σ g n ·
J``, to first order. Calibration is summed before it is squared, navigation over time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ladar_volume.georeference.error_budget import calibration_covariance
from ladar_volume.georeference.lidar_equation import Mounting
from ladar_volume.georeference.point_jacobian import (
    PointGeometry,
    beam_jacobian,
    calibration_jacobian,
    navigation_jacobian,
    point_geometry,
)
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import (
    CAL_COLUMNS,
    F64,
    I64,
    NAV_COLUMNS,
    U16,
    Bool,
    MappedPoints,
    PlatformStates,
    Tin,
)
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.uncertainty.navigation_sum import (
    NavigationBins,
    navigation_loads,
    navigation_variance,
)
from ladar_volume.uncertainty.propagation import calibration_variance

#: Points whose Jacobians are held at a time.
CHUNK = 65_536
#: Boresight or attitude of a larger standard deviation: the first order may not be enough.
LARGE_RAD = math.radians(0.1)


@dataclass(frozen=True)
class FlightErrors:
    """states : of the platform, its positions and attitudes in the axes of the points · parameters
    : calibration, budget and georeference · mount : constants of the LiDAR equation · t_ns : (n,)
    of each point, on the trajectory's clock · ring : (n,) its beam, None where that is not known ·
    navigation : covariances of the states by time bin
    """

    states: PlatformStates = field(repr=False)
    parameters: Parameters = field(repr=False)
    mount: Mounting
    t_ns: I64 = field(repr=False)
    ring: U16 | None = field(repr=False)
    navigation: NavigationBins = field(repr=False)

    def of_rows(self, rows: I64) -> FlightErrors:
        """The same of some points."""
        ring = None if self.ring is None else self.ring[rows]
        return FlightErrors(
            self.states, self.parameters, self.mount, self.t_ns[rows], ring, self.navigation
        )

    @property
    def beams(self) -> int:
        """Beams with an error of their own; 1 where no point names its beam."""
        return 1 if self.ring is None else self.parameters.georeference.beams

    def geometry(self, points: F64, rows: I64 | slice) -> PointGeometry:
        """Range, direction and pose of points (n, 3) m at some rows."""
        t = self.t_ns[rows]
        n = len(t)
        ring = np.zeros(n, np.uint16) if self.ring is None else self.ring[rows]
        mapped = MappedPoints(
            t, points[rows], np.zeros((n, 6), np.float32), ring, np.zeros(n, np.float32)
        )
        return point_geometry(mapped, self.states, self.mount)

    def lines(self, points: F64, slope: F64, gradient: F64) -> dict[str, F64]:
        """Variances (k,), by source, of k results with gradients (n, k) by the heights of points
        (n, 3) m on a surface of slopes (n, 2). Points outside the trajectory do not count.
        """
        J_cal, J_nav, bins = self.sensitivities(points, slope, gradient)
        p = self.parameters
        C_cal = calibration_covariance(p.budget, self.beams, p.georeference.pose_source)
        out: dict[str, list[float]] = {}
        gap = p.georeference.max_position_gap_s
        for k in range(gradient.shape[1]):
            loads = navigation_loads(np.ascontiguousarray(J_nav[k]), bins, self.navigation, gap)
            each = calibration_variance(J_cal[k], C_cal) | navigation_variance(loads, p.budget)
            for name, value in each.items():
                out.setdefault(name, []).append(value)
        return {name: np.array(values) for name, values in out.items()}

    def sensitivities(self, points: F64, slope: F64, gradient: F64) -> tuple[F64, F64, I64]:
        """Of k results to the calibration (k, c) and, by time bin, to position and attitude (k, b,
        6); the ascending bins (b,). Arguments as of :meth:`lines`.
        """
        k, shared = gradient.shape[1], len(CAL_COLUMNS)
        bin_ns, known = self.navigation.bin_ns, self.navigation.index
        J_cal = np.zeros((k, shared + 2 * self.beams))
        J_nav = np.zeros((k, len(known), len(NAV_COLUMNS)))
        used = np.flatnonzero(gradient.any(axis=1))
        for start in range(0, len(used), CHUNK):
            rows = used[start : start + CHUNK]
            geometry = self.geometry(points, rows)
            g = np.where(geometry.covered[:, None], gradient[rows], 0.0)
            n = np.column_stack([-slope[rows], np.ones(len(rows))])
            by_cal, by_nav, by_beam = (
                np.nan_to_num(np.einsum("ni,nij->nj", n, J(geometry)))
                for J in (calibration_jacobian, navigation_jacobian, beam_jacobian)
            )
            J_cal[:, :shared] += g.T @ by_cal
            ring = np.zeros(len(rows), np.int64)
            if self.ring is not None:
                ring += self.ring[rows]
            # a time between two states may lie in a bin that holds none: the nearest one that does
            at = np.clip(np.searchsorted(known, self.t_ns[rows] // bin_ns), 0, len(known) - 1)
            for j in range(k):
                for c in range(2):
                    part = slice(shared + c * self.beams, shared + (c + 1) * self.beams)
                    J_cal[j, part] += np.bincount(ring, g[:, j] * by_beam[:, c], self.beams)
                for c in range(len(NAV_COLUMNS)):
                    J_nav[j, :, c] += np.bincount(at, g[:, j] * by_nav[:, c], len(known))
        seen = J_nav.any(axis=(0, 2))
        return J_cal, J_nav[:, seen], known[seen]


def is_covered(states: PlatformStates, t_ns: I64) -> Bool:
    """Which times (n,) lie between two states of one segment."""
    after = np.clip(np.searchsorted(states.t_ns, t_ns, side="right"), 1, len(states) - 1)
    inside = (t_ns >= states.t_ns[0]) & (t_ns <= states.t_ns[-1])
    out: Bool = inside & (states.segment[after] == states.segment[after - 1])
    return out


def vertex_slopes(tin: Tin) -> F64:
    """Slopes dh/dx, dh/dy (n, 2) of a surface at its vertices: means over the relevant triangles
    around them, by area; 0 where there is none.
    """
    t = tin.triangles[tin.relevant]
    area = footprint_areas(tin.vertices, t)
    a, b, c = (tin.vertices[t[:, k]] for k in range(3))
    u, w = b - a, c - a
    normal = np.cross(u, w)
    upward = np.where(normal[:, 2] == 0.0, 1.0, normal[:, 2])
    # area times slope is finite where a triangle has no footprint
    parts = (-normal[:, axis] / upward * area for axis in (0, 1))
    n = len(tin.vertices)
    corners = t.ravel()
    total = np.bincount(corners, np.repeat(area, 3), n)
    sums = [np.bincount(corners, np.repeat(part, 3), n) for part in parts]
    out: F64 = np.column_stack(sums) / np.where(total > 0.0, total, 1.0)[:, None]
    return out
