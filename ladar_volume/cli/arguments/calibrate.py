"""Options of ``ladar_volume calibrate``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ladar_volume.cli.arguments import calibrate_strips
from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.parameter_flags import add_parameter, spec_of
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES
from ladar_volume.model.choices import USES

ANGLES = ("boresight_roll_deg", "boresight_pitch_deg", "boresight_yaw_deg")


#: Column → where its sigma goes in the budget, and which axis; lengths in m, angles in degrees,
#: times in s.
COLUMNS: dict[str, tuple[str, int]] = {
    **{f"boresight_{axis}_deg": ("boresight_sigma_deg", i) for i, axis in enumerate("xyz")},
    **{f"lever_laser_{axis}_m": ("lever_laser_sigma_m", i) for i, axis in enumerate("xyz")},
    **{f"lever_antenna_{axis}_m": ("lever_antenna_sigma_m", i) for i, axis in enumerate("xyz")},
    "clock_offset_s": ("clock_sigma_s", -1),
}


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb and its modes."""
    parser = subparsers.add_parser("calibrate", help=SUMMARIES["calibrate"])
    modes = parser.add_subparsers(dest="mode", required=True, metavar="MODE")
    repeats = modes.add_parser(
        "repeats",
        help="sigmas from repeated calibrations or measurements",
        description="FILE holds one measurement per row. Columns: "
        + ", ".join(ANGLES)
        + " (together, as calibrations give them; any "
        "angles), or small rotations "
        + ", ".join(c for c in COLUMNS if c.startswith("boresight"))
        + "; "
        + ", ".join(c for c in COLUMNS if not c.startswith("boresight"))
        + "; and 'mounting', a name that changes when the sensor was "
        "taken off and put back.",
    )
    repeats.add_argument("file", type=Path, help="CSV with a header")
    repeats.add_argument(
        "--uses",
        choices=USES,
        default="single",
        help="what the survey uses: one value of its own mounting (default), the mean of that "
        "mounting's values, or the mean of earlier "
        "mountings after the sensor was put on anew and not calibrated; with the last "
        "two the mean is written too",
    )
    confidence = spec_of("volume.confidence").default
    add_parameter(
        repeats,
        "--confidence",
        "volume.confidence",
        default=confidence,
        more=f"default {confidence}",
    )
    add_output(repeats)
    repeats.set_defaults(run=work("ladar_volume.cli.calibrate", "run_repeats"))
    calibrate_strips.add_parser(modes)


def add_output(parser: argparse.ArgumentParser) -> None:
    """The options both modes share."""
    parser.add_argument(
        "--config", type=Path, help="parameter file on top of which the result is written"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE.yaml",
        help="parameter file to write, for replay --config and the nodes",
    )
    parser.add_argument(
        "--json", action="store_true", help="print the result as JSON to standard output"
    )
