"""Navigation errors as random effects: one value per axis and knot in time, linear between knots,
with the budget's correlations.

An error is ``C(t)^{1/2} y(t)``; every component of y has variance 1, split into a part constant
over the survey, a Gauss-Markov part and a white part per fix or attitude, as in the volume's budget
(UNCERTAINTY, step 4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.calibration.flight import Flight
from ladar_volume.georeference.point_jacobian import PointGeometry, navigation_jacobian
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import F64, I64
from ladar_volume.uncertainty.navigation_sum import matrix_root

#: Spacing of the knots (s), and how many there may be. Errors faster than the knots pass for noise;
#: those as fast as a vehicle sways, from which the clock is told, must not.
KNOT_S, MOST_KNOTS = 0.25, 600


@dataclass(frozen=True)
class Drift:
    """t_ns : (b,) knots, evenly spaced · position_root, attitude_root : (len(states), 3, 3)
    ``C^{1/2}``, m and rad · precision : (2, b, b) inverse covariance of y's knots for position and
    attitude, the same for each axis
    """

    t_ns: I64
    position_root: F64
    attitude_root: F64
    precision: F64

    @property
    def unknowns(self) -> int:
        """Number of values of y: 6 per knot, in NAV_COLUMNS order."""
        return 6 * len(self.t_ns)

    def place(self, t_ns: I64) -> tuple[I64, F64]:
        """Knot before each time (n,) and the share of the way (n,) to the next."""
        step = int(self.t_ns[1] - self.t_ns[0])
        k = np.clip((t_ns - self.t_ns[0]) // step, 0, len(self.t_ns) - 2)
        share: F64 = np.asarray((t_ns - self.t_ns[k]) / step, np.float64)
        return np.asarray(k, np.int64), share

    def rows(self, normal: F64, geometry: PointGeometry) -> F64:
        """``normal · d r_map / d y`` (n, 6), m, at each point's own time."""
        J = np.einsum("ni,nij->nj", normal, navigation_jacobian(geometry))
        out: F64 = np.empty(J.shape)
        out[:, :3] = np.einsum("nj,njk->nk", J[:, :3], self.position_root[geometry.state])
        out[:, 3:] = np.einsum("nj,njk->nk", J[:, 3:], self.attitude_root[geometry.state])
        return out

    def prior(self) -> F64:
        """Precision (6 b, 6 b) of y, knot by knot in NAV_COLUMNS order."""
        b = len(self.t_ns)
        out = np.zeros((b, 6, b, 6))
        for axis in range(6):
            out[:, axis, :, axis] = self.precision[axis // 3]
        precision: F64 = out.reshape(6 * b, 6 * b)
        return precision


def drift(flight: Flight, budget: BudgetParameters) -> Drift:
    """The navigation errors of a flight after its states' covariances and the budget's shares and
    correlation times.
    """
    t = flight.states.t_ns
    margin = 1_000_000_000  # the clock offset moves returns in time
    span = int(t[-1] - t[0]) + 2 * margin
    count = min(MOST_KNOTS, int(np.ceil(span / (KNOT_S * 1e9))) + 1)
    knots = t[0] - margin + np.arange(count) * -(-span // (count - 1))
    step_s = float(knots[1] - knots[0]) * 1e-9
    attitude_hz = max(len(t) - 1, 1) / max(float(t[-1] - t[0]) * 1e-9, 1e-9)
    lag = np.abs(np.subtract.outer(knots, knots)) * 1e-9
    b = budget
    precision = np.stack(
        [
            _precision(
                lag,
                b.position_bias_fraction,
                b.position_white_fraction,
                b.tau_position_s,
                flight.fix_hz * step_s,
            ),
            _precision(
                lag,
                b.attitude_bias_fraction,
                b.attitude_white_fraction,
                b.tau_attitude_s,
                attitude_hz * step_s,
            ),
        ]
    )
    C = flight.states.C_nav
    return Drift(
        knots.astype(np.int64), matrix_root(C[:, :3, :3]), matrix_root(C[:, 3:, 3:]), precision
    )


def _precision(lag: F64, bias: float, white: float, tau_s: float, samples: float) -> F64:
    markov = max(0.0, 1.0 - bias - white)
    # a trace of variance of its own keeps knots without white error apart
    K = bias + markov * np.exp(-lag / tau_s) + np.eye(len(lag)) * (white / max(1.0, samples) + 1e-9)
    inverse = np.asarray(np.linalg.inv(K), np.float64)
    out: F64 = 0.5 * (inverse + inverse.T)
    return out
