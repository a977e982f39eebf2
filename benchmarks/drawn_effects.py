"""What the errors that a simulated survey drew do to a result, by the result's own sensitivities:
so much of its error is calibration and navigation, and what is left is the method's. A spread of
the rest that its own lines of the budget do not hold is a cause that sigma misses; the whole error
shows that in hundreds of surveys only.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ladar_volume.model.records import F64, I64
from ladar_volume.simulation.survey import EPOCH_NS, Survey
from ladar_volume.uncertainty.propagation import (
    calibration_sensitivity,
    navigation_sensitivity,
    patch_loads,
)
from ladar_volume.uncertainty.volume_budget import Sources


def drawn_calibration(drawn: Survey) -> F64:
    """Errors (c,) of the calibration that the pipeline believes in, in the order of
    ``calibration_columns``: a range is measured too long by what was drawn, all else is believed to
    be less by it.
    """
    t, p = drawn.truth, drawn.platform
    return np.concatenate(
        [
            [t["range_bias_m"]],
            -np.array(t["boresight_error_rad"]),
            np.array(p.lever_laser_m) - t["lever_laser_m"],
            np.array(p.lever_antenna_m) - t["lever_antenna_m"],
            [-t["clock_error_s"]],
            t["beam_range_m"],
            -np.array(t["beam_vertical_rad"]),
        ]
    )


def bin_means(t_ns: I64, error: F64, bins: I64, bin_ns: int) -> F64:
    """Means (b, 3) of errors (n, 3) at times (n,) ns over time bins (b,), each of which holds
    some.
    """
    row = np.searchsorted(bins, t_ns // bin_ns)
    ok = (row < len(bins)) & (bins[np.minimum(row, len(bins) - 1)] == t_ns // bin_ns)
    total = np.zeros((len(bins), 3))
    np.add.at(total, row[ok], error[ok])
    return total / np.bincount(row[ok], minlength=len(bins))[:, None]


def drawn_effect(drawn: Survey, gradient: F64, sources: Sources) -> float:
    """What the drawn errors do to a result with a gradient (n, 3) by the survey's points."""
    patches, platform = sources.patches, drawn.platform
    q = patch_loads(gradient[:, None], patches, sources.geometry)
    load = np.ascontiguousarray(q[:, :, 0])
    J, bins = navigation_sensitivity(load, patches, sources.time_bins)
    bin_ns = sources.navigation.bin_ns
    fix_ns, antenna, _, _ = drawn.fixes()
    t = (fix_ns - EPOCH_NS) * 1e-9
    lever = np.array(drawn.truth["lever_antenna_m"])
    position = antenna - platform.position(t) - platform.rotation(t).apply(lever)
    attitude_ns, quaternion, _, _ = drawn.attitudes()
    true = platform.rotation((attitude_ns - EPOCH_NS) * 1e-9)
    turn = (true.inv() * Rotation.from_quat(quaternion)).as_rotvec()
    calibration = float(calibration_sensitivity(load, patches) @ drawn_calibration(drawn))
    errors = np.c_[
        bin_means(fix_ns, position, bins, bin_ns), bin_means(attitude_ns, turn, bins, bin_ns)
    ]
    return calibration + float((J * errors).sum())
