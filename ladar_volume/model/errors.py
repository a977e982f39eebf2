"""The exception tree: one root, one base per room, leaves that keep the offending value.

Everything the package raises on purpose derives from :class:`LadarVolumeError`, so a caller, a node
or the command line can tell bad input from a defect of the program.
"""

from __future__ import annotations

import reprlib
from typing import Any

_BRIEF = reprlib.Repr()
_BRIEF.maxstring = _BRIEF.maxother = 60
_BRIEF.maxlong = 40
#: Longest message, characters: files and messages from outside are quoted in some.
LONGEST = 600


def short_repr(value: object) -> str:
    """``repr`` of a value from outside, cut to what fits a message."""
    try:
        return _BRIEF.repr(value)
    except ValueError:  # an integer of more digits than Python prints
        return f"a number of {value.bit_length()} bits" if isinstance(value, int) else "a value"


def as_float(value: float) -> float:
    """A number as float; infinite where it is too large for one."""
    try:
        return float(value)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")


class LadarVolumeError(Exception):
    """Root of every error this package raises on purpose.

    Parameters
    ----------
    message : what is wrong and, where it helps, what to do; cut at LONGEST characters.
    reason : short machine-readable name (``snake_case``), used as the key when a node counts the
        drop.
    value : the offending value, kept for the caller.
    """

    reason = "error"

    def __init__(self, message: str, *, reason: str | None = None, value: object = None) -> None:
        super().__init__(message if len(message) <= LONGEST else message[: LONGEST - 1] + "…")
        if reason is not None:
            self.reason = reason
        self.value: Any = value


class ConfigurationError(LadarVolumeError):
    """A parameter or a configuration file is wrong."""

    reason = "configuration"


class UnknownParameterError(ConfigurationError):
    """A key that no stage declares; the message names the nearest known one."""

    reason = "unknown_parameter"


class ParameterValueError(ConfigurationError):
    """A value of the wrong type, outside its range, or not among the choices."""

    reason = "parameter_value"


class InputError(LadarVolumeError):
    """A message or an array that cannot be used."""

    reason = "input"


class CloudError(InputError):
    """A PointCloud2 (or the arrays from one) that cannot be decoded or has no usable return."""

    reason = "cloud"


class FixError(InputError):
    """A GNSS fix that cannot be used."""

    reason = "fix"


class AttitudeError(InputError):
    """An IMU or odometry attitude that cannot be used."""

    reason = "attitude"


class TimeOrderError(InputError):
    """Time stamps that run backwards, repeat, or lie in another epoch."""

    reason = "time_order"


class BagError(LadarVolumeError):
    """A recording that cannot be opened or lacks what is needed."""

    reason = "bag"


class OutputError(LadarVolumeError):
    """A result that cannot be written."""

    reason = "output"


class FilterError(LadarVolumeError):
    """The robust moving least squares filter cannot run on this input."""

    reason = "filter"


class GroundError(LadarVolumeError):
    """No ground surface could be found."""

    reason = "ground"


class ObjectError(LadarVolumeError):
    """No object above (or pit below) the ground is where one was asked for."""

    reason = "object"


class SurfaceError(LadarVolumeError):
    """A surface cannot be built or is not what was asked for."""

    reason = "surface"


class RegistrationError(LadarVolumeError):
    """A reference sphere or a transform cannot be determined from what was observed."""

    reason = "registration"


class VolumeError(LadarVolumeError):
    """A volume cannot be computed from this surface and base."""

    reason = "volume"


class CalibrationError(LadarVolumeError):
    """A calibration constant or its sigma cannot be determined from what was measured."""

    reason = "calibration"


class SimulationError(LadarVolumeError):
    """A scene, platform or survey cannot be simulated as asked."""

    reason = "simulation"
