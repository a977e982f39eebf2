"""What all returns of a patch share, calibration and navigation, as errors of its parameters:
computed for the patches asked for.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.math.large_arrays import large_zeros
from ladar_volume.model.records import F32, F64, I32, I64, Bool, PatchTable
from ladar_volume.uncertainty.load_kernels import (
    CalibrationRows,
    Entries,
    deviation_kernel,
    shared_kernel,
)
from ladar_volume.uncertainty.navigation_sum import NavigationBins
from ladar_volume.uncertainty.packing import bin_rows, calibration_parts


class PatchErrors:
    """Deviations and covariances of the parameters of m patches, in single precision as the
    sensitivities they come from. A volume needs those inside its outline only.

    C_cal : (c, c) of the calibration · time_bins : bins (b,) of the navigation sensitivities, and
    the row (l,) of each one's own among them
    """

    def __init__(
        self,
        patches: PatchTable,
        navigation: NavigationBins,
        C_cal: F64,
        time_bins: tuple[I64, I32],
    ) -> None:
        m, p = patches.beta.shape
        self._rows = bin_rows(patches, time_bins[1])
        self._by_calibration = CalibrationRows(*calibration_parts(patches))
        one, two = np.nonzero(C_cal)
        self._calibration = Entries(one, two, C_cal[one, two])
        self._roots = navigation.roots(time_bins[0])
        self._deviation, self._covariance = (
            large_zeros((m, p, 6), np.float32),
            large_zeros((m, p, p), np.float32),
        )
        self._deviates, self._varies = np.zeros(m, np.bool_), np.zeros(m, np.bool_)

    def deviation(self, rows: I64) -> F32:
        """What one standard deviation of position and of attitude, each in three directions, does
        to the parameters: (m, p, 6), known for patches ``rows`` (k,). The errors within one patch
        count as one.
        """
        new = _unknown_rows(self._deviates, rows)
        deviation_kernel(new, self._rows, *self._roots, self._deviation)
        return self._deviation

    def covariance(self, rows: I64) -> F32:
        """Covariance of the parameters: (m, p, p), known for patches ``rows`` (k,)."""
        deviation, new = self.deviation(rows), _unknown_rows(self._varies, rows)
        shared_kernel(new, self._by_calibration, self._calibration, deviation, self._covariance)
        return self._covariance


def _unknown_rows(known: Bool, rows: I64) -> I64:
    """Those of ``rows`` (k,) that are not ``known`` (m,) yet, each once; marks them."""
    wanted = np.zeros(len(known), np.bool_)
    wanted[rows] = True
    new = np.flatnonzero(wanted & ~known)
    known[new] = True
    return new
