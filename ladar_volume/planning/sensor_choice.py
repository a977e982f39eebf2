"""Which sensors, and how high: predictions of one plan compared."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ladar_volume.georeference.error_budget import PRESETS
from ladar_volume.model.errors import LadarVolumeError, VolumeError
from ladar_volume.model.parameters import BudgetParameters, Parameters
from ladar_volume.model.records import F64, PlatformStates
from ladar_volume.planning.prediction import Plan, Prediction, Scanner, predict

#: What of a budget belongs to the scanner, and what to the IMU.
SCANNER_FIELDS = (
    "range_noise_m",
    "azimuth_noise_rad",
    "vertical_noise_rad",
    "beam_divergence_rad",
    "beam_range_sigma_m",
    "beam_vertical_sigma_rad",
    "range_bias_sigma_m",
)
IMU_FIELDS = ("attitude_sigma_rad",)
#: Scanners by name, each with the budget its sigmas come from: a VLP-16 as in the defaults, and a
#: line scanner as precise as that of seed 004 section 5.1.3, which states no constant errors.
SCANNERS: dict[str, tuple[Scanner, BudgetParameters]] = {
    "vlp16": (Scanner(), BudgetParameters()),
    "line": (Scanner(1, 0.0, 0.0, 300_000.0, 300.0), PRESETS["survey"]),
}
#: IMUs by name: 0.004, 0.004, 0.01° (seed 004 section 5.1.1), the default 0.02, 0.02, 0.05°, and
#: 0.25, 0.25, 0.8° (seed 002 chapter 8).
IMUS: dict[str, BudgetParameters] = {
    "survey": PRESETS["survey"],
    "tactical": BudgetParameters(),
    "mems": PRESETS["thesis"],
}


def with_sensors(
    parameters: Parameters, scanner: str | None = None, imu: str | None = None
) -> Parameters:
    """The parameters with the budget of a scanner and an IMU by name; None leaves what is there.
    Raises :class:`VolumeError` for an unknown name.
    """
    changes: dict[str, Any] = {}
    sources = {
        "scanner": (scanner, {k: v[1] for k, v in SCANNERS.items()}, SCANNER_FIELDS),
        "IMU": (imu, IMUS, IMU_FIELDS),
    }
    for kind, (name, known, fields) in sources.items():
        if name is not None:
            if name not in known:
                raise VolumeError(
                    f"no {kind} {name!r}; there are {', '.join(known)}",
                    reason="plan_sensor",
                    value=name,
                )
            changes |= {field: getattr(known[name], field) for field in fields}
    return dataclasses.replace(parameters, budget=dataclasses.replace(parameters.budget, **changes))


@dataclass(frozen=True)
class Choice:
    """One alternative: its name, and what it gives, or why it gives nothing."""

    name: str
    prediction: Prediction | None
    reason: str = ""


def predicted_choice(name: str, plan: Plan) -> Choice:
    """The prediction of a plan, or why there is none."""
    try:
        return Choice(name, predict(plan))
    except LadarVolumeError as error:
        return Choice(name, None, str(error))


def compare(plan: Plan) -> Iterator[Choice]:
    """Every scanner with every IMU on the same path, one after the other."""
    for scanner, (device, _) in SCANNERS.items():
        for imu in IMUS:
            parameters = with_sensors(plan.parameters, scanner, imu)
            yield predicted_choice(
                f"{scanner} + {imu}",
                dataclasses.replace(plan, scanner=device, parameters=parameters),
            )


def over_heights(
    plan: Plan, path: Callable[[float], PlatformStates], heights_m: Iterable[float]
) -> Iterator[Choice]:
    """The same survey from other heights (m); ``path`` gives the states for one."""
    for height in heights_m:
        yield predicted_choice(f"{height:.1f}", dataclasses.replace(plan, path=path(height)))


def height_steps(plan: Plan, steps: int = 8) -> F64:
    """Heights (m) worth trying, evenly spaced in their logarithm: from 4 m above the top to nine
    tenths of the longest range.
    """
    low = max(plan.pile.height_m, 0.0) + 4.0
    high = 0.9 * min(plan.scanner.max_range_m, plan.parameters.georeference.range_max_m)
    if high <= low:
        raise VolumeError(
            f"the pile is too high for a scanner that reaches {high / 0.9:g} m",
            reason="plan_height",
            value=high,
        )
    return np.geomspace(low, high, steps)


def highest(heights_m: F64, shares: F64, wanted: float) -> float:
    """The greatest height (m) at which sigma over V is still as wanted, linear between those tried
    (k,); NaN where it never is. Shares (k,) may be NaN.
    """
    good = np.flatnonzero(shares <= wanted)
    if len(good) == 0:
        return math.nan
    k = int(good[-1])
    if k + 1 == len(shares) or not math.isfinite(shares[k + 1]):
        return float(heights_m[k])
    part = (wanted - shares[k]) / (shares[k + 1] - shares[k])
    return float(heights_m[k] + part * (heights_m[k + 1] - heights_m[k]))
