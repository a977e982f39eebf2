"""Words that options and records choose from, apart from the work that they choose: who only reads
a command line loads no kernel for them.
"""

from __future__ import annotations

#: What the next vertex maximises: the size of its residual, that times the area of its triangle, or
#: that over its standard deviation.
CRITERIA = ("residual", "residual-area", "residual-sigma")
#: Elevation adjustments: least squares by one solve, by the published iteration, least sizes, or
#: heights as measured.
ADJUST = ("rms", "rms-iterated", "asd", "none")
#: Misfits that an exchange of diagonals may lower: average size, root mean square.
MEASURES = ("asd", "rms")
#: Repairs of a mesh by the published Algorithm 2.
REPAIRS = ("none", "empty", "false", "both", "remove")
#: What a survey uses for a constant: one value measured in the present mounting, the mean of those,
#: or the mean of earlier mountings after the sensor was mounted anew and not calibrated.
USES = ("single", "mean", "remounted")
#: Lines of the budget from the calibration, in order.
CALIBRATION_GROUPS = (
    "range_bias",
    "beam_range",
    "beam_vertical",
    "boresight",
    "lever_laser",
    "lever_antenna",
    "clock",
)
#: Lines of the budget that a group of sources has, and with which power of its variances they
#: grow.
SOURCE_LINES: dict[str, dict[str, int]] = {
    "beams": {"beam_range": 1, "beam_vertical": 1},
    "boresight": {"boresight": 1, "boresight_second_order": 2},
    "lever_arms": {"lever_laser": 1, "lever_antenna": 1},
    "attitude": {"attitude": 1, "attitude_second_order": 2},
    "position": {"position": 1},
    "clock": {"clock": 1},
    "noise": {"noise": 1, "noise_tangential": 1},
}
#: Ways to take the ring's misregistration out of B, and the parameters they fit.
CORRECTIONS = {"none": 0, "offset": 1, "rigid": 6}
#: What may be kept as it is although it lies on no surface, on request.
KEEPABLE = ("clutter",)
#: What is done about stray points: those off the surface go, none do, or those that the filter
#: takes out.
CLEAN = ("auto", "off", "filter")
